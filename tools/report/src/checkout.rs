//! Simulated checkouts as tables for a terminal.

use std::fmt::Write;

use geu_calibration::Comparison;
use geu_calibration::checkout::{MonteCarlo, PrecautionResult};
use geu_calibration::solve::{CalibrationParameter, Solution, UNKNOWNS};
use geu_protocol::Gyro;

/// Two checkouts of one unit against the truth, and what they are together.
pub fn twice_table(truth: &[f64; UNKNOWNS], [one, two]: [&Solution; 2], comparison: &Comparison) -> String {
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{:<22} {:>12}  {:>16} {:>16} {:>7}  {:>16} {:>8}",
        "parameter", "truth", "first − truth", "second − truth", "χ²", "both − truth", "in sigma"
    );
    let (firsts, seconds, both) = (one.values(), two.values(), comparison.combined.values());
    let sigmas = [one.sigmas(), two.sigmas(), comparison.combined.sigmas()];
    for (index, parameter) in CalibrationParameter::all().enumerate() {
        let error = |value: f64, sigma: f64| {
            let (size, digits, unit) = scale(parameter);
            format!("{:+.digits$} ± {:.digits$}{unit}", (value - truth[index]) * size, sigma * size)
        };
        let _ = writeln!(
            text,
            "{:<22} {:>12.6}  {:>16} {:>16} {:>7.2}  {:>16} {:>+8.1}",
            parameter.label(),
            truth[index],
            error(firsts[index], sigmas[0][index]),
            error(seconds[index], sigmas[1][index]),
            comparison.chi2[index],
            error(both[index], sigmas[2][index]),
            (both[index] - truth[index]) / sigmas[2][index],
        );
    }
    let _ = write!(
        text,
        "scale factors in ppm, drifts in arcsec/h, misalignments in arcsec\n\
         spare equations: χ² {:.1} of {} and {:.1} of {}; the two differ by χ² {:.1} of {UNKNOWNS}, probability {:.2}: {}",
        one.chi2,
        one.degrees_of_freedom,
        two.chi2,
        two.degrees_of_freedom,
        comparison.joint_chi2,
        comparison.together_probability(),
        if comparison.is_compatible() { "compatible" } else { "not compatible" },
    );
    text
}

/// Factor, digits and unit in which errors of a parameter are told.
fn scale(parameter: CalibrationParameter) -> (f64, usize, &'static str) {
    match parameter.index {
        0 => (1e6, 2, ""),
        1 => (7200.0, 2, ""),
        _ => (1.0, 2, ""),
    }
}

/// A campaign for a terminal.
pub fn campaign_table(campaign: &MonteCarlo) -> String {
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{:<22} {:>8} {:>10} {:>10} {:>8} {:>10} {:>10}   {:>14}",
        "parameter", "unit", "rms error", "predicted", "ratio", "mean/σ√N", "coverage", "hand rms error"
    );
    for (index, found) in campaign.scatter.iter().enumerate() {
        let (size, digits, _) = scale(found.parameter);
        let hand =
            campaign.hand_rms_error.map_or_else(|| "–".to_owned(), |hand| format!("{:.digits$}", hand[index] * size));
        let _ = writeln!(
            text,
            "{:<22} {:>8} {:>10.digits$} {:>10.digits$} {:>8.3} {:>+10.1} {:>9.1}%   {hand:>14}",
            found.parameter.label(),
            ["ppm", "arcsec/h", "arcsec"][found.parameter.index.min(2)],
            found.rms_error * size,
            found.sigma * size,
            found.rms_error / found.sigma,
            found.mean_error / found.sigma * (campaign.runs as f64).sqrt(),
            found.coverage * 100.0,
        );
    }
    let least = campaign.scatter.iter().map(|found| found.coverage).fold(1.0, f64::min);
    let most = campaign.scatter.iter().map(|found| found.coverage).fold(0.0, f64::max);
    let _ = write!(
        text,
        "{} runs; one sigma holds {:.1}…{:.1} % of the errors (68.3 expected); mean of the reduced χ² {:.3}",
        campaign.runs,
        least * 100.0,
        most * 100.0,
        campaign.mean_reduced_chi2
    );
    text
}

/// The precautions for a terminal.
pub fn precautions_table(outcomes: &[PrecautionResult]) -> String {
    let mut text = String::from("largest error of an equation with the true parameters, arcsec, and its manoeuvre\n");
    let names = Gyro::ALL.map(|gyro| format!("{:>16}", gyro.name())).join("");
    let _ = writeln!(text, "{:<46} {:>6} {names}", "", "hours");
    for outcome in outcomes {
        let errors =
            outcome.equation_arcsec.each_ref().map(|(arcsec, name)| format!("{arcsec:>+8.1} {name:<7}")).join("");
        let _ = writeln!(text, "{:<46} {:>6.1} {errors}", outcome.what, outcome.length_s / 3600.0);
    }
    let _ = write!(
        text,
        "\nerror of the parameters: scale factors in ppm, drifts in arcsec/h, misalignments in arcsec\n{:<22}",
        ""
    );
    for index in 0..outcomes.len() {
        let _ = write!(text, " {:>9}", format!("({})", index + 1));
    }
    let _ = writeln!(text, " {:>9}", "sigma");
    for (index, parameter) in CalibrationParameter::all().enumerate() {
        let (size, digits, _) = scale(parameter);
        let _ = write!(text, "{:<22}", parameter.label());
        for outcome in outcomes {
            let _ = write!(text, " {:>+9.digits$}", outcome.errors[index] * size);
        }
        let sigma = outcomes.first().map_or(f64::NAN, |outcome| outcome.sigmas[index]);
        let _ = writeln!(text, " {:>9.digits$}", sigma * size);
    }
    let _ = write!(text, "{:<22}", "χ²");
    for outcome in outcomes {
        let _ = write!(text, " {:>9.1}", outcome.chi2.0);
    }
    let _ = write!(text, "\n{:<22}", "spare equations");
    for outcome in outcomes {
        let _ = write!(text, " {:>9}", outcome.chi2.1);
    }
    let _ = writeln!(text);
    for (index, outcome) in outcomes.iter().enumerate() {
        let _ = writeln!(text, "({}) {}", index + 1, outcome.what);
    }
    text.truncate(text.trim_end().len());
    text
}
