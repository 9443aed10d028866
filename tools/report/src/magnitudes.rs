//! Result of a diagnosis by magnitudes, as JSON and as text.

use geu_checks::Finding;
use geu_magnitudes::{Diagnosis, Observability, Parameter, RateResidual, Verdict, Windows};
use geu_model::units::ARCSEC_PER_DEG;
use geu_protocol::map;
use geu_protocol::template::{Value, engine, filled};
use serde_json::{Value as Json, json};

/// JSON with the keys of `geu diagnose --json`. Values without a meaning for rates are null.
pub fn json(diagnosis: &Diagnosis, findings: &[Finding]) -> Json {
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
    let noise = &diagnosis.noise;
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
        "noise": [{ "sigma_arcsec_s": noise.sigma_arcsec_s, "correlation": noise.correlation,
                    "between_arcsec_s": noise.between_arcsec_s }],
        "apart": diagnosis.observability.as_ref().map(|own| observability_json(own, windows)),
    })
}

fn gap(gap: Option<&RateResidual>) -> Json {
    let Some(gap) = gap else { return Json::Null };
    json!({ "rms_arcsec": null, "max_arcsec": null, "after_30min_arcsec": null, "reduced_chi2": gap.reduced_chi2,
            "rms_arcsec_s": gap.rms_arcsec_s, "max_arcsec_s": gap.max_arcsec_s })
}

fn observability_json(observability: &Observability, windows: &Windows) -> Json {
    let count = observability.parameters.len();
    let rows = |of: &dyn Fn(usize, usize) -> f64| -> Json {
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
    let finding = |own: &Finding| map! { place: own.place.as_str(), kind: own.kind.as_str(), text: own.text.as_str() };
    let errors = diagnosis.errors.iter().map(|found| {
        let alternatives = found.alternatives.iter().filter(|own| own.is_indistinguishable()).map(|own| {
            map! { words: own.parameter.words(windows), cosine: own.cosine, more: own.chi2_more.unwrap_or(0.0) }
        });
        map! { words: found.parameter.words(windows), value: with_sigma(found.parameter, found.value, found.sigma),
        share: 100.0 * found.gap_share, alternatives: alternatives.collect::<Value>() }
    });
    let noise = &diagnosis.noise;
    let searched = diagnosis.searched.iter();
    // One unit for the table.
    let (size, unit) = unit(Parameter::Bias(0), diagnosis.before.rms_arcsec_s);
    let digits = digits(size * diagnosis.after.rms_arcsec_s) + 1;
    let shown = |rate_arcsec_s: f64| format!("{:.digits$}", size * rate_arcsec_s);
    let row = |name: &str, count: usize, before: f64, after: f64, held_out: Option<f64>| {
        let held_out = held_out.map_or("–".to_owned(), shown);
        format!("{name:<20} {count:>8} {:>10} {:>10} {held_out:>10}", shown(before), shown(after))
    };
    let groups = diagnosis.groups.iter().map(|own| {
        let worse = own.held_out_arcsec_s.filter(|held_out| *held_out > own.before_arcsec_s);
        map! { name: own.group.as_str(), worse: worse.map(rate), before: rate(own.before_arcsec_s),
        row: row(&own.group, own.windows, own.before_arcsec_s, own.after_arcsec_s, own.held_out_arcsec_s) }
    });
    let (count, held_out) = (windows.all().len(), diagnosis.held_out.map(|gap| gap.rms_arcsec_s));
    let values = map! {
        findings: findings.iter().map(finding).collect::<Value>(),
        count: findings.len() as u32,
        verdict: diagnosis.verdict.name(),
        is_consistent: diagnosis.verdict == Verdict::Consistent,
        is_explained: diagnosis.verdict == Verdict::Explained,
        errors: errors.collect::<Value>(),
        caveat: caveat,
        noise: map! { sigma: rate(noise.sigma_arcsec_s), correlation: noise.correlation, between: rate(noise.between_arcsec_s) },
        is_slow: diagnosis.is_slow,
        offsets: [diagnosis.offsets.0, diagnosis.offsets.1],
        searched: searched.map(|(count, limit)| map! { count: *count as u32, limit: *limit }).collect::<Value>(),
        unit: format!("{:<20}", format!("rms gap, {unit}")),
        groups: groups.collect::<Value>(),
        all: row("all", count, diagnosis.before.rms_arcsec_s, diagnosis.after.rms_arcsec_s, held_out),
        observability: diagnosis.observability.as_ref().map(|own| observability_values(own, windows)),
    };
    filled(&engine(), include_str!("magnitudes.txt"), &values).trim_end().to_owned()
}

fn observability_values(own: &Observability, windows: &Windows) -> Value {
    let words: Vec<String> = own.parameters.iter().map(|parameter| parameter.words(windows)).collect();
    let best = own.manoeuvres.first();
    let parameters = own.parameters.iter().enumerate().map(|(index, parameter)| {
        let (alone, free) = (own.sigmas_alone[index], own.sigmas_free[index]);
        let correlations = own.correlations.as_ref();
        let correlations = correlations
            .map(|own| own.row(index).iter().map(|value| format!("{value:>+7.3}")).collect::<Vec<_>>().join(" "));
        let (now, then) = (sigma(*parameter, free), best.map(|best| sigma(*parameter, best.sigmas_free[index])));
        let row = format!(
            "{:<18} {:>14} {now:>14} {:>8.1}   {}",
            words[index],
            sigma(*parameter, alone),
            free / alone,
            correlations.unwrap_or_else(|| "–".to_owned())
        );
        map! { row: row, words: words[index].as_str(), now: now, then: then }
    });
    let pairs = (0..words.len()).flat_map(|one| (one + 1..words.len()).map(move |other| (one, other)));
    let pairs = pairs.map(|pair| {
        let cosine = own.cosines[pair];
        let manoeuvres = own.manoeuvres.iter();
        let best = manoeuvres.min_by(|a, b| a.cosines[pair].abs().total_cmp(&b.cosines[pair].abs()));
        let best = best.filter(|best| best.cosines[pair].abs() < 0.9 * cosine.abs()).map(|best| {
            map! { count: best.windows as u32, spin: spin(best.spin_arcsec_s), cosine: best.cosines[pair] }
        });
        map! { one: words[pair.0].as_str(), other: words[pair.1].as_str(), cosine: cosine, best: best }
    });
    map! { parameters: parameters.collect::<Value>(), condition: own.condition, pairs: pairs.collect::<Value>(),
    best: best.map(|best| spin(best.spin_arcsec_s)) }
}

/// `a spin of 46 deg/s about -X`.
fn spin(spin_arcsec_s: [f64; 3]) -> String {
    let axis =
        (0..3).max_by(|one, other| spin_arcsec_s[*one].abs().total_cmp(&spin_arcsec_s[*other].abs())).unwrap_or(0);
    let sign = if spin_arcsec_s[axis] < 0.0 { "-" } else { "" };
    format!("a spin of {} about {sign}{}", rate(spin_arcsec_s[axis].abs()), ["X", "Y", "Z"][axis])
}
