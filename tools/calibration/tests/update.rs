//! Update of the Z gyros from ordinary recordings (Casteren §3.2, §5).

use geu_calibration::checkout::{CheckoutRun, simulate};
use geu_calibration::solve::{CalibrationParameter, PER_GYRO};
use geu_calibration::update::{FORTNIGHT_S, PARAMETERS, SCALE_FACTOR_PER_FORTNIGHT, ScanSegment};
use geu_calibration::{AccumulatedCounts, AttitudeSource, CalibrationUpdate, PriorAccuracy, UpdateError, update};
use geu_model::attitude::Manoeuvre;
use geu_model::noise::NoiseStream;
use geu_model::{Configuration, GyroUnit};
use geu_protocol::Gyro;
use nalgebra::{DMatrix, DVector};

fn manoeuvre(kind: &str, numbers: &[(&str, f64)]) -> Manoeuvre {
    let mut manoeuvre = Manoeuvre::of_kind(kind).expect("a kind");
    for (name, value) in numbers {
        let own = manoeuvre.numbers_mut();
        let index = own.specs().iter().position(|spec| spec.name == *name).expect("a number");
        *own.value_mut(index) = *value;
    }
    manoeuvre
}

/// The reference unit on survey scans between two rests.
fn surveying(scans: f64) -> Configuration {
    let mut unit = Configuration::reference();
    unit.scenario.manoeuvres =
        vec![manoeuvre("pointing", &[]), manoeuvre("survey", &[("scans", scans)]), manoeuvre("pointing", &[])];
    unit
}

fn moved(mut unit: Configuration, parameter: CalibrationParameter, by: f64) -> Configuration {
    let own = &mut unit.gyros[parameter.gyro.index()].calibration;
    parameter.set(own, parameter.value(own) + by);
    unit
}

/// Counts of a run before rounding.
fn exact(unit: &Configuration, samples: usize) -> AccumulatedCounts {
    let mut exact = AccumulatedCounts::starting_at(unit.start_unix_ns);
    let mut model = GyroUnit::new(unit);
    for _ in 0..samples {
        let (ended, traces) = model.end_sample_traced();
        exact.push(ended.end_ns as f64 * 1e-9, &traces.iter().map(|trace| trace.unquantised).collect::<Vec<_>>(), 20.0);
    }
    exact
}

/// The four values of a unit when its drifts have walked to `t_s`.
fn truth(unit: &Configuration, t_s: f64) -> [f64; 4] {
    let mut still = unit.clone();
    for gyro in &mut still.gyros {
        gyro.effects.constant.drift_random_walk = Default::default();
    }
    let last = (t_s * 2.0).round() as usize;
    let (walking, still) = (exact(unit, last), exact(&still, last));
    PARAMETERS.map(|parameter| {
        let gyro = parameter.gyro.index();
        let calibration = &unit.gyros[gyro].calibration;
        // Drift makes counts fall; its mean over the last second.
        let second = |counts: &AccumulatedCounts| counts.accumulated[gyro][last] - counts.accumulated[gyro][last - 2];
        let walked = (second(&still) - second(&walking)) * calibration.scale_factor / 2.0;
        parameter.value(calibration) + if parameter.index == 1 { walked } else { 0.0 }
    })
}

fn by_reference(run: &CheckoutRun) -> AttitudeSource<'_> {
    AttitudeSource::Reference(&run.reference, Some([0.0; 3]))
}

/// A fortnight after a checkout.
fn fortnight() -> PriorAccuracy {
    PriorAccuracy::after_checkout(-FORTNIGHT_S)
}

fn within(updated: &CalibrationUpdate, truth: [f64; 4], sigmas: f64) {
    for (change, truth) in updated.changes.iter().zip(truth) {
        let pull = (change.new - truth) / change.new_sigma;
        assert!(pull.abs() < sigmas, "{}: {pull} sigma", change.parameter.label());
        assert!(change.new_sigma < change.old_sigma, "{}", change.parameter.label());
    }
}

