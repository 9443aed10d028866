//! The filter against the model: exactness, honesty of the covariance, whiteness, breaks.

use geu_model::{Configuration, GyroUnit};
use geu_protocol::{Gyro, Gyros};
use nalgebra::Vector3;

use super::survey_day::{AttitudeErrorStats, SurveyDay, checkout_calibration, with_errors};
use super::*;
use crate::counts::{BreakKind, Discontinuity};

/// A reconstruction with the estimates of all nodes.
struct Reconstructed {
    filtered: Vec<StateEstimate>,
    smoothed: Vec<StateEstimate>,
    result: Reconstruction,
}

fn reconstruct_all(
    counts: &AccumulatedCounts,
    calibrations: &[Calibration; 4],
    in_use: GyroSet,
    noise: &FilterNoise,
    fixes: &[AttitudeFix],
) -> Result<Reconstructed, FilterError> {
    let mut all = Vec::new();
    let result = reconstruct(counts, calibrations, in_use, noise, fixes, |node, own| {
        assert_eq!(node + all.len(), counts.len());
        all.push(*own);
    })?;
    let (filtered, smoothed) = all.iter().rev().map(|own| (own.filtered, own.smoothed)).unzip();
    Ok(Reconstructed { filtered, smoothed, result })
}

fn configuration(overrides: &[&str]) -> Configuration {
    let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
    Configuration::reference_with(&overrides).expect("valid")
}

/// The reference unit on a survey alone, its limit cycle in any phase.
fn survey(seed: u64, overrides: &[&str]) -> Configuration {
    let mut configuration = configuration(overrides);
    configuration.seed = seed;
    configuration.scenario.manoeuvres.retain(|manoeuvre| manoeuvre.kind() == "survey");
    configuration.scenario.limit_cycle.phase_x_rad = seed as f64 * 2.4;
    configuration.scenario.limit_cycle.phase_y_rad = seed as f64 * 2.4 + std::f64::consts::FRAC_PI_2;
    configuration
}

fn paper() -> Configuration {
    let text = include_str!("../../../../configs/paper.toml");
    Configuration::parse("configs/paper.toml", text, &[]).expect("valid")
}

/// A survey of the reference unit, reconstructed from a calibration with errors.
fn reconstructed(configuration: &Configuration, samples: usize) -> (SurveyDay, Reconstructed) {
    let day = SurveyDay::simulate(configuration, samples);
    let reference = survey(configuration.seed, &[]);
    // The limit cycle's sine of 4·5/2π about X, of which a fix of the star sensor sees nothing.
    let noise = FilterNoise {
        start_attitude_control_arcsec: [2.25, 60.0, 60.0],
        ..FilterNoise::from_configuration(&reference, GyroSet::WithZa)
    };
    let calibrations = with_errors(&checkout_calibration(&reference), &noise, configuration.seed);
    let result = reconstruct_all(&day.counts, &calibrations, GyroSet::WithZa, &noise, &day.fixes).expect("fixes");
    (day, result)
}

fn error_control_arcsec(estimate: &StateEstimate, exact: &UnitQuaternion<f64>) -> Vector3<f64> {
    covariance::turn_arcsec(&estimate.attitude, exact)
}

#[test]
fn counts_without_noise_or_rounding_reconstruct_exactly() {
    let mut configuration = survey(
        1,
        &["scenario.limit_cycle.rate_arcsec_s=0", "sensors.sse.random_arcsec=0", "sensors.sse.slit_arcsec=0"],
    );
    for gyro in &mut configuration.gyros {
        gyro.effects.constant.angle_random_walk.arcsec_per_sqrt_s = 0.0;
        gyro.effects.constant.drift_random_walk.arcsec_per_s_per_sqrt_s = 0.0;
    }
    let mut day = SurveyDay::simulate(&configuration, 30_000);
    let mut unit = GyroUnit::new(&configuration);
    let mut counts = AccumulatedCounts::starting_at(0);
    for _ in 0..30_000 {
        let (ended, traces) = unit.end_sample_traced();
        counts.push(
            ended.end_ns as f64 * 1e-9,
            &traces.iter().map(|trace| trace.unquantised).collect::<Vec<_>>(),
            20.0,
        );
    }
    day.counts = counts;
    // From the first fix on by counts alone: at a later one, between samples where a ramp ends, the cubic would err.
    day.fixes.truncate(1);
    let calibrations = configuration.calibrations();
    let noise = FilterNoise { count_arcsec: 0.0, ..FilterNoise::from_configuration(&configuration, GyroSet::WithZa) };
    for in_use in [GyroSet::WithZa, GyroSet::WithZb] {
        let result = reconstruct_all(&day.counts, &calibrations, in_use, &noise, &day.fixes).expect("fixes");
        for estimates in [&result.filtered, &result.smoothed] {
            // Over 4 h 10 min: what is left are turns that do not commute within the ramps of the scans.
            let worst = estimates
                .iter()
                .zip(&day.attitude)
                .map(|(estimate, exact)| error_control_arcsec(estimate, exact).norm())
                .fold(0.0, f64::max);
            assert!(worst < 2e-3, "{in_use:?}: {worst} arcsec");
        }
    }
}

