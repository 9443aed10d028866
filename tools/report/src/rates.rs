//! Result of a diagnosis of rates, as JSON and as text.

use std::fmt::Write;

use geu_diagnosis::Finding;
use geu_model::units::ARCSEC_PER_DEG;
use geu_rates::{Diagnosis, Observability, Parameter, RateResidual, Verdict, Windows};
use serde_json::{Value, json};

/// JSON with the keys of `geu diagnose --json`. Values without a meaning for rates are null.
pub fn json(diagnosis: &Diagnosis, findings: &[Finding]) -> Value {
    let windows = &diagnosis.windows;
    let names = |parameter: Parameter| -> Vec<&str> {
        parameter.gyros(windows).into_iter().map(|gyro| windows.gyros[gyro].name.as_str()).collect()
    };
    let effects = diagnosis.errors.iter().map(|found| {
        let (unit, size) = found.parameter.unit();
        let alternatives = found.alternatives.iter().map(|alternative| {
            json!({ "code": alternative.parameter.code(), "gyros": names(alternative.parameter),
                    "cosine": alternative.cosine,
                    "chi2_more": alternative.chi2_more, "alike": alternative.is_indistinguishable() })
        });
        let mut parameters = serde_json::Map::new();
        parameters.insert(unit.to_owned(), json!({ "value": found.value * size, "sigma": found.sigma * size }));
        json!({
            "code": found.parameter.code(), "class": "missing-effect", "gyros": names(found.parameter),
            "parameters": parameters, "gap_share": found.gap_share, "rivals": alternatives.collect::<Vec<_>>(),
        })
    });
    let findings =
        findings.iter().map(|finding| json!({ "kind": finding.kind, "place": finding.place, "text": finding.text }));
    let (before, after) = (gap(Some(&diagnosis.before)), gap(Some(&diagnosis.after)));
    let groups = diagnosis.groups.iter().map(|group| {
        json!({ "group": group.group, "windows": group.windows, "before_rms_arcsec_s": group.before_arcsec_s,
                "fitted_rms_arcsec_s": group.after_arcsec_s, "held_out_rms_arcsec_s": group.held_out_arcsec_s })
    });
    let noise = diagnosis.noise.channels.iter().map(|channel| {
        json!({ "sigma_arcsec_s": channel.sigma_arcsec_s, "correlation": channel.correlation,
                "between_arcsec_s": channel.between_arcsec_s })
    });
    let unexplained = (diagnosis.verdict == Verdict::Unexplained).then(|| {
        json!({ "gyros": windows.gyros.iter().map(|gyro| &gyro.name).collect::<Vec<_>>(), "interval_s": null,
                "shape": "offsets of groups", "follows": [] })
    });
    json!({
        "verdict": diagnosis.verdict.name(),
        "effects": effects.collect::<Vec<_>>(),
        "findings": findings.collect::<Vec<_>>(),
        // Without a fit, no window is predicted from others.
        "gap": { "before": { "fitted": before, "held_out": before },
                 "after": { "fitted": after, "held_out": gap(diagnosis.held_out.as_ref()) } },
        "unexplained": unexplained,
        "groups": groups.collect::<Vec<_>>(),
        "noise": noise.collect::<Vec<_>>(),
        "apart": diagnosis.observability.as_ref().map(|own| observability_json(own, windows)),
    })
}

fn gap(gap: Option<&RateResidual>) -> Value {
    let Some(gap) = gap else { return Value::Null };
    json!({ "rms_arcsec": null, "max_arcsec": null, "after_30min_arcsec": null, "reduced_chi2": gap.reduced_chi2,
            "rms_arcsec_s": gap.rms_arcsec_s, "max_arcsec_s": gap.max_arcsec_s })
}

fn observability_json(observability: &Observability, windows: &Windows) -> Value {
    let count = observability.parameters.len();
    let rows = |of: &dyn Fn(usize, usize) -> f64| -> Value {
        (0..count).map(|row| (0..count).map(|column| of(row, column)).collect::<Vec<_>>()).collect::<Vec<_>>().into()
    };
    let sigmas = |sigmas: &[f64]| -> Vec<f64> {
        sigmas.iter().zip(&observability.parameters).map(|(sigma, parameter)| sigma * parameter.unit().1).collect()
    };
    let manoeuvres = observability.manoeuvres.iter().map(|manoeuvre| {
        json!({ "spin_arcsec_s": manoeuvre.spin_arcsec_s, "windows": manoeuvre.windows,
                "sigmas_free": sigmas(&manoeuvre.sigmas_free), "condition": manoeuvre.condition,
                "cosines": rows(&|row, column| manoeuvre.cosines[(row, column)]) })
    });
    json!({
        "parameters": observability.parameters.iter().map(|parameter| parameter.words(windows)).collect::<Vec<_>>(),
        "units": observability.parameters.iter().map(|parameter| parameter.unit().0).collect::<Vec<_>>(),
        "sigmas_alone": sigmas(&observability.sigmas_alone),
        "sigmas_free": sigmas(&observability.sigmas_free),
        "cosines": rows(&|row, column| observability.cosines[(row, column)]),
        "correlations": observability.correlations.as_ref().map(|own| rows(&|row, column| own[(row, column)])),
        "condition": observability.condition,
        "manoeuvres": manoeuvres.collect::<Vec<_>>(),
    })
}

