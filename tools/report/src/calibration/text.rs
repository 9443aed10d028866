//! A calibration and a comparison of several as tables for a terminal.

use std::fmt::Write;

use geu_calibration::compare::{MIN_PROBABILITY, stability_per_day};
use geu_calibration::solve::{CalibrationParameter, PER_GYRO, Solution, UNKNOWNS, values_of};
use geu_calibration::{Calibrated, Comparison, PreviousCalibration};
use geu_model::Configuration;
use geu_model::package::Calibration;
use geu_model::units::{ARCSEC_PER_DEG, AngleUnit, S_PER_H, SAMPLE_INTERVAL_S};
use geu_protocol::{Gyro, map};

use super::{moved_words, number_and_unit, sigma_unit};
use crate::page::filled;
use crate::text_table::text_table;

/// The result for a terminal.
pub fn table(prior: &Configuration, calibrated: &Calibrated) -> String {
    let solution = &calibrated.solution;
    let (parameters, is_described) = (&solution.parameters, solution.is_described());
    let angle = prior.device.angle_unit();
    let (solved, sigmas) = (solution.values(), solution.sigmas());
    let before = values_of(parameters, &calibrations(prior));
    let hand = calibrated.first_order.as_ref().map(|hand| values_of(parameters, hand));
    let rows = parameters.iter().enumerate().map(|(index, parameter)| {
        let number = |value: f64| match parameter.index {
            0 => format!("{value:.7}"),
            1 if !is_described => format!("{value:.6}"),
            _ => number_and_unit(*parameter, value, angle).0,
        };
        let unit = match parameter.index {
            1 if !is_described => "arcsec/half s".to_owned(),
            _ => number_and_unit(*parameter, 0.0, angle).1,
        };
        let hand = hand
            .as_ref()
            .map_or_else(|_| "–".to_owned(), |hand| format!("{:+.1}", (hand[index] - solved[index]) / sigmas[index]));
        let sigma = match parameter.index {
            0 => format!("{:.3} ppm", sigmas[index] * 1e6),
            _ => number(sigmas[index]),
        };
        let change = format!("{:+.1}", (solved[index] - before[index]) / sigmas[index]);
        match solution.is_determined(*parameter) {
            true => [parameter.label(), number(solved[index]), sigma, unit, change, hand],
            false => [parameter.label(), "not determined".to_owned(), "–".to_owned(), unit, "–".to_owned(), hand],
        }
    });
    let header = ["parameter", "value", "sigma", "unit", "change/σ", "hand method/σ"];
    let text = match is_described {
        true => {
            let rows = rows.map(|[label, value, sigma, unit, change, _]| [label, value, sigma, unit, change]);
            text_table("<36 >14 >11  <14 >10", ["parameter", "value", "sigma", "unit", "change/σ"], rows)
        }
        false => text_table("<26 >14 >11  <14 >10  >14", header, rows),
    };
    let noise = calibrated.reference_sigma_arcsec;
    let values = map! {
        table: text,
        manoeuvres: if is_described { described_lines(calibrated, angle).join("\n") } else { manoeuvre_table(calibrated) },
        chi2: solution.chi2,
        freedom: solution.degrees_of_freedom as u32,
        probability: solution.probability(),
        condition: solution.condition,
        no_hand: calibrated.first_order.as_ref().err().filter(|_| !is_described).map(ToString::to_string),
        noise: noise.iter().any(|sigma| *sigma > 0.0).then(|| noise.map(|sigma| angle.fixed(sigma, 2)).to_vec()),
        angle: angle.name,
        is_unexplained: solution.probability() < MIN_PROBABILITY,
    };
    filled(include_str!("text.txt"), &values).trim_end().to_owned()
}