#[test]
fn a_day_of_survey_recovers_a_moved_scale_factor_and_drift() {
    let configured = surveying(170.0);
    let unit = moved(moved(configured.clone(), PARAMETERS[0], 40e-6 * 1.0005), PARAMETERS[1], 3.0 / 7200.0);
    let run = simulate(&unit);
    for attitude in [by_reference(&run), AttitudeSource::Sensors(&run.sensors)] {
        for legs in [None, Some(run.windows.as_slice())] {
            let updated = update(&configured, &fortnight(), &run.counts, legs, &attitude).expect("scans");
            within(&updated, truth(&unit, updated.at_s), 3.0);
            assert_eq!(updated.used.iter().filter(|used| used.is_scan()).count(), 170);
            // Far better than the 20 ppm and 6 arcsec/h of the checkout, and the scale factor stands out.
            let [scale_factor, drift, ..] = updated.changes;
            assert!(scale_factor.new_sigma < 6e-6 && drift.new_sigma < 3.5 / 7200.0, "{updated:?}");
            assert!(scale_factor.is_significant() && drift.is_observable() && updated.probability() > 1e-3);
            assert!(!updated.needs_checkout() && updated.due_in_s() > 0.5 * FORTNIGHT_S);
            // The other parameters are unchanged.
            assert_eq!(updated.calibrations[0], configured.gyros[0].calibration);
            assert_eq!(updated.calibrations[2].x_arcsec, configured.gyros[2].calibration.x_arcsec);
        }
    }
}

#[test]
fn exact_increments_recover_the_four_from_any_configuration() {
    let configured = surveying(12.0).without_noise();
    let mut unit = configured.clone();
    for (parameter, by) in PARAMETERS.into_iter().zip([40e-6, 4e-4, -300e-6, -2e-3]) {
        unit = moved(unit, parameter, by);
    }
    let run = simulate(&unit);
    let counts = exact(&unit, run.counts.len());
    let uninformed =
        PriorAccuracy { at_s: 0.0, sigmas: std::array::from_fn(|index| [1.0, 1.0, 1e-6, 1e-6][index % 4]) };
    let updated = update(&configured, &uninformed, &counts, None, &by_reference(&run)).expect("scans");
    for (change, truth) in updated.changes.iter().zip(truth(&unit, 10.0)) {
        let limit = if change.parameter.index == 0 { 1e-9 } else { 1e-6 };
        assert!((change.new - truth).abs() < limit, "{}: {} {truth}", change.parameter.label(), change.new);
    }
    // 12 scans and two rests of two gyros.
    assert_eq!(updated.degrees_of_freedom, 28);
    assert!(updated.chi2 < 1e-3, "{}", updated.chi2);
}

#[test]
fn without_a_rest_the_drift_stays_near_its_prior_and_widens_the_scale_factor() {
    let mut configured = surveying(20.0).without_noise();
    configured.scenario.manoeuvres = vec![manoeuvre("survey", &[("scans", 20.0)])];
    let unit = moved(configured.clone(), PARAMETERS[1], 6.0 / 7200.0);
    let run = simulate(&unit);
    let updated = update(&configured, &fortnight(), &run.counts, None, &by_reference(&run)).expect("scans");
    let [scale_factor, drift, ..] = updated.changes;
    assert!(!drift.is_observable() && drift.new_sigma <= drift.old_sigma);
    // 6″/h of 231″/s are 7.2 ppm.
    assert!(scale_factor.new_sigma > 7e-6 && updated.correlation[(0, 1)].abs() > 0.9, "{updated:?}");
    within(&updated, truth(&unit, updated.at_s), 3.0);
}

#[test]
fn a_change_beyond_stability_asks_for_a_checkout() {
    let configured = surveying(20.0);
    let unit = moved(configured.clone(), PARAMETERS[2], 500e-6);
    let run = simulate(&unit);
    let updated = update(&configured, &fortnight(), &run.counts, None, &by_reference(&run)).expect("scans");
    assert!(updated.needs_checkout());
    let beyond: Vec<bool> = updated.changes.iter().map(|change| change.is_beyond_stability()).collect();
    assert_eq!(beyond, [false, false, true, false]);
    assert_eq!(updated.changes[2].allowed, SCALE_FACTOR_PER_FORTNIGHT * (1.0 + updated.at_s / FORTNIGHT_S));
}

