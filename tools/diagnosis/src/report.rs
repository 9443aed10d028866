//! A diagnosis as JSON (cli.md) and, in `text`, as labelled lines.

mod text;

use geu_protocol::Gyro;
use serde_json::{Map, Value, json};

use crate::change::Gyros;
use crate::gap::Gap;
use crate::outcome::{Class, Diagnosis, Entry, Gaps, Number, Verdict};

pub use text::{facts, heading, labelled, text};

/// Names of gyros.
pub fn names(gyros: &Gyros) -> Vec<&'static str> {
    Gyro::ALL.into_iter().filter(|gyro| gyros[*gyro as usize]).map(Gyro::name).collect()
}

/// The gyros with these names; nothing where there is none, or a name is no gyro's.
pub fn named(names: &[&str]) -> Option<Gyros> {
    let is_gyro = |name: &&str| Gyro::ALL.iter().any(|gyro| gyro.name() == *name);
    (!names.is_empty() && names.iter().all(is_gyro)).then(|| Gyro::ALL.map(|gyro| names.contains(&gyro.name())))
}

/// The JSON that cli.md describes, with more fields than it names.
pub fn json(diagnosis: &Diagnosis) -> Value {
    let findings = diagnosis.findings.iter();
    let findings: Vec<Value> =
        findings.map(|found| json!({ "kind": found.kind, "place": found.place, "text": found.text })).collect();
    json!({
        "verdict": diagnosis.verdict.name(),
        "effects": diagnosis.entries.iter().map(entry).collect::<Vec<_>>(),
        "findings": findings,
        "gap": { "before": gaps(&diagnosis.before), "after": gaps(&diagnosis.after) },
        "unexplained": diagnosis.unexplained.as_ref().map(|left| json!({
            "gyros": names(&left.gyros),
            "interval_s": left.interval_s,
            "shape": left.shape,
            "follows": left.follows.iter().map(|(term, score)| json!({ "term": term, "score": score })).collect::<Vec<_>>(),
        })),
        "lag_s": { "value": diagnosis.lag_s.0, "sigma": finite(diagnosis.lag_s.1) },
        "temperature_late_s": diagnosis.temperature_late_s,
    })
}

fn finite(value: f64) -> Value {
    if value.is_finite() { json!(value) } else { Value::Null }
}

fn entry(entry: &Entry) -> Value {
    let parameters: Map<String, Value> = entry.parameters.iter().map(parameter).collect();
    let rivals = entry.rivals.iter().map(|rival| {
        let mut value = json!({
            "code": rival.code,
            "gyros": names(&rival.gyros),
            "cosine": rival.cosine,
            "behind_chi2": rival.behind_chi2,
        });
        put(&mut value, "formula", rival.formula.as_ref().map(|formula| json!(formula)));
        put(&mut value, "remedy", rival.remedy.as_ref().map(|remedy| json!(remedy)));
        value
    });
    let mut value = json!({
        "code": entry.code,
        "class": class(entry.class),
        "gyros": names(&entry.gyros),
        "parameters": parameters,
        "gap_share": entry.gap_share,
        "rivals": rivals.collect::<Vec<_>>(),
    });
    put(&mut value, "formula", entry.formula.as_ref().map(|(formula, _)| json!(formula)));
    put(&mut value, "coefficient_unit", entry.formula.as_ref().map(|(_, unit)| json!(unit)));
    put(&mut value, "chi2", entry.chi2.map(|(fall, threshold)| json!({ "fall": fall, "threshold": threshold })));
    put(&mut value, "held_out_chi2", entry.held_out.map(|thirds| json!(thirds)));
    value
}

fn put(object: &mut Value, key: &str, value: Option<Value>) {
    if let (Some(value), Some(object)) = (value, object.as_object_mut()) {
        object.insert(key.to_owned(), value);
    }
}

fn parameter(number: &Number) -> (String, Value) {
    let value = match &number.written {
        Some(written) => serde_json::from_str(written).unwrap_or_else(|_| json!(written)),
        None => json!(number.value),
    };
    (number.name.clone(), json!({ "value": value, "sigma": number.sigma }))
}

/// As JSON has it.
pub fn class(class: Class) -> &'static str {
    match class {
        Class::MissingEffect => "missing-effect",
        Class::Recalibration => "recalibration",
    }
}

fn gaps(gaps: &Gaps) -> Value {
    let of = |gap: &Gap| {
        json!({
            "rms_arcsec": gap.rms_arcsec,
            "max_arcsec": gap.max_arcsec,
            "after_30min_arcsec": gap.after_30min_arcsec,
            "reduced_chi2": gap.reduced_chi2,
        })
    };
    json!({ "fitted": of(&gaps.fitted), "held_out": of(&gaps.held_out) })
}

/// A value with its sigma: as many digits as that has.
pub fn with_sigma(number: &Number) -> String {
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
pub fn called(entry: &Entry) -> String {
    match &entry.formula {
        Some((formula, _)) => format!("{} term {formula}", entry.code),
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