#[test]
fn errors_are_as_large_as_the_covariance_predicts() {
    const RUNS: u64 = 40;
    let nodes = [5_000, 12_000, 20_000, 28_800];
    // Filtered and smoothed; attitude, and drift and scale factor of the gyros in use.
    let mut nees = [[[0.0; 3]; 4]; 2];
    for seed in 1..=RUNS {
        let configuration = survey(seed, &[]);
        let (day, result) = reconstructed(&configuration, 28_800);
        for (sums, estimates) in nees.iter_mut().zip([&result.filtered, &result.smoothed]) {
            for (sums, node) in sums.iter_mut().zip(nodes) {
                let estimate = &estimates[node];
                let error = error_control_arcsec(estimate, &day.attitude[node]);
                let inverse = estimate.covariance_control_arcsec2.try_inverse().expect("positive");
                sums[0] += (error.transpose() * inverse * error)[0];
                for gyro in [0, 1, 2] {
                    // The drift has walked: only the scale factor has a truth to stand against.
                    let exact = configuration.gyros[gyro].calibration.scale_factor;
                    sums[1] +=
                        ((estimate.scale_factor[gyro] - exact) / estimate.scale_factor_sigma[gyro]).powi(2) / 3.0;
                }
            }
        }
    }
    for (name, sums) in ["filtered", "smoothed"].into_iter().zip(nees) {
        for (node, sums) in nodes.into_iter().zip(sums) {
            let above = chi2_survival(sums[0], 3 * RUNS as usize);
            // A seed of 40 runs lies outside once in 500.
            assert!((0.001..0.999).contains(&above), "{name} at {node}: NEES {} of {}", sums[0], 3 * RUNS);
            // Three of one run are not independent; RUNS degrees, were they one.
            let above = chi2_survival(sums[1], RUNS as usize);
            assert!((0.001..0.999).contains(&above), "{name} at {node}: scale factors {} of {RUNS}", sums[1]);
        }
    }
}

#[test]
fn the_smoother_is_never_less_certain_than_the_filter_and_not_worse() {
    let (mut filtered, mut smoothed) = (0.0, 0.0);
    for seed in 1..=5 {
        let (day, result) = reconstructed(&survey(seed, &[]), 28_800);
        for (before, after) in result.filtered.iter().zip(&result.smoothed) {
            assert!(after.boresight_sigma_arcsec() <= before.boresight_sigma_arcsec() + 1e-9, "seed {seed}");
            for gyro in 0..3 {
                assert!(after.scale_factor_sigma[gyro] <= before.scale_factor_sigma[gyro] * (1.0 + 1e-9));
                let (before, after) = (before.drift_sigma_arcsec_per_half_s, after.drift_sigma_arcsec_per_half_s);
                assert!(after[gyro] <= before[gyro] * (1.0 + 1e-9));
            }
        }
        assert_eq!(result.filtered.last(), result.smoothed.last());
        let [before, after] = [&result.filtered, &result.smoothed]
            .map(|all| AttitudeErrorStats::from_estimates(all, &day.attitude).rms_arcsec);
        assert!(after < before, "seed {seed}: {after} of {before}");
        filtered += before;
        smoothed += after;
    }
    assert!(smoothed < 0.9 * filtered, "{smoothed} of {filtered}");
}