#[test]
fn refined_values_scatter_as_their_sigmas_predict() {
    let (mut chi2, mut inside, runs) = (0.0, 0, 40);
    for seed in 0..runs {
        let mut random = NoiseStream::of_sensor(seed, "what was not known");
        let configured = surveying(10.0);
        let known = PriorAccuracy::after_checkout(0.0);
        let mut unit = configured.clone();
        unit.seed = seed;
        for (index, parameter) in CalibrationParameter::all().enumerate() {
            let normal = random.standard_normal();
            // X and Y gyros only give the attitude; they are not solved.
            if index >= 2 * PER_GYRO {
                unit = moved(unit, parameter, normal * known.sigmas[index]);
            }
        }
        let run = simulate(&unit);
        let attitude = if seed % 2 == 0 { by_reference(&run) } else { AttitudeSource::Sensors(&run.sensors) };
        let updated = update(&configured, &known, &run.counts, None, &attitude).expect("scans");
        let sigmas = updated.changes.map(|change| change.new_sigma);
        let truth = truth(&unit, updated.at_s);
        let pulls = DVector::from_fn(4, |index, _| {
            (updated.changes[index].new - truth[index]) / updated.changes[index].new_sigma
        });
        let correlation = DMatrix::from_fn(4, 4, |a, b| updated.correlation[(a, b)]);
        chi2 += pulls.dot(&correlation.cholesky().expect("positive").solve(&pulls));
        inside += pulls.iter().filter(|pull| pull.abs() < 1.0).count();
        assert!(sigmas.iter().all(|sigma| sigma.is_finite() && *sigma > 0.0));
    }
    // 160 degrees of freedom: 160 ± 5·√320; a share of 68.3 % of 160, of which pairs are correlated: ±5·0.06.
    assert!((chi2 - 160.0).abs() < 90.0, "{chi2}");
    assert!((inside as f64 / 160.0 - 0.683).abs() < 0.25, "{inside}");
    println!("χ² {chi2:.1} of 160, {inside} of 160 within a sigma");
}

#[test]
fn a_recording_without_scans_is_refused_with_the_requirements() {
    let mut unit = surveying(1.0);
    unit.scenario.manoeuvres = vec![
        manoeuvre("pointing", &[]),
        manoeuvre("slew", &[("by_psi_deg", 120.0)]),
        manoeuvre("y-scan", &[("to_theta_deg", 60.0)]),
        manoeuvre("survey", &[("scans", 1.0), ("angle_deg", 5.0)]),
    ];
    let run = simulate(&unit);
    let refused = |legs| {
        let error = update(&unit, &fortnight(), &run.counts, legs, &by_reference(&run)).expect_err("no scan");
        assert!(matches!(error, UpdateError::NoScan(_)));
        error.to_string()
    };
    let found = refused(None);
    assert!(found.starts_with("expected survey scans: 120 s or more at a steady 60…289 arcsec/s about Z"), "{found}");
    assert!(found.contains("turns about Z faster than 289 arcsec/s"), "{found}");
    assert!(found.contains("shorter than 120 s"), "{found}");
    let listed = refused(Some(&run.windows));
    assert!(listed.contains("y-scan at 1220.0 s: neither a survey nor a rest"), "{listed}");
    assert!(listed.contains("survey at ") && listed.contains("shorter than 120 s"), "{listed}");
}

#[test]
fn broken_counts_exclude_only_their_own_segment() {
    let unit = surveying(8.0);
    let run = simulate(&unit);
    let mut counts = run.counts.clone();
    let scan = run.windows.iter().filter(|window| window.name == "survey").nth(3).expect("eight");
    let node = counts.nearest((scan.start_s + scan.end_s) / 2.0).expect("inside");
    let kind = geu_calibration::BreakKind::Saturated;
    let gyros = geu_protocol::Gyros::ALL.only(Gyro::ZB.index());
    counts.breaks.push(geu_calibration::Discontinuity { from: node, to: node + 1, gyros, kind });
    let updated = update(&unit, &fortnight(), &counts, Some(&run.windows), &by_reference(&run)).expect("scans");
    let without: Vec<&ScanSegment> = updated.used.iter().filter(|used| used.residuals[1].is_none()).collect();
    assert_eq!(without.len(), 1);
    assert!((without[0].start_s - scan.start_s).abs() < 1.0 && without[0].residuals[0].is_some());
    assert!(updated.left_out.iter().any(|found| found.to_string().contains("GYRZB: the count is saturated at")));
}

#[test]
fn a_configured_clock_and_time_offset_are_corrected_and_a_wiring_fault_is_refused() {
    let mut unit = surveying(12.0);
    unit.unit.constant.clock_frequency.ppm = 500.0;
    unit.unit.constant.time_offset.seconds = 0.3;
    let mut run = simulate(&unit);
    // Times of the unit's own clock, without a receiver.
    run.counts.is_received = false;
    run.counts.node_s = (0..run.counts.node_s.len()).map(|node| node as f64 * 0.5).collect();
    let updated = update(&unit, &fortnight(), &run.counts, None, &by_reference(&run)).expect("scans");
    within(&updated, truth(&unit, updated.at_s), 5.0);
    assert!(updated.probability() > 1e-4, "{}", updated.chi2);
    unit.gyros[2].wiring.constant.sign_inversion.on = 1.0;
    let refused = update(&unit, &fortnight(), &run.counts, None, &by_reference(&run));
    let message = refused.expect_err("a fault").to_string();
    assert!(message.contains("gyro.GYRZA: expected a unit without wiring faults, got sign-inversion"), "{message}");
}
