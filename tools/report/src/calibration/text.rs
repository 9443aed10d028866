//! A calibration and a comparison of several as tables for a terminal.

use std::fmt::Write;

use geu_calibration::compare::{LEAST_PROBABILITY, stability_per_day};
use geu_calibration::solve::{CalibrationParameter, UNKNOWNS, values};
use geu_calibration::{Calibrated, Comparison, PreviousCalibration};
use geu_model::Configuration;
use geu_protocol::Gyro;

use super::{moved_words, sigma_unit};

/// The result for a terminal.
pub fn table(believed: &Configuration, calibrated: &Calibrated) -> String {
    let solution = &calibrated.solution;
    let (solved, sigmas) = (solution.values(), solution.sigmas());
    let before = values(&believed.gyros.each_ref().map(|gyro| gyro.calibration));
    let hand = calibrated.hand.as_ref().map(values);
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{:<26} {:>14} {:>11}  {:<14} {:>10}  {:>14}",
        "parameter", "value", "sigma", "unit", "change/σ", "hand method/σ"
    );
    for (index, parameter) in CalibrationParameter::all().enumerate() {
        let (unit, digits, size, sigma_unit) = match parameter.index {
            0 => ("", 7, 1e6, "ppm"),
            1 => ("arcsec/half s", 6, 1.0, ""),
            _ => ("arcsec", 3, 1.0, ""),
        };
        let hand = hand
            .as_ref()
            .map_or_else(|_| "–".to_owned(), |hand| format!("{:+.1}", (hand[index] - solved[index]) / sigmas[index]));
        let _ = writeln!(
            text,
            "{:<26} {:>14.digits$} {:>11}  {unit:<14} {:>+10.1}  {hand:>14}",
            parameter.label(),
            solved[index],
            if sigma_unit.is_empty() {
                format!("{:.digits$}", sigmas[index])
            } else {
                format!("{:.3} {sigma_unit}", sigmas[index] * size)
            },
            (solved[index] - before[index]) / sigmas[index],
        );
    }
    let _ = writeln!(
        text,
        "\n{:<14} {:>10} {:>10} {:>9}   residual/σ of {}",
        "manoeuvre",
        "start s",
        "length s",
        "leverage",
        Gyro::ALL.map(Gyro::name).join(" ")
    );
    for (index, observation) in calibrated.observations.iter().enumerate() {
        let of = |gyro: Gyro| {
            let residual = solution.residuals.iter().find(|found| found.manoeuvre == index && found.gyro == gyro);
            residual.map_or_else(|| "–".to_owned(), |found| format!("{:+.1}", found.arcsec / found.sigma_arcsec))
        };
        let _ = writeln!(
            text,
            "{:<14} {:>10.1} {:>10.1} {:>9.2}   {}",
            observation.name,
            observation.start_s,
            observation.end_s - observation.start_s,
            solution.leverage[index],
            Gyro::ALL.map(|gyro| format!("{:>6}", of(gyro))).join(" ")
        );
    }
    let _ = writeln!(
        text,
        "\nχ² {:.1} of {} spare equations, probability {:.2}; condition {:.0}",
        solution.chi2,
        solution.degrees_of_freedom,
        solution.probability(),
        solution.condition
    );
    if let Err(why) = &calibrated.hand {
        let _ = writeln!(text, "no hand method: {why}");
    }
    let sigma = calibrated.reference_sigma_arcsec;
    if sigma.iter().any(|sigma| *sigma > 0.0) {
        let _ = writeln!(
            text,
            "noise of the reference: {:.2}, {:.2}, {:.2} arcsec about X, Y, Z",
            sigma[0], sigma[1], sigma[2]
        );
    }
    if solution.probability() < LEAST_PROBABILITY {
        let _ = writeln!(
            text,
            "the sixteen parameters do not explain these data: the unit has an effect that the configuration has not, or counts or fixes are wrong"
        );
    }
    text.truncate(text.trim_end().len());
    text
}

/// The comparison for a terminal.
pub fn comparison_table(earlier: &[PreviousCalibration], comparison: &Comparison) -> String {
    let names: Vec<&str> = earlier.iter().map(|one| one.name.as_str()).collect();
    let mut text = format!("less the mean of {}\n", names.join(", "));
    let _ = writeln!(
        text,
        "{:<26} {:>12} {:>12} {:<9} {:>9} {:>8} {:>12}  {:>22}",
        "parameter", "change", "sigma", "", "change/σ", "χ²", "probability", "stability a fortnight"
    );
    for (index, parameter) in CalibrationParameter::all().enumerate() {
        let (size, unit) = sigma_unit(parameter);
        let allowed = stability_per_day(parameter)
            .map_or_else(|| "–".to_owned(), |rate| format!("{:.1} {unit}", rate * 14.0 * size));
        let _ = writeln!(
            text,
            "{:<26} {:>+12.3} {:>12.3} {unit:<9} {:>+9.1} {:>8.1} {:>12.4}  {allowed:>22}",
            parameter.label(),
            comparison.change[index] * size,
            comparison.sigmas[index] * size,
            comparison.change[index] / comparison.sigmas[index],
            comparison.chi2[index],
            comparison.probability(index),
        );
    }
    let verdict = if comparison.is_compatible() {
        "compatible, merged".to_owned()
    } else {
        format!("not compatible, not merged: {}", moved_words(comparison))
    };
    let _ = write!(
        text,
        "\nχ² {:.1} of {}, probability {:.2} (least {LEAST_PROBABILITY}): {verdict}",
        comparison.joint_chi2,
        UNKNOWNS * comparison.pairs,
        comparison.together_probability()
    );
    text
}
