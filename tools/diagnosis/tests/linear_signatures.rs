//! Signatures that a fit computes equal model runs.

use geu_diagnosis::fitted_hypothesis::FittedHypothesis;
use geu_diagnosis::linear_signatures::LinearSignatures;
use geu_diagnosis::measured::{CHANNELS, Shifts, TIMING};
use geu_diagnosis::whitening::NoiseModel;
use geu_diagnosis::{DiagnosisCase, SignatureBank};
use geu_hypothesis::Hypothesis;
use geu_hypothesis::amplitude::AmplitudeRef;
use geu_model::Configuration;
use geu_model::parameter_spec::Role;
use geu_protocol::Gyros;

use crate::recorded::{manoeuvre, recorded};

const NOISE: NoiseModel = NoiseModel { white: 0.01, angle_walk: 0.02, rate_walk: 2e-5, scale_walk: 0.0, flicker: 0.0 };
/// Root of the sum of squares from which a derivative is compared.
const VISIBLE_ARCSEC: f64 = 1e-4;

#[test]
fn computed_signatures_equal_model_runs() {
    let mut nominal = Configuration::reference();
    (nominal.scenario.theta_deg, nominal.scenario.psi_deg) = (90.0, 0.0);
    let rest = manoeuvre("pointing", &[("duration_s", 600.0)]);
    let scan = manoeuvre("z-scan", &[("angle_deg", 200.0)]);
    let measured = recorded(&nominal, &[rest.clone(), scan, rest], None);
    let linear = LinearSignatures::new(SignatureBank::new(&measured, &nominal).linear());
    let [runs, computed] = [LinearSignatures::default(), linear.clone()]
        .map(|linear| DiagnosisCase { linear, ..DiagnosisCase::new(&measured, &nominal) });
    let (mut compared, mut worst) = (0, (0.0, String::new()));
    for amplitude in
        AmplitudeRef::all(&nominal.device).into_iter().flat_map(|one| [one].into_iter().chain(one.with_courses()))
    {
        let own_shapes = amplitude.own_shapes().iter().map(|number| number.default.initial()).collect();
        let value = 1e-3 * amplitude.size().max;
        let mut hypothesis =
            Hypothesis { own_shapes, ..Hypothesis::constant(amplitude, value, amplitude.gyros(&nominal.device)) };
        let values = amplitude.course_shapes().iter().map(|shape| match shape.role {
            Role::Onset => 603.0,
            _ => shape.default.initial(),
        });
        hypothesis.course_shapes = values.collect();
        if linear.column(&measured, &nominal, &hypothesis, 0, 0.0).is_none() {
            continue;
        }
        let columns = [&runs, &computed].map(|case| {
            let mut state = case.start([NOISE; CHANNELS]);
            state.held.push(FittedHypothesis::new(hypothesis.clone()));
            case.linearised(&mut state).1
        });
        for (run, own) in columns[0].iter().zip(&columns[1]).skip(runs.nuisances.len()) {
            let squares = |of: &dyn Fn(f64, f64) -> f64| -> f64 {
                let of_channel = |channel: usize| match (&run[channel], &own[channel]) {
                    (Some(run), Some(own)) => run.iter().zip(own).map(|(&run, &own)| of(run, own).powi(2)).sum(),
                    (Some(run), None) => run.iter().map(|&run| of(run, 0.0).powi(2)).sum(),
                    (None, Some(own)) => own.iter().map(|&own| of(0.0, own).powi(2)).sum(),
                    (None, None) => 0.0,
                };
                (0..CHANNELS).map(of_channel).sum()
            };
            let size = squares(&|run, _| run).sqrt();
            if size < VISIBLE_ARCSEC {
                continue;
            }
            let departure = squares(&|run, own| own - run).sqrt() / size;
            compared += 1;
            if departure > worst.0 {
                worst = (departure, hypothesis.amplitude.code());
            }
        }
    }
    println!("{compared} compared, largest departure {} of {}", worst.0, worst.1);
    assert!(compared > 100 && worst.0 < 0.1, "{compared} compared, largest departure {} of {}", worst.0, worst.1);
}

#[test]
fn signatures_of_formulas_equal_model_runs() {
    let mut nominal = Configuration::reference();
    (nominal.scenario.theta_deg, nominal.scenario.psi_deg) = (90.0, 0.0);
    let rest = manoeuvre("pointing", &[("duration_s", 600.0)]);
    let scan = manoeuvre("z-scan", &[("angle_deg", 200.0)]);
    let measured = recorded(&nominal, &[rest.clone(), scan, rest], None);
    let formulas = SignatureBank::new(&measured, &nominal).formulas(&measured, &nominal);
    assert!(formulas.bases.len() > 400);
    let before = measured.run(&nominal, Shifts::default());
    for (index, own) in formulas.bases.iter().enumerate().step_by(41) {
        let gyro = index % TIMING;
        let mut moved = nominal.clone();
        Hypothesis::constant(own.amplitude, 1e-6, Gyros::ALL.only(gyro)).apply(&mut moved);
        let run = measured.difference(&measured.run(&moved, Shifts::default()), &before);
        let largest = own.series[gyro].iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
        for (run, own_value) in run[gyro].iter().zip(own.series[gyro].iter()) {
            let departure = (run / 1e-6 - own_value).abs();
            // Other effects of the unit act on what a term adds: its scale factor follows the temperature.
            assert!(departure <= 1e-3 * largest + 1e-3, "{}: {departure} of {largest}", own.amplitude.code());
        }
    }
}
