//! The residual before a diagnosis is that of the input configuration: findings of the diagnosis do not lower it.

use std::fs;
use std::sync::Mutex;

use geu_diagnosis::{Diagnosis, DiagnosisOptions, Thresholds, diagnose_rows};
use geu_model::Configuration;
use geu_plant::{Gyro, IndependentModel, PlantedEffect};
use geu_tests::comparison::Recording;
use geu_tests::{geu, give_way};

/// Samples per window of the residual.
const WINDOW: usize = 3600;
/// Three thirds of half an hour.
const DURATION_S: f64 = 5400.0;

/// A recording of the independent model with a late reference.
fn recorded(injected: Vec<PlantedEffect>, reference_late_s: f64) -> Recording {
    give_way();
    let directory = tempfile::tempdir().expect("a directory");
    let recording = IndependentModel { duration_s: DURATION_S, ..IndependentModel::new(5, injected) }.record();
    let reported = recording.reference.lines().enumerate().map(|(line, text)| match text.split_once(',') {
        Some((t_s, rest)) if line > 0 => {
            format!("{:.6},{rest}", t_s.parse::<f64>().expect("a time") + reference_late_s)
        }
        _ => text.to_owned(),
    });
    let reported = reported.collect::<Vec<_>>().join("\n");
    let [link, reference] = ["link.log", "reference.csv"].map(|name| directory.path().join(name));
    fs::write(&link, recording.link).expect("written");
    fs::write(&reference, reported).expect("written");
    Recording::read(&link, &reference)
}

/// Diagnoses recordings of one scenario with the thresholds of the first; the residual before does not depend on them.
fn diagnosed(recording: &Recording, given: &Configuration) -> Diagnosis {
    static THRESHOLDS: Mutex<Option<Thresholds>> = Mutex::new(None);
    let mut thresholds = THRESHOLDS.lock().expect("no panic");
    let settings =
        DiagnosisOptions { known: &|_| thresholds.clone(), ..DiagnosisOptions::new(recording.reference.start_ns) };
    let diagnosis = diagnose_rows(&recording.rows, &[], given, &recording.reference, &settings).expect("a recording");
    *thresholds = Some(diagnosis.thresholds.clone());
    diagnosis
}

/// Rms of the windowed residual that another program computed, arcsec.
fn rms_arcsec(residuals: &[Vec<f64>; 4]) -> f64 {
    let values = residuals.iter().flat_map(|gyro| gyro.chunks(WINDOW));
    let values: Vec<f64> = values.flat_map(|window| window.iter().map(|value| value - window[0])).collect();
    (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
}

#[test]
fn a_wrong_calibration_is_predicted_from_two_thirds() {
    let recording = recorded(vec![], 0.0);
    // By 36 arcsec/h: 18 arcsec at the end of a window.
    let off = ["gyro.GYRX.calibration.drift_arcsec_per_half_s=0.215".to_owned()];
    let before = diagnosed(&recording, &Configuration::reference_with(&off).expect("valid")).before;
    // The other program uses the sample's index, this one the time of receipt, 0.9 ms later: 0.1 % here.
    let expected = rms_arcsec(&recording.against(&off).residuals);
    let [fitted, held_out] = [before.fitted.rms_arcsec, before.held_out.rms_arcsec];
    assert!((fitted / expected - 1.0).abs() < 0.01, "{fitted}, by the other program {expected}");
    // Two thirds determine the drift to 1 arcsec in half an hour.
    assert!(held_out < 0.5 * fitted, "{before:?}");
    assert!(before.held_out.reduced_chi2 < before.fitted.reduced_chi2, "{before:?}");
}

#[test]
fn an_estimated_lag_does_not_change_the_residual_before() {
    // Below the smallest time offset that is reported: the diagnosis subtracts it.
    let [on_time, late] = [0.0, 0.008].map(|late_s| diagnosed(&recorded(vec![], late_s), &Configuration::reference()));
    assert!((on_time.lag_s.0 - late.lag_s.0 - 0.008).abs() < 1e-3, "{:?} {:?}", on_time.lag_s, late.lag_s);
    let [on_time, late] = [on_time, late].map(|diagnosis| diagnosis.before.fitted.reduced_chi2);
    // 5.8 arcsec in each turn at 720 arcsec/s is seven times as much; without the lag both are equal.
    assert!(late > 3.0 * on_time, "{late}, on time {on_time}");
}

#[test]
fn a_rest_without_observable_lag_keeps_its_residual() {
    give_way();
    let directory = tempfile::tempdir().expect("a directory");
    for seed in ["4", "5"] {
        let run = directory.path().join(seed);
        let arguments = ["simulate", "--duration", "600", "--seed", seed, "--out"];
        assert!(geu().args(arguments).arg(&run).status().expect("geu starts").success());
        let recording = Recording::read(&run.join("link.log"), &run.join("reference.csv"));
        let settings = DiagnosisOptions::new(recording.reference.start_ns);
        let given = Configuration::reference();
        let diagnosis =
            diagnose_rows(&recording.rows, &[], &given, &recording.reference, &settings).expect("a recording");
        assert!(diagnosis.entries.is_empty() && diagnosis.lag_s.1 > 1.0, "{:?}", diagnosis.lag_s);
        let [before, after] = [diagnosis.before, diagnosis.after].map(|gaps| gaps.fitted.rms_arcsec);
        assert!((after / before - 1.0).abs() < 0.01, "{before}, after {after}");
    }
}

#[test]
fn estimated_noise_does_not_change_the_residual_before() {
    // Twenty times the configured random walk: chi2 is 1 with the estimated noise, 20 with the configured one.
    let walk = PlantedEffect::new("angle-random-walk", &geu_plant::GYROS, &[("arcsec_per_sqrt_s", 0.2)]);
    let diagnosis = diagnosed(&recorded(vec![walk], 0.0), &Configuration::reference());
    let [before, after] = [diagnosis.before, diagnosis.after].map(|gaps| gaps.fitted.reduced_chi2);
    assert!(before > 5.0 && after < 1.2, "{before}, after {after}");
}

#[test]
fn the_residual_before_includes_what_exact_checks_correct() {
    let inverted = PlantedEffect::new("sign-inversion-step", &[Gyro::Y], &[("on", 1.0), ("time_s", 3000.0)]);
    let diagnosis = diagnosed(&recorded(vec![inverted], 0.0), &Configuration::reference());
    // GYRY turns by degrees in each window.
    let before = diagnosis.before;
    assert!(before.fitted.rms_arcsec > 3600.0 && before.held_out.rms_arcsec > 3600.0, "{before:?}");
    let [first, rest @ ..] = &diagnosis.entries[..] else { panic!("nothing is reported") };
    assert_eq!(first.code, "sign-inversion-step");
    let shares: f64 = rest.iter().map(|entry| entry.gap_share).sum();
    assert!(first.gap_share > 0.999 && first.gap_share + shares <= 1.0, "{} {shares}", first.gap_share);
}
