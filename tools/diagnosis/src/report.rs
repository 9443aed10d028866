//! A diagnosis as JSON (cli.md) and, in `text`, as labelled lines.

mod text;

use serde_json::{Value, json};

use crate::outcome::{DiagnosedEffect, Diagnosis, EstimatedValue, Verdict};

pub use crate::gyros::names;
pub use text::{facts, heading, labelled, text};

/// The JSON that cli.md describes, with more fields than it names. A number that is not finite is null.
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

/// A value with its sigma: as many digits as that has.
pub fn with_sigma(number: &EstimatedValue) -> String {
    if let Some(written) = &number.written {
        return written.clone();
    }
    let Some(sigma) = number.sigma.filter(|sigma| *sigma > 0.0) else { return plain(number.value) };
    let decimals = (1.0 - sigma.log10().floor()).max(0.0) as usize;
    if decimals > 8 {
        return format!("{:.3e} ± {:.1e}", number.value, sigma);
    }
    format!("{:.decimals$} ± {:.decimals$}", number.value, sigma)
}

fn plain(value: f64) -> String {
    if value != 0.0 && (value.abs() < 1e-3 || value.abs() >= 1e6) {
        format!("{value:.3e}")
    } else {
        format!("{value:.4}")
    }
}

/// What something is, in words: its code, or its formula.
pub fn called(entry: &DiagnosedEffect) -> String {
    match &entry.formula {
        Some(formula) => format!("{} term {formula}", entry.code),
        None => entry.code.clone(),
    }
}

/// A verdict in a sentence.
pub fn verdict(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Consistent => "consistent: the model explains the recording",
        Verdict::Explained => "explained: with what was missing the model explains the recording",
        Verdict::Unexplained => "unexplained: something is left that no effect of the model explains",
    }
}
