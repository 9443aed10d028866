//! Facts of a report as labelled lines of limited width.

use geu_model::units::AngleUnit;
use geu_protocol::Gyros;

use crate::outcome::{Chi2Fall, DiagnosedEffect, EstimatedValue, ReportedAlternative, Verdict};

/// Alternatives of a group that are listed; the others are counted.
const LISTED: usize = 5;
/// Largest width of a line.
pub const WIDTH: usize = 100;
/// Words of a parameter's name that are a unit, and the unit as displays write it.
const UNITS: [(&str, &str); 11] = [
    ("arcsec", "arcsec"),
    ("ppm", "ppm"),
    ("counts", "counts"),
    ("seconds", "s"),
    ("s", "s"),
    ("h", "h"),
    ("day", "day"),
    ("k", "K"),
    ("deg", "°"),
    ("rad", "rad"),
    ("sqrt", "√"),
];

/// The gyros in words.
pub fn on(gyros: &Gyros) -> String {
    if gyros.is_all() && gyros.heads() > 1 { "all gyros".to_owned() } else { gyros.names().join(", ") }
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

/// The unit that ends the name of a parameter: `arcsec/h` of `arcsec_per_h`; empty without one.
pub fn unit(name: &str) -> String {
    if let Some(name) = name.strip_suffix("_per_k_per_h") {
        return unit(name) + "/(K/h)";
    }
    let of = |word: &str| UNITS.iter().find(|(own, _)| *own == word).map(|(_, unit)| *unit);
    let words = name.split('_').skip_while(|word| of(word).is_none());
    words.fold(String::new(), |unit, word| match word {
        "per" => unit + "/",
        _ if unit.is_empty() || unit.ends_with(['/', '√']) => unit + of(word).unwrap_or_default(),
        _ => unit + "·" + of(word).unwrap_or_default(),
    })
}

/// A parameter of an entry with sigma and unit, and in brackets with another unit of angles.
pub fn quantity(entry: &DiagnosedEffect, number: &EstimatedValue, angle: AngleUnit) -> String {
    let is_fixed = entry.chi2.is_some() && number.sigma.is_none() && number.written.is_none();
    let fixed = if is_fixed { ", not fitted" } else { "" };
    let text = format!("{} {}", with_sigma(number), unit_of(entry, number));
    format!("{}{}{fixed}", text.trim_end(), converted(entry, number, angle))
}

/// A parameter in brackets with this unit of angles; empty if it has the same unit without.
pub fn converted(entry: &DiagnosedEffect, number: &EstimatedValue, angle: AngleUnit) -> String {
    let unit = unit_of(entry, number);
    let (size, own) = angle.converted(&unit);
    if own == unit {
        return String::new();
    }
    let sigma = number.sigma.map(|sigma| sigma / size);
    format!(" ({} {own})", with_sigma(&EstimatedValue { value: number.value / size, sigma, ..number.clone() }))
}

fn unit_of(entry: &DiagnosedEffect, number: &EstimatedValue) -> String {
    match (&entry.coefficient_unit, &number.written) {
        (Some(unit), _) => unit.clone(),
        (None, Some(_)) => String::new(),
        (None, None) => unit(&number.name),
    }
}

/// An alternative's name, with its gyros if the effect has others.
pub fn alternative_name(entry: &DiagnosedEffect, other: &ReportedAlternative) -> String {
    let name = other.formula.as_ref().unwrap_or(&other.code);
    if other.gyros == entry.gyros { name.clone() } else { format!("{name} on {}", on(&other.gyros)) }
}

fn plain(value: f64) -> String {
    if value != 0.0 && (value.abs() < 1e-3 || value.abs() >= 1e6) {
        format!("{value:.3e}")
    } else {
        let decimals = (4.0 - value.abs().log10().floor()).clamp(0.0, 4.0) as usize;
        format!("{value:.decimals$}")
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
        Verdict::Explained => "explained: the residual is noise with the effects and corrections below",
        Verdict::Unexplained => "unexplained: no effect of the model explains the rest of the residual",
    }
}

/// The gyros and the effect: `GYRX: pivot-clearance`.
pub fn heading(entry: &DiagnosedEffect) -> String {
    format!("{}: {}", on(&entry.gyros), effect_name(entry))
}

/// Label and value of each fact of an effect.
pub fn facts(entry: &DiagnosedEffect, angle: AngleUnit) -> Vec<(String, String)> {
    let mut facts: Vec<(String, String)> = Vec::new();
    let mut fact = |label: &str, value: String| facts.push((label.to_owned(), value));
    for number in &entry.parameters {
        fact(&number.name, quantity(entry, number, angle));
    }
    // As a whole number, so that a zero has no sign.
    fact("share of the gap", format!("{} %", (100.0 * entry.gap_share).round() as i64));
    if let Some(Chi2Fall { fall, threshold }) = entry.chi2 {
        fact("fall of chi2", format!("{fall:.0} (threshold {threshold:.0})"));
    }
    let (same, others): (Vec<_>, Vec<_>) = entry.alternatives.iter().partition(|other| other.is_indistinguishable());
    let name = |other: &ReportedAlternative| alternative_name(entry, other);
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

/// Facts as lines with aligned values, at most [`WIDTH`] columns wide.
pub fn labelled(indent: usize, facts: &[(String, String)]) -> String {
    let width = facts.iter().map(|(label, _)| label.chars().count()).max().unwrap_or(0);
    facts.iter().map(|(label, value)| wrapped(&format!("{:indent$}{label:width$}  ", ""), value)).collect()
}

/// A text after `first`, in lines of at most [`WIDTH`] columns. Further lines are indented by the width of `first`.
pub fn wrapped(first: &str, text: &str) -> String {
    let indent = first.chars().count().min(WIDTH / 2);
    let (mut lines, mut line) = (String::new(), first.to_owned());
    let mut is_empty = true;
    for word in text.split_whitespace() {
        let mut word: Vec<char> = word.chars().collect();
        loop {
            let used = line.chars().count() + usize::from(!is_empty);
            let fits = used + word.len() <= WIDTH;
            // A word wider than a line is cut.
            let cut = if fits { word.len() } else { WIDTH.saturating_sub(used).min(word.len()) };
            if fits || (is_empty && cut > 0) {
                line += if is_empty { "" } else { " " };
                line.extend(word.drain(..cut));
                is_empty = false;
            }
            if word.is_empty() {
                break;
            }
            lines += &(line.trim_end().to_owned() + "\n");
            (line, is_empty) = (" ".repeat(indent), true);
        }
    }
    lines + line.trim_end() + "\n"
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use geu_model::parameter_spec::ValueFormat;

    use super::*;
    use geu_hypothesis::amplitude::AmplitudeRef;

    fn alternative(code: &str, delta_chi2: Option<f64>) -> ReportedAlternative {
        ReportedAlternative {
            code: code.to_owned(),
            formula: None,
            gyros: Gyros::ALL.only(0),
            cosine: 0.9994,
            delta_chi2,
            discriminating_test: delta_chi2.is_none().then(|| format!("a scan about Y separates {code}")),
            next_manoeuvre: None,
            hypothesis: None,
        }
    }

    #[test]
    fn every_fact_of_an_effect_has_a_line_with_a_label() {
        let number = |name: &str, value, sigma| EstimatedValue { name: name.to_owned(), value, sigma, written: None };
        let codes: Vec<String> = (0..12).map(|index| format!("drift-course-number-{index}")).collect();
        let entry = DiagnosedEffect {
            code: "pivot-clearance".to_owned(),
            gyros: Gyros::ALL.only(0),
            parameters: vec![number("clearance_arcsec", 11.523, Some(0.041)), number("preferred_arcsec", 0.0, None)],
            gap_share: 0.7,
            chi2: Some(Chi2Fall { fall: 69_651.0, threshold: 15.0 }),
            alternatives: std::iter::once(alternative("lost-counts", Some(60_000.0)))
                .chain(codes.iter().map(|code| alternative(code, None)))
                .collect(),
            ..DiagnosedEffect::default()
        };
        assert_eq!(heading(&entry), "GYRX: pivot-clearance");
        let lines = labelled(4, &facts(&entry, AngleUnit::from_name("arcsec")));
        for line in [
            "    clearance_arcsec     11.523 ± 0.041 arcsec",
            "    preferred_arcsec     0.0000 arcsec, not fitted",
            "    share of the gap     70 %",
            "    fall of chi2         69651 (threshold 15)",
            "    next best            lost-counts, explains 14 % of that fall",
            "    not distinguishable  from drift-course-number-0 (cosine 0.999)",
            "    not distinguishable  from 7 more, listed in the JSON",
            "    discriminating test  against drift-course-number-11: a scan about Y separates",
            "                         drift-course-number-11",
        ] {
            assert!(lines.lines().any(|own| own == line), "{line:?} not in\n{lines}");
        }
        assert!(lines.lines().all(|line| line.chars().count() <= WIDTH && !line.contains(';')), "{lines}");
    }

    #[test]
    fn every_parameter_of_the_model_has_its_unit() {
        let all = AmplitudeRef::every().flat_map(AmplitudeRef::with_courses);
        let numbers = all.flat_map(|own| own.own_shapes().iter().chain(own.course_shapes()).chain([own.number()]));
        let wrong: BTreeSet<_> = numbers
            .filter(|number| number.form == ValueFormat::Real && unit(number.name) != number.unit)
            .map(|number| (number.name, number.unit, unit(number.name)))
            .collect();
        assert!(wrong.is_empty(), "{wrong:?}");
        assert_eq!(unit("amplitude_ppm"), "ppm");
        assert_eq!(unit("arcsec_per_h_per_k_per_h"), "arcsec/h/(K/h)");
    }

    #[test]
    fn no_line_is_wider_than_the_width() {
        let long = format!("{} {} end", "word ".repeat(60), "x".repeat(250));
        for first in ["", "  label  ", &"label ".repeat(12)] {
            let lines = wrapped(first, &long);
            assert!(lines.lines().all(|line| line.chars().count() <= WIDTH && line == line.trim_end()), "{lines}");
            let packed = |text: &str| text.split_whitespace().collect::<String>();
            assert_eq!(packed(&lines), packed(&(first.to_owned() + &long)));
        }
        assert_eq!(wrapped("gyros  ", "GYRX"), "gyros  GYRX\n");
    }
}