/// Further results of a described unit.
pub fn described_lines(calibrated: &Calibrated, angle: AngleUnit) -> Vec<String> {
    let Calibrated { solution, observations, noise, .. } = calibrated;
    let mut lines = vec![format!("{} windows", observations.len())];
    let open: Vec<String> = solution.open().into_iter().map(CalibrationParameter::label).collect();
    if !open.is_empty() {
        let largest = |axis: usize| {
            let turned = observations.iter().map(|own| own.rotation_control_arcsec[axis].abs());
            turned.fold(0.0, f64::max) / ARCSEC_PER_DEG
        };
        lines.push(format!(
            "the motion does not determine {}: within a window it turns by at most {:.3}, {:.3}, {:.3} deg about X, Y, Z, or about these \
             axes only together",
            open.join(", "),
            largest(0),
            largest(1),
            largest(2)
        ));
    }
    let [offset, clock] = solution.times();
    lines.extend(offset.map(|(value, sigma)| format!("time offset: {:+.3} ± {:.3} ms", value * 1e3, sigma * 1e3)));
    lines.extend(clock.map(|(value, sigma)| format!("clock: {:+.3} ± {:.3} ppm", value * 1e6, sigma * 1e6)));
    let walks = gyros(solution).zip(noise).map(|(gyro, walk)| format!("{} {}", gyro.name(), angle.fixed(*walk, 5)));
    lines.push(format!("angle random walk: {} {}/√s", walks.collect::<Vec<_>>().join(", "), angle.name));
    lines.extend(solution.trial_drifts.iter().map(|trial| {
        let per_h = |arcsec: f64, decimals| angle.fixed(arcsec * S_PER_H / SAMPLE_INTERVAL_S, decimals);
        let drift = |(gyro, own): (Gyro, &Option<(f64, f64)>)| match own {
            Some((drift, sigma)) => format!("{} {} ± {}", gyro.name(), per_h(*drift, 1), per_h(*sigma, 1)),
            None => format!("{} not determined", gyro.name()),
        };
        let drifts: Vec<String> = gyros(solution).zip(&trial.drifts).map(drift).collect();
        format!("drift in trial {} beside the first: {} {}/h", trial.trial, drifts.join(", "), angle.name)
    }));
    lines.extend(solution.parity.iter().map(|own| {
        let weights: Vec<String> =
            own.weights.iter().map(|(gyro, weight)| format!("{weight:+.3} {}", gyro.name())).collect();
        format!(
            "parity residual of {} over a window: rms {} {}, by the noise {}; largest {:.1} sigma at {:.1} s",
            weights.join(" "),
            angle.fixed(own.rms_arcsec, 4),
            angle.name,
            angle.fixed(own.sigma_arcsec, 4),
            own.largest_sigmas,
            observations[own.largest].start_s
        )
    }));
    lines
}

/// Gyros of the unit.
pub fn gyros(solution: &Solution) -> impl Iterator<Item = Gyro> {
    solution.parameters.iter().step_by(PER_GYRO).map(|own| own.gyro)
}

/// Calibration of each gyro of a unit.
pub fn calibrations(configuration: &Configuration) -> Vec<Calibration> {
    configuration.gyros.iter().map(|own| own.calibration).collect()
}

fn manoeuvre_table(calibrated: &Calibrated) -> String {
    let Calibrated { solution, observations, .. } = calibrated;
    let rows = observations.iter().enumerate().map(|(index, observation)| {
        let residual = |gyro: Gyro| {
            let residual = solution.residuals.iter().find(|found| found.manoeuvre == index && found.gyro == gyro);
            let text = residual.map(|found| format!("{:+.1}", found.arcsec / found.sigma_arcsec));
            format!("{:>6}", text.as_deref().unwrap_or("–"))
        };
        [
            observation.name.clone(),
            format!("{:.1}", observation.start_s),
            format!("{:.1}", observation.end_s - observation.start_s),
            format!("{:.2}", solution.leverage[index]),
            Gyro::ALL.map(residual).join(" "),
        ]
    });
    let residuals = format!("residual/σ of {}", Gyro::ALL.map(Gyro::name).join(" "));
    text_table("<14 >10 >10 >9   <0", ["manoeuvre", "start s", "length s", "leverage", &residuals], rows)
}

/// The comparison for a terminal.
pub fn comparison_table(earlier: &[PreviousCalibration], comparison: &Comparison) -> String {
    let names: Vec<&str> = earlier.iter().map(|one| one.name.as_str()).collect();
    let mut text = format!("less the mean of {}\n", names.join(", "));
    let rows = CalibrationParameter::all().enumerate().map(|(index, parameter)| {
        let (size, unit) = sigma_unit(parameter);
        let allowed = stability_per_day(parameter).map(|rate| format!("{:.1} {unit}", rate * 14.0 * size));
        [
            parameter.label(),
            format!("{:+.3}", comparison.change[index] * size),
            format!("{:.3}", comparison.sigmas[index] * size),
            unit.to_owned(),
            format!("{:+.1}", comparison.change[index] / comparison.sigmas[index]),
            format!("{:.1}", comparison.chi2[index]),
            format!("{:.4}", comparison.probability(index)),
            allowed.unwrap_or_else(|| "–".to_owned()),
        ]
    });
    let header = ["parameter", "change", "sigma", "", "change/σ", "χ²", "probability", "stability a fortnight"];
    text += &text_table("<26 >12 >12 <9 >9 >8 >12  >22", header, rows);
    let verdict = if comparison.is_compatible() {
        "compatible, merged".to_owned()
    } else {
        format!("not compatible, not merged: {}", moved_words(comparison))
    };
    let _ = write!(
        text,
        "\nχ² {:.1} of {}, probability {:.2} (minimum {MIN_PROBABILITY}): {verdict}",
        comparison.joint_chi2,
        UNKNOWNS * comparison.pairs,
        comparison.joint_probability()
    );
    text
}
