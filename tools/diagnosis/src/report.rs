//! A diagnosis as JSON (cli.md) and in plain sentences.

use geu_protocol::Gyro;
use serde_json::{Map, Value, json};

use crate::change::{ALL_GYROS, Gyros};
use crate::gap::Gap;
use crate::outcome::{Class, Diagnosis, Entry, Gaps, Number, RivalShown, Verdict};
use crate::whereabouts::standing_out;

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

/// Rivals of a group named in a sentence.
const NAMED: usize = 5;

fn on(gyros: &Gyros) -> String {
    if gyros == &ALL_GYROS { "all gyros".to_owned() } else { names(gyros).join(", ") }
}

/// One sentence for one thing found.
pub fn sentence(entry: &Entry) -> String {
    let numbers: Vec<String> =
        entry.parameters.iter().map(|number| format!("{} = {}", number.name, with_sigma(number))).collect();
    let mut text = format!("{}: {}, {}", on(&entry.gyros), called(entry), numbers.join(", "));
    if let Some((_, unit)) = &entry.formula {
        text += &format!(" {unit}");
    }
    // Without the sign of a zero.
    text += &format!("; {} % of the gap", (100.0 * entry.gap_share).round() as i64);
    if let Some((fall, threshold)) = entry.chi2 {
        text += &format!("; chi2 falls by {fall:.0} (chance: {threshold:.0})");
    }
    let (same, apart): (Vec<_>, Vec<_>) = entry
        .rivals
        .iter()
        .partition(|rival| rival.behind_chi2.is_none_or(|behind| behind < crate::rivals::APART_CHI2));
    let name = |rival: &RivalShown| {
        let name = rival.formula.as_ref().unwrap_or(&rival.code);
        if rival.gyros == entry.gyros { name.clone() } else { format!("{name} on {}", on(&rival.gyros)) }
    };
    if let (Some(next), Some((fall, _))) = (apart.first(), entry.chi2) {
        let share = 100.0 * (1.0 - next.behind_chi2.unwrap_or(0.0) / fall).max(0.0);
        // It can be told apart, if only just.
        let share = if share < 99.5 { format!("{share:.0}") } else { "over 99".to_owned() };
        text += &format!("; next best, {}, explains {share} % of what it does", name(next));
    }
    if !same.is_empty() {
        let of = |rival: &&RivalShown| match rival.cosine {
            0.0 => name(rival),
            cosine => format!("{} (cosine {cosine:.3})", name(rival)),
        };
        let names: Vec<String> = same.iter().take(NAMED).map(of).collect();
        text += &format!("; cannot be told apart from {}", names.join(", "));
        if same.len() > NAMED {
            text += &format!(" and {} more", same.len() - NAMED);
        }
        for rival in &same {
            let Some(remedy) = &rival.remedy else { continue };
            text += &format!("; against {}: {remedy}", name(rival));
        }
    }
    text
}

/// A verdict in a sentence.
pub fn verdict(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Consistent => "consistent: the model explains the recording",
        Verdict::Explained => "explained: with what was missing the model explains the recording",
        Verdict::Unexplained => "unexplained: something is left that no effect of the model explains",
    }
}

/// The report for a terminal.
pub fn text(diagnosis: &Diagnosis) -> String {
    let mut text = String::new();
    let mut line = |content: String| {
        text += &content;
        text.push('\n');
    };
    line(verdict(diagnosis.verdict).to_owned());
    for (class, title) in [
        (Class::MissingEffect, "missing in the model"),
        (Class::Recalibration, "the calibration has moved; this is no missing effect"),
    ] {
        let own: Vec<&Entry> = diagnosis.entries.iter().filter(|entry| entry.class == class).collect();
        if !own.is_empty() {
            line(format!("\n{title}"));
            own.into_iter().for_each(|entry| line(format!("  {}", sentence(entry))));
        }
    }
    if let Some(left) = &diagnosis.unexplained {
        let [from_s, to_s] = left.interval_s;
        line(format!(
            "\nleft unexplained\n  {}: {}, {from_s:.0}…{to_s:.0} s",
            names(&left.gyros).join(", "),
            left.shape
        ));
        let follows: Vec<String> = left.follows.iter().map(|(term, chi2)| format!("{term} ({chi2:.0})")).collect();
        if !follows.is_empty() {
            line(format!("  follows most (fall of chi2): {}", follows.join(", ")));
        }
    }
    if !diagnosis.findings.is_empty() {
        line("\nexact checks".to_owned());
        for found in &diagnosis.findings {
            line(format!("  {}: {}: {}", found.kind, found.place, found.text));
        }
    }
    let places = standing_out(diagnosis);
    if !places.is_empty() {
        line("\nwhere the data leave the model, in sigmas before and after".to_owned());
        places.into_iter().for_each(|place| line(format!("  {place}")));
    }
    line("\ngap, arcsec within 30 min       rms      max   at the end   chi2/dof".to_owned());
    for (name, gap) in [
        ("as configured", &diagnosis.before.fitted),
        ("with what was found", &diagnosis.after.fitted),
        ("the same held out", &diagnosis.after.held_out),
    ] {
        line(format!(
            "{name:24} {:10.2} {:8.2} {:12.2} {:10.3}",
            gap.rms_arcsec, gap.max_arcsec, gap.after_30min_arcsec, gap.reduced_chi2
        ));
    }
    text
}
