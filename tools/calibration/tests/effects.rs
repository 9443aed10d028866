//! Every effect with a law, believed as it is, leaves the sixteen parameters where the unit has them.

use geu_calibration::checkout::{AttitudeSourceKind, Precautions, fly, sequence};
use geu_calibration::solve::{CalibrationParameter, values};
use geu_model::Configuration;
use geu_model::effect::{Effects, GyroEffects, UnitEffects};
use geu_model::package::Axes;
use geu_protocol::Gyro;
use rayon::prelude::*;

/// Effects that draw from a stream: nothing of them can be taken off.
const NOISES: [&str; 2] = ["angle-random-walk", "drift-random-walk"];

/// About what the paper has, or ten times what it could not see.
fn middling(code: &str) -> f64 {
    match code {
        "misalignment-thermal" => 0.5,
        "clock-frequency" => 20.0,
        "time-offset" => 0.4,
        "misalignment" => 30.0,
        "output-axis-acceleration" | "anisoinertia" => 0.01,
        "pivot-clearance" => 14.0,
        "scale-factor-nonlinearity" => 800.0,
        "drift" | "lost-counts" => 20.0,
        "drift-sensor-temperature" => 2.0,
        "scale-factor" => 500.0,
        "scale-factor-asymmetry" => 200.0,
        _ => panic!("{code}: no amplitude is told"),
    }
}

/// The reference unit with one effect more, of the unit or of every gyro.
fn with(code: &str) -> Configuration {
    let mut unit = Configuration::reference();
    if let Some(index) = UnitEffects::SPECS.iter().position(|spec| spec.code == code) {
        let numbers = unit.unit.constant.numbers_mut(index);
        (0..UnitEffects::SPECS[index].amplitudes.len())
            .for_each(|amplitude| *numbers.value_mut(amplitude) = middling(code));
    }
    if let Some(index) = GyroEffects::SPECS.iter().position(|spec| spec.code == code) {
        for (gyro, own) in Gyro::ALL.into_iter().zip(&mut unit.gyros) {
            // In the course of the flight; it does nothing where no count is lost.
            own.effects.constant.lost_counts.time_s = 2000.0;
            let numbers = own.effects.constant.numbers_mut(index);
            for amplitude in 0..GyroEffects::SPECS[index].amplitudes.len() {
                if Axes::of(gyro).has_number(numbers.specs()[amplitude].name) {
                    *numbers.value_mut(amplitude) = middling(code);
                }
            }
        }
    }
    sequence(&unit, Precautions { stabilisation: false, ..Precautions::ALL })
}

/// What is wrong with a calibration of it, nothing where all is well.
fn wrong(code: &str) -> Vec<String> {
    let unit = with(code);
    let flight = fly(&unit);
    // The calibration that is believed is off by what a fortnight leaves; the effects are known.
    let mut believed = unit.clone();
    for gyro in &mut believed.gyros {
        gyro.calibration.scale_factor += 20e-6;
        gyro.calibration.drift_arcsec_per_half_s += 6.0 / 7200.0;
    }
    let truth = values(&unit.gyros.each_ref().map(|gyro| gyro.calibration));
    let mut all = Vec::new();
    for by in [AttitudeSourceKind::Reference, AttitudeSourceKind::Sensors] {
        let solution = match flight.calibrate(&believed, by) {
            Ok(calibrated) => calibrated.solution,
            Err(error) => {
                all.push(format!("{code}, {by:?}: {error}"));
                continue;
            }
        };
        if solution.probability() <= 1e-4 {
            all.push(format!("{code}, {by:?}: χ² {:.1} of {}", solution.chi2, solution.degrees_of_freedom));
        }
        let solved = solution.values().into_iter().zip(solution.sigmas()).zip(truth);
        for (parameter, ((value, sigma), truth)) in CalibrationParameter::all().zip(solved) {
            let off = (value - truth) / sigma;
            if off.is_nan() || off.abs() >= 4.5 {
                all.push(format!("{code}, {by:?}: {}: off by {off:+.1} sigma", parameter.label()));
            }
        }
    }
    all
}

#[test]
fn every_effect_that_is_believed_leaves_the_calibration_as_it_is() {
    let codes: Vec<&str> = UnitEffects::SPECS
        .iter()
        .chain(GyroEffects::SPECS)
        .map(|spec| spec.code)
        .filter(|code| !NOISES.contains(code))
        .collect();
    let found: Vec<String> = codes.par_iter().flat_map(|code| wrong(code)).collect();
    assert!(found.is_empty(), "{}", found.join("\n"));
}
