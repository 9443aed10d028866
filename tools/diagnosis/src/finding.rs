//! What exact checks find: a thing that is certain without any statistics of the motion, and its place.

use serde::Serialize;

/// One finding.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// A stable name: `gap`, `repeat`, `saturated`, `stuck-output`.
    pub kind: String,
    /// Where: `GYRX, 5200.0–5210.5 s`; `link.log: line 17`.
    pub place: String,
    /// A plain sentence.
    pub text: String,
}
