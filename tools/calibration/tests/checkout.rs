//! The checkout simulated and calibrated (Casteren §5, §6).

use geu_calibration::checkout::{
    AttitudeSourceKind, Precautions, before_checkout, campaign, precautions, sequence, simulate, true_calibrations,
};
use geu_calibration::solve::{CalibrationParameter, values};
use geu_calibration::{AccumulatedCounts, AttitudeSource, calibrate, combine};
use geu_model::{Configuration, GyroUnit};

fn reference(overrides: &[&str]) -> Configuration {
    let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
    Configuration::reference_with(&overrides).expect("valid")
}

fn with_pivots_and_bending() -> Configuration {
    let pivots =
        ["GYRX", "GYRY", "GYRZA", "GYRZB"].map(|gyro| format!("gyro.{gyro}.pivot-clearance.clearance_arcsec=14"));
    let mut overrides: Vec<&str> = pivots.iter().map(String::as_str).collect();
    overrides.push("unit.misalignment-thermal={ arcsec_per_deg = 0.5, time_constant_s = 300.0 }");
    reference(&overrides)
}

#[test]
fn exact_increments_recover_the_parameters() {
    let unit = sequence(&reference(&[]).without_noise(), Precautions { stabilisation: false, ..Precautions::ALL });
    let run = simulate(&unit);
    // The same run before rounding.
    let mut exact = AccumulatedCounts::starting_at(run.counts.start_ns);
    let mut model = GyroUnit::new(&unit);
    for _ in 0..run.counts.len() {
        let (ended, traces) = model.end_sample_traced();
        exact.push(ended.end_ns as f64 * 1e-9, &traces.iter().map(|trace| trace.unquantised).collect::<Vec<_>>(), 20.0);
    }
    let attitude = AttitudeSource::Reference(&run.reference, Some([0.0; 3]));
    let calibrated = calibrate(&before_checkout(&unit), &exact, Some(&run.windows), &attitude).expect("determined");
    let truth = values(&true_calibrations(&unit));
    for ((parameter, solved), truth) in CalibrationParameter::all().zip(calibrated.solution.values()).zip(truth) {
        let limit = if parameter.index == 0 { 1e-9 } else { 1e-6 };
        assert!((solved - truth).abs() < limit, "{}: {solved} instead of {truth}", parameter.label());
    }
    assert!(calibrated.solution.chi2 < 1e-6 && calibrated.solution.degrees_of_freedom == 8);
}

#[test]
fn errors_of_many_runs_scatter_as_predicted() {
    for by in [AttitudeSourceKind::Reference, AttitudeSourceKind::Sensors] {
        let campaign = campaign(&reference(&[]), 7, 60, by, || {});
        assert!(campaign.failed.is_empty(), "{:?}", campaign.failed);
        let count = 60.0 * campaign.scatter.len() as f64;
        let coverage = campaign.scatter.iter().map(|found| found.coverage).sum::<f64>() / campaign.scatter.len() as f64;
        // 5 sigma of a share of 68.3 % among as many; parameters of one run are correlated, the gyros' four little.
        assert!((coverage - 0.683).abs() < 5.0 * (0.683f64 * 0.317 / count).sqrt(), "{by:?}: {coverage}");
        // Of 60 runs: 68 % ± 6 %; no parameter beyond 4 sigma.
        for found in &campaign.scatter {
            assert!((0.44..0.92).contains(&found.coverage), "{by:?} {}: {}", found.parameter.label(), found.coverage);
        }
        // 480 degrees of freedom: 1 ± 0.065.
        assert!((0.68..1.3).contains(&campaign.mean_reduced_chi2), "{by:?}: {}", campaign.mean_reduced_chi2);
    }
}

#[test]
fn a_campaign_does_not_depend_on_the_number_of_threads() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| campaign(&reference(&[]), 3, 5, AttitudeSourceKind::Sensors, || {}))
    };
    assert_eq!(run(1), run(2));
}

#[test]
fn star_and_sun_sensor_meet_the_accuracy_of_the_paper() {
    let unit = sequence(&reference(&[]), Precautions::ALL);
    let run = simulate(&unit);
    let truth = values(&true_calibrations(&unit));
    for by in [AttitudeSourceKind::Sensors, AttitudeSourceKind::Reference] {
        let calibrated = run.calibrate(&before_checkout(&unit), by).expect("determined");
        assert_eq!(calibrated.observations.len(), 6);
        let (solved, sigmas) = (calibrated.solution.values(), calibrated.solution.sigmas());
        for (index, parameter) in CalibrationParameter::all().enumerate() {
            assert!((solved[index] - truth[index]).abs() < 5.0 * sigmas[index], "{by:?} {}", parameter.label());
            match parameter.index {
                0 => assert!(sigmas[index] < 20e-6, "{} {}", parameter.label(), sigmas[index]),
                1 => assert!(sigmas[index] * 7200.0 < 6.0, "{} {}", parameter.label(), sigmas[index] * 7200.0),
                _ => {}
            }
        }
        assert!(calibrated.solution.probability() > 1e-4, "{by:?}: {}", calibrated.solution.chi2);
    }
}