#[test]
fn a_noisy_sun_sensor_weighs_by_its_noise() {
    let noisy = survey(1, &["sensors.fss.noise_arcsec=20"]);
    let [without, with] =
        [false, true].map(|with_sun| survey_day(&noisy, 86_400, GyroSet::WithZa, with_sun).expect("fixes"));
    assert!(with.fixes > without.fixes + 60, "{} {}", with.fixes, without.fixes);
    let whiteness = with.reconstruction.whiteness;
    assert!(whiteness.is_white(), "{whiteness:?}");
    assert!(with.smoothed.rms_arcsec < without.smoothed.rms_arcsec, "{:?} {:?}", with.smoothed, without.smoothed);
}

#[test]
fn innovations_are_white_on_the_reference_unit_and_not_with_a_wrong_model() {
    let white =
        (1..=10).filter(|&seed| reconstructed(&survey(seed, &[]), 86_400).1.result.whiteness.is_white()).count();
    assert!(white >= 9, "{white} of 10");
    // A drift that runs away by 8″/h in each half hour, and a float that is not in the filter.
    for unknown in ["gyro.GYRY.drift-ramp.arcsec_per_h_per_day=400", "gyro.GYRZA.pivot-clearance.clearance_arcsec=60"] {
        let whiteness = reconstructed(&survey(1, &[unknown]), 86_400).1.result.whiteness;
        assert!(!whiteness.is_white(), "{unknown}: {whiteness:?}");
    }
}

#[test]
fn the_boresight_of_a_survey_day_with_every_effect_is_better_than_20_arcsec() {
    let report = survey_day(&paper(), 172_800, GyroSet::WithZa, false).expect("a day");
    assert!(report.smoothed.max_arcsec < REQUIREMENT_ARCSEC, "{:?}", report.smoothed);
    assert!(report.smoothed.rms_arcsec < report.filtered.rms_arcsec);
}

#[test]
fn the_float_model_removes_more_than_half_of_its_error() {
    let overrides = Gyro::ALL.map(|gyro| format!("gyro.{}.pivot-clearance.clearance_arcsec=14", gyro.name()));
    let overrides = overrides.each_ref().map(String::as_str);
    let configuration = survey(1, &overrides);
    let day = SurveyDay::simulate(&configuration, 86_400);
    let calibrations = checkout_calibration(&configuration);
    let known = FilterNoise::from_configuration(&configuration, GyroSet::WithZa);
    let unknown = FilterNoise { clearance_arcsec: [0.0; 4], bounded_arcsec: 14.0 / 12f64.sqrt(), ..known };
    let [left_in, taken_out] = [unknown, known].map(|noise| {
        let result = reconstruct_all(&day.counts, &calibrations, GyroSet::WithZa, &noise, &day.fixes).expect("fixes");
        AttitudeErrorStats::from_estimates(&result.smoothed, &day.attitude).rms_arcsec
    });
    assert!(taken_out < 0.5 * left_in, "{taken_out} of {left_in}");
}

#[test]
fn a_gap_widens_the_covariance_and_the_next_fixes_close_it() {
    let configuration = survey(3, &[]);
    let mut day = SurveyDay::simulate(&configuration, 28_800);
    let noise = FilterNoise::from_configuration(&configuration, GyroSet::WithZa);
    let calibrations = checkout_calibration(&configuration);
    for (length, kind) in [(1, BreakKind::Gap(1)), (40, BreakKind::Invalid), (1200, BreakKind::Gap(1200))] {
        let whole = day.counts.clone();
        let (from, to) = (10_000, 10_000 + length);
        for sums in &mut day.counts.accumulated {
            let lost = sums[to] - sums[from];
            let at_start = sums[from];
            sums[from..=to].fill(at_start);
            sums[to + 1..].iter_mut().for_each(|sum| *sum -= lost);
        }
        day.counts.breaks.push(Discontinuity { from, to, gyros: Gyros::ALL, kind });
        let result = reconstruct_all(&day.counts, &calibrations, GyroSet::WithZa, &noise, &day.fixes).expect("fixes");
        let sigma = |node: usize| result.filtered[node].boresight_sigma_arcsec();
        assert!(sigma(from) < 20.0 && sigma(to) > 100.0, "{length}: {} {}", sigma(from), sigma(to));
        // Nothing is seen of it before, nor three fixes after.
        for (estimates, nodes) in
            [(&result.filtered, 0..from), (&result.smoothed, 0..from), (&result.smoothed, 20_000..28_801)]
        {
            let worst = AttitudeErrorStats::from_estimates(&estimates[nodes.clone()], &day.attitude[nodes]).max_arcsec;
            assert!(worst < 20.0, "{length}: {worst}");
        }
        // Within it the sigmas say how bad it is.
        let error = error_control_arcsec(&result.smoothed[from + length / 2], &day.attitude[from + length / 2]);
        let sigmas = result.smoothed[from + length / 2].sigma_control_arcsec();
        assert!((0..3).all(|axis| error[axis].abs() < 5.0 * sigmas[axis]), "{length}: {error} {sigmas:?}");
        day.counts = whole;
    }
}

