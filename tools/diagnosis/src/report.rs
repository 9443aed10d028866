//! A diagnosis as JSON and, in `text`, its facts as labelled lines.

pub(crate) mod admission;
mod text;

use serde_json::{Value, json};

use crate::outcome::Diagnosis;

pub use text::{
    WIDTH, alternative_name, converted, effect_name, facts, heading, labelled, on, quantity, verdict, with_sigma,
    wrapped,
};

/// The diagnosis as JSON. A number that is not finite is null.
pub fn json(diagnosis: &Diagnosis) -> Value {
    json!({
        "verdict": diagnosis.verdict,
        "effects": diagnosis.entries,
        "findings": diagnosis.findings,
        "gap": { "before": diagnosis.before, "after": diagnosis.after },
        "unexplained": diagnosis.unexplained,
        "lag_s": { "value": diagnosis.lag_s.0, "sigma": diagnosis.lag_s.1 },
        "temperature_late_s": diagnosis.temperature_late_s,
    })
}