/// A value and its sigma, in the unit that suits them.
fn with_sigma(parameter: Parameter, value: f64, sigma: f64) -> String {
    let (size, unit) = unit(parameter, value.abs().max(sigma));
    let digits = digits(sigma * size);
    format!("{:+.digits$} ± {:.digits$} {unit}", value * size, sigma * size)
}

fn sigma(parameter: Parameter, sigma: f64) -> String {
    if !sigma.is_finite() {
        return "not determined".to_owned();
    }
    let (size, unit) = unit(parameter, sigma);
    format!("{:.*} {unit}", digits(sigma * size), sigma * size)
}

fn rate(rate_arcsec_s: f64) -> String {
    sigma(Parameter::Bias(0), rate_arcsec_s)
}

fn unit(parameter: Parameter, max: f64) -> (f64, &'static str) {
    match parameter {
        Parameter::Bias(_) if max >= 100.0 => (1.0 / ARCSEC_PER_DEG, "deg/s"),
        Parameter::Bias(_) => (1.0, "arcsec/s"),
        _ if max >= 1e-3 => (100.0, "%"),
        _ => (1e6, "ppm"),
    }
}

/// Decimals that show two digits of `size`.
fn digits(size: f64) -> usize {
    if size > 0.0 && size.is_finite() { (1.0 - size.log10().floor()).clamp(0.0, 6.0) as usize } else { 3 }
}

/// The result for a terminal.
pub fn text(diagnosis: &Diagnosis, findings: &[Finding], caveat: Option<&str>) -> String {
    let windows = &diagnosis.windows;
    let mut text = String::new();
    if !findings.is_empty() {
        let _ = writeln!(text, "{} faults of the telemetry:", findings.len());
        for finding in findings {
            let _ = writeln!(text, "  {}: {}: {}", finding.place, finding.kind, finding.text);
        }
        text.push('\n');
    }
    let _ = writeln!(
        text,
        "{}: {}",
        diagnosis.verdict.name(),
        match diagnosis.verdict {
            Verdict::Consistent => "the gyros and the reference differ only by noise.",
            Verdict::Explained => "the residual is noise with the errors below.",
            Verdict::Unexplained => "the gyros and the reference differ by more than noise and the errors below.",
        }
    );
    for found in &diagnosis.errors {
        let (parameter, share) = (found.parameter, 100.0 * found.gap_share);
        let value = with_sigma(parameter, found.value, found.sigma);
        let _ = writeln!(text, "  {}: {value}; {share:.0} % of the gap.", parameter.words(windows));
        for alternative in found.alternatives.iter().filter(|own| own.is_indistinguishable()) {
            let (words, more) = (alternative.parameter.words(windows), alternative.chi2_more.unwrap_or(0.0));
            let _ = writeln!(
                text,
                "    not distinguishable from {words}: cosine {:.4}, χ² changes by {more:+.1} with that instead.",
                alternative.cosine
            );
        }
    }
    if let Some(caveat) = caveat {
        let _ = writeln!(text, "  Note on the reference: {caveat}");
    }
    noise_text(&mut text, diagnosis);
    // One unit for the table.
    let (size, unit) = unit(Parameter::Bias(0), diagnosis.before.rms_arcsec_s);
    let digits = digits(size * diagnosis.after.rms_arcsec_s) + 1;
    let shown = |rate_arcsec_s: f64| format!("{:.digits$}", size * rate_arcsec_s);
    let name = format!("rms gap, {unit}");
    let _ = writeln!(text, "\n{name:<20} {:>8} {:>10} {:>10} {:>10}", "windows", "before", "fitted", "held out");
    let mut row = |name: &str, count: usize, before: f64, after: f64, held_out: Option<f64>| {
        let held_out = held_out.map_or("–".to_owned(), shown);
        let _ = writeln!(text, "{name:<20} {count:>8} {:>10} {:>10} {held_out:>10}", shown(before), shown(after));
    };
    for group in &diagnosis.groups {
        row(&group.group, group.windows, group.before_arcsec_s, group.after_arcsec_s, group.held_out_arcsec_s);
    }
    let held_out = diagnosis.held_out.map(|gap| gap.rms_arcsec_s);
    row("all", windows.all().len(), diagnosis.before.rms_arcsec_s, diagnosis.after.rms_arcsec_s, held_out);
    for group in &diagnosis.groups {
        if let Some(held_out) = group.held_out_arcsec_s.filter(|held_out| *held_out > group.before_arcsec_s) {
            let _ = writeln!(
                text,
                "{} is predicted worse from the others than without any error: {} instead of {}.",
                group.group,
                rate(held_out),
                rate(group.before_arcsec_s)
            );
        }
    }
    if let Some(observability) = &diagnosis.observability {
        observability_text(&mut text, observability, windows);
    }
    text.truncate(text.trim_end().len());
    text
}