#[test]
fn little_or_bad_input_is_refused_or_handled_without_panic() {
    let calibrations = [Calibration::default(); 4];
    let run = |counts: &AccumulatedCounts, in_use: GyroSet, noise: &FilterNoise, fixes: &[AttitudeFix]| {
        reconstruct_all(counts, &calibrations, in_use, noise, fixes)
    };
    let fix = AttitudeFix::star(0.0, 90.0, 0.0, 0.5);
    let one = std::slice::from_ref(&fix);
    let (za, noise) = (GyroSet::WithZa, FilterNoise::PAPER);
    let some = |samples: usize| {
        let mut counts = AccumulatedCounts::starting_at(0);
        (1..=samples).for_each(|end| counts.push(end as f64 * 0.5, &[0.0; 4], 20.0));
        counts
    };
    assert_eq!(run(&AccumulatedCounts::starting_at(0), za, &noise, one).err(), Some(FilterError::NoCounts));
    assert_eq!(run(&some(0), za, &noise, one).err(), Some(FilterError::NoCounts));
    assert_eq!(run(&some(4), GyroSet::All, &noise, one).err(), Some(FilterError::FourGyros));
    assert!(matches!(run(&some(4), za, &noise, &[]), Err(FilterError::NoAttitude { got: 0, .. })));
    let late = AttitudeFix::star(100.0, 90.0, 0.0, 0.5);
    assert!(matches!(
        run(&some(4), za, &noise, std::slice::from_ref(&late)),
        Err(FilterError::NoAttitude { got: 1, .. })
    ));
    let sun = AttitudeFix::sun(1.0, 324_000.0, 0.0, &geu_model::sensor::Fss::default());
    assert!(matches!(run(&some(4), za, &noise, &[sun]), Err(FilterError::NoAttitude { .. })));
    let bad = AttitudeFix::star(1.0, f64::NAN, 0.0, 0.5);
    assert!(matches!(run(&some(4), za, &noise, &[fix.clone(), bad]), Err(FilterError::Fix { index: 1, .. })));
    for samples in 1..6 {
        for t_s in [0.0, 0.2, 0.5] {
            let fixes = [AttitudeFix::star(t_s, 90.0, 0.0, 0.5), late.clone()];
            let result = run(&some(samples), za, &noise, &fixes).expect("a fix inside");
            assert_eq!((result.filtered.len(), result.smoothed.len()), (samples + 1, samples + 1));
            assert_eq!((result.result.fixes_outside, result.result.innovations.len()), (1, 2));
        }
    }
    // Broken from end to end.
    let mut counts = some(3000);
    counts.breaks.push(Discontinuity { from: 0, to: 9999, gyros: Gyros::ALL, kind: BreakKind::SelfTest });
    let result = run(&counts, za, &noise, &[fix.clone(), AttitudeFix::star(1400.0, 90.0, 0.0, 0.5)]).expect("fixes");
    assert!(
        result.smoothed.iter().all(|estimate| estimate.covariance_control_arcsec2.iter().all(|part| part.is_finite()))
    );
}

#[test]
fn a_first_fix_in_the_middle_is_carried_back_to_the_start() {
    let configuration = survey(2, &[]);
    let mut day = SurveyDay::simulate(&configuration, 14_400);
    day.fixes.retain(|fix| fix.t_s > 3000.0);
    let noise = FilterNoise::from_configuration(&configuration, GyroSet::WithZa);
    let result =
        reconstruct_all(&day.counts, &checkout_calibration(&configuration), GyroSet::WithZa, &noise, &day.fixes)
            .expect("fixes");
    let worst = AttitudeErrorStats::from_estimates(&result.smoothed, &day.attitude).max_arcsec;
    assert!(worst < 20.0, "{worst}");
}
