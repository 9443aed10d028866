//! Diagnosis of healthy units under the conditions of real recordings, on an independent model: star trackers with gaps, glitches and
//! stated sigmas, closed loops, sparse rates. No name.

use geu_diagnosis::outcome::DiagnosedEffect;
use geu_diagnosis::{Diagnosis, Verdict};
use geu_plant::{GYROS, Gyro, IndependentModel, MotionKind, PlantedEffect, ReferenceKind};

use crate::diagnosed::{
    STAR_TRACKER, as_recorded, assert_consistent, assert_named, diagnosed, diagnosed_beside, diagnosed_with_losses,
    missing,
};

/// Quaternions of which a third, in runs of `rows`, has 40″ of noise and the others 4″, with a column of `stated` times these.
fn uneven(rows: usize, stated: f64) -> ReferenceKind {
    ReferenceKind::UnevenQuaternions { steps: 40, sigma_arcsec: 4.0, rows, stated }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn a_star_tracker_with_a_gap_and_glitches_yields_no_name() {
    for (seed, motion) in [(301, MotionKind::Survey), (302, MotionKind::QuietSurvey), (303, MotionKind::ClosedLoop)] {
        let model = IndependentModel { reference: STAR_TRACKER, motion, ..IndependentModel::new(seed, Vec::new()) };
        // Five minutes without a row, and three rows off by 200″ about an axis.
        let diagnosis = diagnosed(&model, |row, text| match row {
            4000..4300 => None,
            700 | 5200 | 9001 => {
                let mut fields: Vec<f64> = text.split(',').map(|field| field.parse().expect("a number")).collect();
                let before = fields[2];
                fields[2] += 0.0005;
                let scale = (1.0 - fields[2] * fields[2]).sqrt() / (1.0 - before * before).sqrt();
                [1, 3, 4].iter().for_each(|part| fields[*part] *= scale);
                Some(format!(
                    "{:.4},{:.10},{:.10},{:.10},{:.10}",
                    fields[0], fields[1], fields[2], fields[3], fields[4]
                ))
            }
            _ => Some(text.to_owned()),
        });
        assert_consistent(&diagnosis);
        let kinds: Vec<&str> = diagnosis.findings.iter().map(|finding| finding.kind.as_str()).collect();
        assert!(kinds.contains(&"reference-gap") && kinds.contains(&"reference-glitch"), "{kinds:?}");
    }
}

fn has_finding(diagnosis: &Diagnosis, kind: &str) -> bool {
    diagnosis.findings.iter().any(|finding| finding.kind == kind)
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn noisy_rows_that_state_their_sigma_yield_no_name() {
    for (seed, motion, rows) in [(381, MotionKind::Survey, 1), (382, MotionKind::QuietSurvey, 600)] {
        let model =
            IndependentModel { reference: uneven(rows, 1.0), motion, ..IndependentModel::new(seed, Vec::new()) };
        let diagnosis = diagnosed(&model, as_recorded);
        assert_consistent(&diagnosis);
        assert!(!has_finding(&diagnosis, "reference-sigma") && !has_finding(&diagnosis, "reference-glitch"));
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn a_pivot_is_named_beside_noisy_rows_that_state_their_sigma() {
    for (seed, gyro, rows) in [(384, Gyro::Y, 1), (385, Gyro::X, 600)] {
        let injected = PlantedEffect::new("pivot-clearance", &[gyro], &[("clearance_arcsec", 9.3)]);
        let reference = uneven(rows, 1.0);
        let diagnosis = diagnosed(
            &IndependentModel { reference, ..IndependentModel::new(seed, vec![injected.clone()]) },
            as_recorded,
        );
        assert_named(&diagnosis, &injected);
        assert!(!has_finding(&diagnosis, "reference-sigma"));
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn sigmas_that_are_stated_five_times_too_small_are_found_and_yield_no_name() {
    for (seed, rows) in [(387, 1), (388, 600)] {
        let model = IndependentModel { reference: uneven(rows, 0.2), ..IndependentModel::new(seed, Vec::new()) };
        let diagnosis = diagnosed(&model, as_recorded);
        assert_consistent(&diagnosis);
        assert!(has_finding(&diagnosis, "reference-sigma"));
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn slews_without_a_limit_cycle_yield_no_name() {
    for (seed, motion) in [(321, MotionKind::ClosedLoop), (322, MotionKind::ClosedLoop), (323, MotionKind::RateTable)] {
        let model = IndependentModel { motion, ..IndependentModel::new(seed, Vec::new()) };
        assert_consistent(&diagnosed(&model, as_recorded));
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn lost_frames_in_a_closed_loop_yield_no_name() {
    for seed in [324, 325, 326] {
        let model = IndependentModel { motion: MotionKind::ClosedLoop, ..IndependentModel::new(seed, Vec::new()) };
        assert_consistent(&diagnosed_with_losses(&model));
    }
}

/// Small motions against these references contain the noise of the gyros.
#[test]
#[ignore = "minutes; .ci/run has it"]
fn slews_against_slow_references_yield_no_name() {
    let hertz = |steps: usize, sigma_arcsec: f64| ReferenceKind::Quaternions { steps, sigma_arcsec };
    for (seed, motion, reference) in [
        (371, MotionKind::ClosedLoop, hertz(40, 5.0)),
        (372, MotionKind::ClosedLoop, hertz(40, 5.0)),
        (373, MotionKind::RateTable, hertz(400, 3.0)),
    ] {
        let model = IndependentModel { motion, reference, ..IndependentModel::new(seed, Vec::new()) };
        assert_consistent(&diagnosed(&model, as_recorded));
    }
}

/// Rows of which the sensor had lost the attitude, one and three in succession, and twenty that are missing.
fn dropouts(row: usize, text: &str) -> Option<String> {
    match row {
        1000 | 2500..2520 => None,
        1800 | 3001..3004 => Some(format!("{},1,0,0,0", text.split(',').next().unwrap_or_default())),
        _ => Some(text.to_owned()),
    }
}

/// From exact rows to rows with more noise than the rounding of the counts.
#[test]
#[ignore = "minutes; .ci/run has it"]
fn fast_quaternions_of_little_noise_with_dropouts_yield_no_name() {
    let every = |steps: usize, sigma_arcsec: f64| ReferenceKind::Quaternions { steps, sigma_arcsec };
    for (seed, reference) in
        [(391, every(20, 0.0)), (392, every(20, 0.3)), (393, every(20, 0.7)), (394, every(40, 0.0))]
    {
        for motion in [MotionKind::Survey, MotionKind::QuietSurvey, MotionKind::RateTable] {
            let model = IndependentModel { reference, motion, ..IndependentModel::new(seed, Vec::new()) };
            let diagnosis = diagnosed(&model, dropouts);
            assert_consistent(&diagnosis);
            assert!(has_finding(&diagnosis, "reference-gap"));
            let left_out = diagnosis.findings.iter().find(|finding| finding.kind == "reference-glitch");
            let text = &left_out.expect("a finding").text;
            assert!(text.contains("beside them: 4; they are left out"), "{text}");
        }
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn a_pivot_is_named_beside_exact_quaternions_with_dropouts() {
    for (seed, gyro, steps) in [(395, Gyro::Y, 20), (396, Gyro::X, 20), (397, Gyro::X, 40)] {
        let injected = PlantedEffect::new("pivot-clearance", &[gyro], &[("clearance_arcsec", 9.3)]);
        let reference = ReferenceKind::Quaternions { steps, sigma_arcsec: 0.0 };
        let model = IndependentModel { reference, ..IndependentModel::new(seed, vec![injected.clone()]) };
        assert_named(&diagnosed(&model, dropouts), &injected);
    }
}

/// Rates every 20 s lose the motion between: the recording differs from the model, but nothing is named.
#[test]
#[ignore = "minutes; .ci/run has it"]
fn sparse_rates_yield_no_name() {
    let sparse = |row: usize, text: &str| (row % 40 == 1).then(|| text.to_owned());
    let diagnosis = diagnosed(&IndependentModel::new(398, Vec::new()), sparse);
    assert_eq!((diagnosis.verdict, missing(&diagnosis).count()), (Verdict::Unexplained, 0));
    assert!(!diagnosis.entries.iter().any(DiagnosedEffect::is_below_threshold));
}

/// Noise of a real gyro, declared too small, as it is, and too large.
#[test]
#[ignore = "minutes; .ci/run has it"]
fn noise_yields_no_other_name_whatever_is_declared() {
    let walk = PlantedEffect::new("angle-random-walk", &GYROS, &[("arcsec_per_sqrt_s", 0.3)]);
    let flicker = PlantedEffect::new("bias-instability", &GYROS, &[("arcsec_per_h", 20.0)]);
    for seed in [411, 412] {
        let model = IndependentModel::new(seed, vec![walk.clone(), flicker.clone()]);
        for declared in [0.01, 0.3, 1.0] {
            let diagnosis = diagnosed_beside(&model, "angle-random-walk.arcsec_per_sqrt_s", declared);
            let is_noise = |entry: &DiagnosedEffect| [&walk.code, &flicker.code].contains(&&entry.code);
            assert!(missing(&diagnosis).all(is_noise));
            assert_eq!(missing(&diagnosis).any(|entry| entry.code == walk.code), declared < 0.3);
            assert_eq!(has_finding(&diagnosis, "noise-smaller"), declared > 0.3);
        }
    }
}
