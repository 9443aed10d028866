//! Every deterministic effect, if configured with its true value, leaves the calibration parameters correct.

use geu_calibration::checkout::{AttitudeSourceKind, Precautions, sequence, simulate};
use geu_calibration::solve::{CalibrationParameter, values};
use geu_model::Configuration;
use geu_model::effect::{Effects, GyroEffects, UnitEffects};
use geu_model::package::Axes;
use geu_model::parameter_spec::ParameterSpec;
use geu_protocol::Gyro;
use rayon::prelude::*;

/// The effect that takes slow rotation out of the counts, which carry the attitude from one star fix to the next: its loss is
/// known from a reference attitude alone.
const DEAD_ZONE: &str = "dead-zone";

/// About the paper's value, or ten times its detection limit; 1 % of the maximum for other effects.
fn typical(code: &str, amplitude: &ParameterSpec) -> f64 {
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
        "scale-factor-asymmetry" | "scale-factor-quadratic" => 200.0,
        DEAD_ZONE => 0.3,
        "drift-temperature-hysteresis" => 5.0,
        _ => amplitude.max / 100.0,
    }
}

/// The reference unit with one effect more, of the unit or of every gyro.
fn with(code: &str) -> Configuration {
    let mut unit = Configuration::reference();
    if let Some(index) = UnitEffects::SPECS.iter().position(|spec| spec.code == code) {
        let numbers = unit.unit.constant.numbers_mut(index);
        for amplitude in 0..UnitEffects::SPECS[index].amplitudes.len() {
            *numbers.value_mut(amplitude) = typical(code, &numbers.specs()[amplitude]);
        }
    }
    if let Some(index) = GyroEffects::SPECS.iter().position(|spec| spec.code == code) {
        for (gyro, own) in Gyro::ALL.into_iter().zip(&mut unit.gyros) {
            // Within the run; without effect unless counts are lost.
            own.effects.constant.lost_counts.time_s = 2000.0;
            let numbers = own.effects.constant.numbers_mut(index);
            for amplitude in 0..GyroEffects::SPECS[index].amplitudes.len() {
                if Axes::of(gyro).has_number(numbers.specs()[amplitude].name) {
                    *numbers.value_mut(amplitude) = typical(code, &numbers.specs()[amplitude]);
                }
            }
        }
    }
    sequence(&unit, Precautions { stabilisation: false, ..Precautions::ALL })
}

/// Defects of a calibration with the effect; empty if there are none.
fn defects(code: &str) -> Vec<String> {
    let unit = with(code);
    let run = simulate(&unit);
    // The configured calibration has the errors of a fortnight; the effects are known.
    let mut configured = unit.clone();
    for gyro in &mut configured.gyros {
        gyro.calibration.scale_factor += 20e-6;
        gyro.calibration.drift_arcsec_per_half_s += 6.0 / 7200.0;
    }
    let truth = values(&unit.calibrations());
    let mut all = Vec::new();
    let by_both = [AttitudeSourceKind::Reference, AttitudeSourceKind::Sensors];
    for by in if code == DEAD_ZONE { &by_both[..1] } else { &by_both } {
        let solution = match run.calibrate(&configured, *by) {
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
fn every_configured_effect_leaves_the_calibration_correct() {
    // Random effects cannot be subtracted.
    let of_gyros = (0..GyroEffects::SPECS.len()).filter(|index| !GyroEffects::default().is_noise(*index));
    let of_gyros = of_gyros.map(|index| &GyroEffects::SPECS[index]);
    let codes: Vec<&str> = UnitEffects::SPECS.iter().chain(of_gyros).map(|spec| spec.code).collect();
    let found: Vec<String> = codes.par_iter().flat_map(|code| defects(code)).collect();
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn a_dead_zone_fails_the_test_of_a_calibration_with_sensors() {
    let unit = with(DEAD_ZONE);
    let solution = simulate(&unit).calibrate(&unit, AttitudeSourceKind::Sensors).expect("determined").solution;
    assert!(solution.probability() < 1e-3, "χ² {:.1} of {}", solution.chi2, solution.degrees_of_freedom);
}