fn noise_text(text: &mut String, diagnosis: &Diagnosis) {
    let windows = &diagnosis.windows;
    for (index, channel) in diagnosis.noise.channels.iter().enumerate() {
        let gyro = if windows.is_magnitude() { String::new() } else { format!(" of {}", windows.gyros[index].name) };
        let _ = writeln!(
            text,
            "\nNoise{gyro}, estimated within groups without the mean of each group and all errors: {} a window, \
             correlation {:.2} of successive windows; {} between groups, which sigmas include if it exceeds noise.",
            rate(channel.sigma_arcsec_s),
            channel.correlation,
            rate(channel.between_arcsec_s)
        );
    }
    if diagnosis.is_slow {
        let _ = writeln!(
            text,
            "That correlation is the largest allowed: slower noise within a group is not distinguishable from an \
             offset of the group, and sigmas may be too small."
        );
    }
    let (offsets, threshold) = diagnosis.offsets;
    let _ = writeln!(
        text,
        "An offset of every group would reduce χ² by {offsets:.1}; noise alone may give {threshold:.1}."
    );
    for (tried, threshold) in &diagnosis.searched {
        let _ = writeln!(text, "Searched {tried} sets of errors; threshold of the χ² reduction: {threshold:.1}.");
    }
}

fn observability_text(text: &mut String, observability: &Observability, windows: &Windows) {
    let words: Vec<String> = observability.parameters.iter().map(|parameter| parameter.words(windows)).collect();
    let _ = writeln!(text, "\nObservability, all parameters free:");
    let _ = writeln!(text, "{:<18} {:>14} {:>14} {:>8}   correlations", "", "sigma alone", "all free", "factor");
    for (index, parameter) in observability.parameters.iter().enumerate() {
        let (alone, free) = (observability.sigmas_alone[index], observability.sigmas_free[index]);
        let correlations = observability
            .correlations
            .as_ref()
            .map(|own| own.row(index).iter().map(|value| format!("{value:>+7.3}")).collect::<Vec<_>>().join(" "));
        let _ = writeln!(
            text,
            "{:<18} {:>14} {:>14} {:>8.1}   {}",
            words[index],
            sigma(*parameter, alone),
            sigma(*parameter, free),
            free / alone,
            correlations.unwrap_or_else(|| "–".to_owned())
        );
    }
    let _ = writeln!(text, "Condition number of the signatures: {:.0}.", observability.condition);
    for one in 0..words.len() {
        for other in one + 1..words.len() {
            let cosine = observability.cosines[(one, other)];
            let _ = write!(text, "{} and {}: cosine {cosine:+.3}", words[one], words[other]);
            let best = observability
                .manoeuvres
                .iter()
                .min_by(|a, b| a.cosines[(one, other)].abs().total_cmp(&b.cosines[(one, other)].abs()));
            if let Some(manoeuvre) = best.filter(|own| own.cosines[(one, other)].abs() < 0.9 * cosine.abs()) {
                let (spin, count) = (spin(manoeuvre.spin_arcsec_s), manoeuvre.windows);
                let _ = write!(
                    text,
                    "; {count} windows of {spin} would bring it to {:+.2}",
                    manoeuvre.cosines[(one, other)]
                );
            }
            let _ = writeln!(text, ".");
        }
    }
    if let Some(best) = observability.manoeuvres.first() {
        let _ = writeln!(text, "Of the spins simulated, {} helps most: with all free", spin(best.spin_arcsec_s));
        for (index, parameter) in observability.parameters.iter().enumerate() {
            let (now, then) =
                (sigma(*parameter, observability.sigmas_free[index]), sigma(*parameter, best.sigmas_free[index]));
            let _ = writeln!(text, "  {} would be known to {then} instead of {now}.", words[index]);
        }
    }
}

/// `a spin of 46 deg/s about -X`.
fn spin(spin_arcsec_s: [f64; 3]) -> String {
    let axis =
        (0..3).max_by(|one, other| spin_arcsec_s[*one].abs().total_cmp(&spin_arcsec_s[*other].abs())).unwrap_or(0);
    let sign = if spin_arcsec_s[axis] < 0.0 { "-" } else { "" };
    format!("a spin of {} about {sign}{}", rate(spin_arcsec_s[axis].abs()), ["X", "Y", "Z"][axis])
}
