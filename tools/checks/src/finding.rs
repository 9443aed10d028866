//! Findings of exact checks: defects that need no statistics of the motion, and their place.

use serde::Serialize;

/// One finding.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// A stable name: `gap`, `repeat`, `saturated`, `stuck-output`.
    pub kind: String,
    /// Gyro and time, or file and line: `GYRX, 5200.0–5210.5 s`; `link.log: line 17`.
    pub place: String,
    /// A plain sentence.
    pub text: String,
}

impl Finding {
    /// Kind of a finding of output in another unit.
    pub const UNIT_FACTOR: &str = "unit-factor";
    /// Kind of a finding of drifts in proportion to accelerations.
    pub const ACCELERATION: &str = "drift-acceleration";
}