#[test]
fn each_precaution_has_the_benefit_of_the_paper() {
    let outcomes = precautions(&with_pivots_and_bending()).expect("determined");
    let largest = |what: &str| {
        let outcome = outcomes.iter().find(|outcome| outcome.what == what).unwrap_or_else(|| panic!("{what}"));
        outcome.equation_arcsec.each_ref().map(|(arcsec, _)| arcsec.abs())
    };
    // Roundings at both ends of a manoeuvre, and the residue of the floats' creep.
    let rounding = 1.5;
    let [x, y, za, zb] = largest("pivots: every precaution");
    assert!([x, y, za, zb].iter().all(|&arcsec| arcsec < rounding), "{x} {y} {za} {zb}");
    // §3.3: the floats of GYRX and GYRZA go from the preferred position to a stop, half of 14″, in the scan.
    let [x, y, za, zb] = largest("pivots: no pre-slew about Y");
    assert!((x - 7.0).abs() < rounding && (za - 7.0).abs() < rounding, "{x} {za}");
    assert!(y < rounding && zb < rounding, "{y} {zb}");
    // §5.3: those of GYRY and GYRZB are at opposite stops at its two ends, all of 14″.
    let [x, y, za, zb] = largest("pivots: no correction by the clearance");
    assert!((y - 14.0).abs() < rounding && (zb - 14.0).abs() < rounding, "{y} {zb}");
    assert!(x < rounding && za < rounding, "{x} {za}");
    let [_, y, _, zb] = largest("pivots: clearance assumed 3 arcsec too large");
    assert!((y - 3.0).abs() < rounding && (zb - 3.0).abs() < rounding, "{y} {zb}");
}

#[test]
fn two_sequences_of_one_unit_are_compatible_and_of_two_units_are_not() {
    let short = Precautions { stabilisation: false, ..Precautions::ALL };
    let solve = |overrides: &[&str], seed: u64| {
        let mut unit = sequence(&reference(overrides), short);
        unit.seed = seed;
        simulate(&unit).calibrate(&before_checkout(&unit), AttitudeSourceKind::Sensors).expect("determined").solution
    };
    let (first, second) = (solve(&[], 1), solve(&[], 2));
    let same = combine(&first, &second).expect("invertible");
    // χ² of 16 degrees of freedom: 45 has a probability of 10⁻⁴.
    assert!(same.joint_chi2 < 45.0, "{}", same.joint_chi2);
    for (both, one) in same.combined.sigmas().into_iter().zip(first.sigmas()) {
        assert!(both < 0.8 * one, "{both} {one}");
    }
    let moved = combine(&first, &solve(&["gyro.GYRY.scale-factor.ppm=60"], 3)).expect("invertible");
    assert!(moved.joint_chi2 > 200.0, "{}", moved.joint_chi2);
    let most = (0..16).max_by(|&a, &b| moved.chi2[a].total_cmp(&moved.chi2[b])).expect("16");
    assert_eq!(
        CalibrationParameter::all().nth(most).map(CalibrationParameter::label).as_deref(),
        Some("GYRY scale factor")
    );
}

#[test]
fn configured_effects_of_the_paper_are_subtracted() {
    let paper = include_str!("../../../configs/paper.toml");
    let paper = Configuration::parse("configs/paper.toml", paper, &[]).expect("valid");
    let unit = sequence(&paper, Precautions { stabilisation: false, ..Precautions::ALL });
    let run = simulate(&unit);
    // Its calibration has the errors of a fortnight; its effects are known.
    let mut configured = unit.clone();
    for gyro in &mut configured.gyros {
        gyro.calibration.scale_factor += 20e-6;
        gyro.calibration.drift_arcsec_per_half_s += 6.0 / 7200.0;
    }
    let truth = values(&unit.calibrations());
    for windows in [Some(&run.windows[..]), None] {
        let attitude = AttitudeSource::Reference(&run.reference, Some([0.0; 3]));
        let solution = calibrate(&configured, &run.counts, windows, &attitude).expect("determined").solution;
        assert!(solution.probability() > 1e-4, "{} of {}", solution.chi2, solution.degrees_of_freedom);
        for ((parameter, solved), (sigma, truth)) in
            CalibrationParameter::all().zip(solution.values()).zip(solution.sigmas().into_iter().zip(truth))
        {
            assert!((solved - truth).abs() < 5.0 * sigma, "{}: {solved} ± {sigma}, {truth}", parameter.label());
        }
    }
}
