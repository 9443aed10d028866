//! The report for a terminal: one labelled line for each fact.

use geu_protocol::Gyro;

use crate::gyros::{ALL_GYROS, Gyros, names};
use crate::outcome::{
    Chi2Fall, Class, DiagnosedEffect, Diagnosis, EstimatedValue, FollowedTerm, ReportedAlternative, Verdict,
};
use crate::residual_map::{SIGNIFICANT, VARIABLES, strongest};

/// Number of variables, and of motion segments, listed for each gyro.
const PLACES: usize = 3;
/// Alternatives of a group that are listed; the others are counted.
const LISTED: usize = 5;

fn on(gyros: &Gyros) -> String {
    if gyros == &ALL_GYROS { "all gyros".to_owned() } else { names(gyros).join(", ") }
}

/// A value with its sigma, to the digits of the sigma.
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

/// The code of an effect, with its formula.
pub fn effect_name(entry: &DiagnosedEffect) -> String {
    match &entry.formula {
        Some(formula) => format!("{} term {formula}", entry.code),
        None => entry.code.clone(),
    }
}

/// A verdict in a sentence.
pub fn verdict(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Consistent => "consistent: the residual is noise",
        Verdict::Explained => "explained: the residual is noise with the effects below",
        Verdict::Unexplained => "unexplained: no effect of the model explains the rest of the residual",
    }
}

/// The gyros and the effect: `GYRX: pivot-clearance`.
pub fn heading(entry: &DiagnosedEffect) -> String {
    format!("{}: {}", on(&entry.gyros), effect_name(entry))
}

/// Label and value of each fact of an effect.
pub fn facts(entry: &DiagnosedEffect) -> Vec<(String, String)> {
    let mut facts: Vec<(String, String)> = Vec::new();
    let mut fact = |label: &str, value: String| facts.push((label.to_owned(), value));
    for number in &entry.parameters {
        let unit = entry.coefficient_unit.as_ref().map_or(String::new(), |unit| format!(" {unit}"));
        fact(&number.name, with_sigma(number) + &unit);
    }
    // As a whole number, so that a zero has no sign.
    fact("share of the gap", format!("{} %", (100.0 * entry.gap_share).round() as i64));
    if let Some(Chi2Fall { fall, threshold }) = entry.chi2 {
        fact("fall of chi2", format!("{fall:.0} (threshold {threshold:.0})"));
    }
    let (same, others): (Vec<_>, Vec<_>) = entry.alternatives.iter().partition(|other| other.is_indistinguishable());
    let name = |other: &ReportedAlternative| {
        let name = other.formula.as_ref().unwrap_or(&other.code);
        if other.gyros == entry.gyros { name.clone() } else { format!("{name} on {}", on(&other.gyros)) }
    };
    if let (Some(next), Some(Chi2Fall { fall, .. })) = (others.first(), entry.chi2) {
        let share = 100.0 * (1.0 - next.delta_chi2.unwrap_or(0.0) / fall).max(0.0);
        // It is distinguishable, if only just.
        let share = if share < 99.5 { format!("{share:.0}") } else { "over 99".to_owned() };
        fact("next best", format!("{}, explains {share} % of that fall", name(next)));
    }
    for other in same.iter().take(LISTED) {
        let cosine = if other.cosine == 0.0 { String::new() } else { format!(" (cosine {:.3})", other.cosine) };
        fact("not distinguishable", format!("from {}{cosine}", name(other)));
    }
    if same.len() > LISTED {
        fact("not distinguishable", format!("from {} more, listed in the JSON", same.len() - LISTED));
    }
    for other in same {
        if let Some(test) = &other.discriminating_test {
            fact("discriminating test", format!("against {}: {test}", name(other)));
        }
    }
    facts
}

/// Facts as lines with aligned values.
pub fn labelled(indent: usize, facts: &[(String, String)]) -> String {
    let width = facts.iter().map(|(label, _)| label.chars().count()).max().unwrap_or(0);
    facts.iter().map(|(label, value)| format!("{:indent$}{label:width$}  {value}\n", "")).collect()
}

/// The report for a terminal.
pub fn text(diagnosis: &Diagnosis) -> String {
    let mut text = verdict(diagnosis.verdict).to_owned() + "\n";
    for (class, title) in [
        (Class::MissingEffect, "missing in the model"),
        (Class::Recalibration, "changed calibration, no missing effect"),
    ] {
        let own: Vec<&DiagnosedEffect> = diagnosis.entries.iter().filter(|entry| entry.class == class).collect();
        if !own.is_empty() {
            text += &format!("\n{title}\n");
        }
        for entry in own {
            text += &format!("  {}\n{}", heading(entry), labelled(4, &facts(entry)));
        }
    }
    if let Some(left) = &diagnosis.unexplained {
        let [from_s, to_s] = left.interval_s;
        let mut facts = vec![
            ("gyros".to_owned(), on(&left.gyros)),
            ("shape".to_owned(), left.shape.clone()),
            ("interval".to_owned(), format!("{from_s:.0}…{to_s:.0} s")),
        ];
        for FollowedTerm { term, score } in &left.follows {
            facts.push(("follows".to_owned(), format!("{term} (fall of chi2 {score:.0})")));
        }
        text += &format!("\nunexplained\n{}", labelled(2, &facts));
    }
    if !diagnosis.findings.is_empty() {
        text += "\nexact checks\n";
        for found in &diagnosis.findings {
            text += &format!("  {}: {}: {}\n", found.kind, found.place, found.text);
        }
    }
    let places: Vec<String> = Gyro::ALL.into_iter().flat_map(|gyro| significant_terms(diagnosis, gyro)).collect();
    if !places.is_empty() {
        text += "\nsignificant variables of the residual, in sigmas before and after\n";
        places.into_iter().for_each(|place| text += &format!("  {place}\n"));
    }
    text += "\ngap, arcsec within 30 min       rms      max   at the end   chi2/dof\n";
    for (name, gap) in [
        ("as configured", &diagnosis.before.fitted),
        ("with the effects found", &diagnosis.after.fitted),
        ("the same held out", &diagnosis.after.held_out),
    ] {
        text += &format!(
            "{name:24} {:10.2} {:8.2} {:12.2} {:10.3}\n",
            gap.rms_arcsec, gap.max_arcsec, gap.after_30min_arcsec, gap.reduced_chi2
        );
    }
    text
}

/// The most significant variables of a gyro before the diagnosis, over the recording and in motion segments.
fn significant_terms(diagnosis: &Diagnosis, gyro: Gyro) -> Vec<String> {
    let ([before, after], index) = (&diagnosis.residual_maps, gyro as usize);
    let whole = VARIABLES.iter().zip(&before.whole[index]).zip(&after.whole[index]);
    let along = whole.filter_map(|((name, sigmas), later)| Some((format!("along {name}"), (*sigmas)?, *later)));
    let segments = diagnosis.segments.iter().zip(&before.segments[index]).zip(&after.segments[index]);
    let within = segments.filter_map(|((segment, own), later)| {
        let (variable, sigmas) = strongest(own)?;
        let place = format!("in {}, {:.0} s ({})", segment.name, segment.from_s, VARIABLES[variable]);
        Some((place, sigmas, later[variable]))
    });
    // A whole number has no minus before a zero.
    let whole = |sigmas: f64| format!("{:+}", sigmas.round() as i64);
    let line = |(place, before, after): (String, f64, Option<f64>)| {
        let after = after.map_or(String::new(), |after| format!(" → {}", whole(after)));
        format!("{} {place} {}{after}", gyro.name(), whole(before))
    };
    [along.collect::<Vec<_>>(), within.collect()]
        .into_iter()
        .flat_map(|mut places| {
            places.retain(|(_, before, _)| before.abs() > SIGNIFICANT);
            places.sort_by(|one, other| other.1.abs().total_cmp(&one.1.abs()));
            places.into_iter().take(PLACES).map(line)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn alternative(code: &str, delta_chi2: Option<f64>) -> ReportedAlternative {
        ReportedAlternative {
            code: code.to_owned(),
            formula: None,
            gyros: [true, false, false, false],
            cosine: 0.9994,
            delta_chi2,
            discriminating_test: delta_chi2.is_none().then(|| format!("a scan about Y separates {code}")),
        }
    }

    #[test]
    fn every_fact_of_an_effect_has_a_line_with_a_label() {
        let number = |name: &str, value, sigma| EstimatedValue { name: name.to_owned(), value, sigma, written: None };
        let codes: Vec<String> = (0..12).map(|index| format!("drift-course-number-{index}")).collect();
        let entry = DiagnosedEffect {
            code: "pivot-clearance".to_owned(),
            gyros: [true, false, false, false],
            parameters: vec![number("clearance_arcsec", 11.523, Some(0.041)), number("preferred_arcsec", 0.0, None)],
            gap_share: 0.7,
            chi2: Some(Chi2Fall { fall: 69_651.0, threshold: 15.0 }),
            alternatives: std::iter::once(alternative("lost-counts", Some(60_000.0)))
                .chain(codes.iter().map(|code| alternative(code, None)))
                .collect(),
            ..DiagnosedEffect::default()
        };
        assert_eq!(heading(&entry), "GYRX: pivot-clearance");
        let lines = labelled(4, &facts(&entry));
        for line in [
            "    clearance_arcsec     11.523 ± 0.041",
            "    preferred_arcsec     0.0000",
            "    share of the gap     70 %",
            "    fall of chi2         69651 (threshold 15)",
            "    next best            lost-counts, explains 14 % of that fall",
            "    not distinguishable  from drift-course-number-0 (cosine 0.999)",
            "    not distinguishable  from 7 more, listed in the JSON",
            "    discriminating test  against drift-course-number-11: a scan about Y separates drift-course-number-11",
        ] {
            assert!(lines.lines().any(|own| own == line), "{line:?} not in\n{lines}");
        }
        assert!(lines.lines().all(|line| line.chars().count() < 120 && !line.contains(';')), "{lines}");
    }
}
