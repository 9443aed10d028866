//! Diagnosis of effects under the conditions of real recordings, on an independent model: noisy and slow references, closed loops, transients,
//! several effects. Each has its name, and nothing else is named.

use geu_diagnosis::outcome::DiagnosedEffect;
use geu_diagnosis::{Verdict, report};
use geu_plant::{GYROS, Gyro, IndependentModel, MotionKind, PlantedEffect, ReferenceKind};
use geu_protocol::Gyros;

use crate::diagnosed::{
    STAR_TRACKER, as_recorded, assert_all_named, assert_named, diagnosed, diagnosed_beside, missing,
};

#[test]
#[ignore = "minutes; .ci/run has it"]
fn a_pivot_is_named_against_a_star_tracker() {
    for (seed, gyro) in [(311, Gyro::Y), (312, Gyro::X), (313, Gyro::Zb)] {
        let injected = PlantedEffect::new("pivot-clearance", &[gyro], &[("clearance_arcsec", 9.3)]);
        let model = IndependentModel { reference: STAR_TRACKER, ..IndependentModel::new(seed, vec![injected.clone()]) };
        assert_named(&diagnosed(&model, as_recorded), &injected);
    }
}

/// The motion between the rows of a reference is not known as exactly as a zone with sharp limits requires.
#[test]
#[ignore = "minutes; .ci/run has it"]
fn a_dead_zone_gets_no_other_name() {
    for (seed, gyro) in [(381, Gyro::Y), (382, Gyro::X), (383, Gyro::Zb)] {
        let injected = PlantedEffect::new("dead-zone", &[gyro], &[("arcsec_per_s", 3.0)]);
        let diagnosis = diagnosed(&IndependentModel::new(seed, vec![injected.clone()]), as_recorded);
        assert_ne!(diagnosis.verdict, Verdict::Consistent);
        // The others end unexplained.
        if gyro == Gyro::X {
            assert_named(&diagnosis, &injected);
        }
        let other = missing(&diagnosis).find(|entry| !["dead-zone", "angle-random-walk"].contains(&&entry.code[..]));
        assert!(other.is_none(), "{other:?}");
    }
}

/// The onset is not determined if it lies between two motions.
#[test]
#[ignore = "minutes; .ci/run has it"]
fn what_settles_between_motions_is_named() {
    for (seed, onset_s) in [(374, 2130.0), (375, 4600.0), (376, 5900.0)] {
        let numbers = [("y_arcsec", -25.0), ("time_s", onset_s), ("time_constant_s", 2500.0)];
        let injected = PlantedEffect::new("misalignment-settling", &[Gyro::X], &numbers);
        let (motion, reference) = (MotionKind::RateTable, STAR_TRACKER);
        let model = IndependentModel { motion, reference, ..IndependentModel::new(seed, vec![injected.clone()]) };
        assert_named(&diagnosed(&model, as_recorded), &injected);
    }
}

/// A course that settles explains the pulse: in the middle of its onset's interval its amplitude would be beyond the limits. A course that
/// settles was searched from the best point of the grid only.
#[test]
#[ignore = "minutes; .ci/run has it"]
fn onsets_between_the_grid_and_beyond_the_limits_are_named() {
    let pulse = [("x_arcsec", -17.427), ("time_s", 2824.8), ("duration_s", 2503.2)];
    let settling = [("ppm", -41.463), ("time_s", 5198.6), ("time_constant_s", 1232.3)];
    let [slow, fast] =
        [(400, 3.0), (10, 1.0)].map(|(steps, sigma_arcsec)| ReferenceKind::Quaternions { steps, sigma_arcsec });
    for (seed, motion, reference, injected) in [
        (10_926_217_920, MotionKind::RateTable, slow, PlantedEffect::new("misalignment-pulse", &[Gyro::Za], &pulse)),
        (10_926_167_929, MotionKind::Survey, fast, PlantedEffect::new("scale-factor-settling", &[Gyro::Za], &settling)),
    ] {
        let model = IndependentModel { motion, reference, ..IndependentModel::new(seed, vec![injected.clone()]) };
        assert_all_named(&diagnosed(&model, as_recorded), &[injected]);
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn transients_are_named() {
    let settling = |gyro, time_constant_s| {
        let numbers = [("arcsec_per_h", 90.0), ("time_s", 0.0), ("time_constant_s", time_constant_s)];
        PlantedEffect::new("drift-settling", &[gyro], &numbers)
    };
    let pulse = |gyro, onset_s| {
        let numbers = [("arcsec_per_h", -80.0), ("time_s", onset_s), ("duration_s", 660.0)];
        PlantedEffect::new("drift-pulse", &[gyro], &numbers)
    };
    let rate = |gyro| PlantedEffect::new("drift-temperature-rate", &[gyro], &[("arcsec_per_h_per_k_per_h", 12.0)]);
    let cases = [
        (331, settling(Gyro::X, 900.0)),
        (332, settling(Gyro::Zb, 1500.0)),
        (333, pulse(Gyro::Y, 4100.0)),
        (334, pulse(Gyro::Za, 6900.0)),
        (335, rate(Gyro::X)),
        (336, rate(Gyro::Y)),
    ];
    for (seed, injected) in cases {
        assert_named(&diagnosed(&IndependentModel::new(seed, vec![injected.clone()]), as_recorded), &injected);
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn a_noise_that_grows_with_the_rate_is_no_other_effect() {
    for (seed, gyro, ppm_sqrt_s) in [(341, Gyro::Y, 60.0), (342, Gyro::Za, 80.0), (343, Gyro::Zb, 50.0)] {
        let injected = PlantedEffect::new("scale-factor-noise", &[gyro], &[("ppm_sqrt_s", ppm_sqrt_s)]);
        assert_named(&diagnosed(&IndependentModel::new(seed, vec![injected.clone()]), as_recorded), &injected);
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn a_hysteresis_is_named_from_narrow_to_wide() {
    for (seed, gyro, width_k) in [(344, Gyro::X, 0.01), (345, Gyro::Y, 0.2), (346, Gyro::Za, 0.7)] {
        let numbers = [("arcsec_per_h", 55.0), ("width_k", width_k)];
        let injected = PlantedEffect::new("drift-temperature-hysteresis", &[gyro], &numbers);
        assert_named(&diagnosed(&IndependentModel::new(seed, vec![injected.clone()]), as_recorded), &injected);
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn three_effects_on_three_gyros_are_named() {
    for seed in [351, 352, 353] {
        let pivot = PlantedEffect::new("pivot-clearance", &[Gyro::X], &[("clearance_arcsec", 10.0)]);
        let bend = PlantedEffect::new("scale-factor-nonlinearity", &[Gyro::Y], &[("cubic_ppm", 170.0)]);
        let ramp = PlantedEffect::new("drift-ramp", &[Gyro::Zb], &[("arcsec_per_h_per_day", 600.0)]);
        let all = [pivot, bend, ramp];
        let diagnosis = diagnosed(&IndependentModel::new(seed, all.to_vec()), as_recorded);
        assert_eq!(diagnosis.verdict, Verdict::Explained);
        let mut codes: Vec<String> = missing(&diagnosis).map(|entry| entry.code.clone()).collect();
        codes.sort();
        assert_eq!(codes, ["drift-ramp", "pivot-clearance", "scale-factor-nonlinearity"]);
    }
}

/// A false second effect of the time stamps, a wave longer than the recording, courses with an onset in a rest, and lags of which the
/// motion between slow rows contains a part.
#[test]
#[ignore = "minutes; .ci/run has it"]
fn an_effect_against_a_noisy_reference_is_named_alone() {
    let effect = PlantedEffect::new;
    let all = [Gyro::X, Gyro::Y, Gyro::Za, Gyro::Zb];
    let ramp = effect("scale-factor-ramp", &[Gyro::Za], &[("ppm_per_day", -465.94)]);
    let late = effect("time-offset-ramp", &all, &[("seconds_per_day", 6.5015e-2)]);
    let lag = effect("sensor-lag-step", &[Gyro::X], &[("time_constant_s", 1.3604e-2), ("time_s", 3936.2)]);
    let quaternions = |steps: usize, sigma_arcsec: f64| ReferenceKind::Quaternions { steps, sigma_arcsec };
    let wave = [("amplitude_ppm", 11.264), ("period_s", 9812.1), ("phase_rad", 0.83244)];
    let wave = effect("scale-factor-periodic", &[Gyro::Y], &wave);
    let pulse = [("ppm", 11_505.0), ("time_s", 2687.0), ("duration_s", 1352.3)];
    let pulse = effect("scale-factor-pulse", &[Gyro::X], &pulse);
    let settling = [("ppm", -186.46), ("time_s", 6530.1), ("time_constant_s", 1520.7)];
    let settling = effect("scale-factor-asymmetry-settling", &[Gyro::Y], &settling);
    for (seed, motion, reference, injected) in [
        (9_969_866_611, MotionKind::Survey, quaternions(10, 1.0), &wave),
        (10_396_677_042, MotionKind::RateTable, quaternions(10, 1.0), &pulse),
        (9_969_916_608, MotionKind::RateTable, quaternions(400, 3.0), &settling),
        (9_757_030_681, MotionKind::QuietSurvey, quaternions(40, 5.0), &ramp),
        (395, MotionKind::ClosedLoop, quaternions(400, 3.0), &late),
        (396, MotionKind::RateTable, quaternions(400, 3.0), &lag),
    ] {
        let model = IndependentModel { motion, reference, ..IndependentModel::new(seed, vec![injected.clone()]) };
        assert_named(&diagnosed(&model, as_recorded), injected);
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn a_product_with_the_time_is_no_trend_of_the_catalogue() {
    for (seed, motion, product, gyro, coefficient) in [
        (397, MotionKind::Survey, "temperature*time", Gyro::Zb, -2.7366e-2),
        (9_969_924_609, MotionKind::ClosedLoop, "acceleration_x*time", Gyro::Za, -6.5325e-3),
    ] {
        let planted = PlantedEffect::new(&format!("product {product}"), &[gyro], &[("coefficient", coefficient)]);
        let model = IndependentModel { motion, ..IndependentModel::new(seed, vec![planted]) };
        let names: Vec<String> = missing(&diagnosed(&model, as_recorded)).map(report::heading).collect();
        assert_eq!(names, [format!("{}: discovered term {product}", gyro.name())]);
    }
}

/// The best effect of the catalogue is 6 worse than a formula, or two effects explain the product, or a formula beside an effect excludes two
/// effects and leaves the gyro unexplained.
#[test]
#[ignore = "minutes; .ci/run has it"]
fn a_product_of_the_motion_is_no_effect_of_the_catalogue() {
    let fast = ReferenceKind::Quaternions { steps: 10, sigma_arcsec: 1.0 };
    for (seed, motion, product, gyro, coefficient, is_named) in [
        (11_138_023_273, MotionKind::RateTable, "rate_y*abs(rate_x)", Gyro::Zb, -1.1497e-7, true),
        (11_243_889_452, MotionKind::Survey, "rate_x*rate_z*abs(rate_z)", Gyro::Za, 4.1346e-10, true),
        (11_138_043_278, MotionKind::ClosedLoop, "rate_x*abs(rate_z)", Gyro::Zb, -8.0917e-4, false),
    ] {
        let planted = PlantedEffect::new(&format!("product {product}"), &[gyro], &[("coefficient", coefficient)]);
        let model = IndependentModel { motion, reference: fast, ..IndependentModel::new(seed, vec![planted]) };
        let diagnosis = diagnosed(&model, as_recorded);
        let gyros = Gyros::ALL.only(gyro as usize);
        let is_formula = |entry: &DiagnosedEffect| entry.code == "discovered" && entry.gyros == gyros;
        assert_eq!(
            missing(&diagnosis).map(is_formula).collect::<Vec<_>>(),
            vec![true; usize::from(is_named)],
            "{seed}"
        );
        let unexplained = diagnosis.unexplained.map(|unexplained| unexplained.gyros);
        assert_eq!(unexplained, (!is_named).then_some(gyros), "{seed}");
    }
}

/// The likeliest onset is narrower than the grid: a step and the end of a pulse, found between two motions.
#[test]
#[ignore = "minutes; .ci/run has it"]
fn a_pulse_of_the_time_stamps_is_named_in_a_closed_loop() {
    let pulse = [("seconds", -3.534e-4), ("time_s", 5461.6), ("duration_s", 2205.3)];
    let pulse = PlantedEffect::new("time-offset-pulse", &GYROS, &pulse);
    let motion = MotionKind::ClosedLoop;
    let model = IndependentModel { motion, ..IndependentModel::new(10_077_924_940, vec![pulse.clone()]) };
    assert_named(&diagnosed(&model, as_recorded), &pulse);
}

/// Found one by one, the first was another one: two of the temperature itself with a lag, a ramp on three gyros beside a larger walk, a wave
/// of the quadratic part. A clock beside a time offset had the signature of another time course, and so had what settles and turns the gyro
/// by its rate, which was lost counts. A drift and a clock were two walks with the penalty of one. A
/// pulse had two shapes more than an effect that predicts the thirds worse. A ramp of a clearance was not among the first alternatives, of
/// which the model was run. A thermal pulse was a step and a drift at its end, and a pulse of a clearance was excluded by a fit from another
/// length.
#[test]
#[ignore = "minutes; .ci/run has it"]
fn two_effects_of_which_each_masks_the_other_are_named() {
    let effect = PlantedEffect::new;
    let all = [Gyro::X, Gyro::Y, Gyro::Za, Gyro::Zb];
    let heating = [
        effect("drift-temperature-rate", &[Gyro::Za], &[("arcsec_per_h_per_k_per_h", -1.546)]),
        effect("anisoinertia-temperature-rate", &[Gyro::Za], &[("seconds_per_k_per_h", -6.5815e-3)]),
    ];
    let ramps = [
        effect("scale-factor-nonlinearity-ramp", &all, &[("cubic_ppm_per_day", 484.03)]),
        effect("scale-factor-ramp", &[Gyro::Za], &[("ppm_per_day", -600.13)]),
    ];
    let wave = [("amplitude_ppm", 13.623), ("period_s", 1631.1), ("phase_rad", 3.8752)];
    let wave_and_trend = [
        effect("scale-factor-periodic", &[Gyro::Y], &wave),
        effect("scale-factor-ramp", &[Gyro::Y], &[("ppm_per_day", -311.73)]),
    ];
    let clock = [
        effect("time-offset-temperature", &all, &[("seconds_per_k", -2.0844e-3)]),
        effect("clock-frequency-temperature-rate", &all, &[("ppm_per_k_per_h", 2.5646e-3)]),
    ];
    let wave = [("amplitude_seconds", -2.2978e-2), ("period_s", 2366.7), ("phase_rad", 5.8978)];
    let settling = [("seconds", 4.8264e-2), ("time_s", 6512.4), ("time_constant_s", 1863.6)];
    let accelerations = [
        effect("output-axis-acceleration-periodic", &[Gyro::Zb], &wave),
        effect("output-axis-acceleration-settling", &[Gyro::Y], &settling),
    ];
    let wave = [("amplitude_arcsec_per_h", 14.043), ("period_s", 7926.3), ("phase_rad", 4.0026)];
    let settling = [("ppm", 1.5648e-2), ("time_s", 2037.1), ("time_constant_s", 2761.2)];
    let drift_and_clock =
        [effect("drift-periodic", &[Gyro::Zb], &wave), effect("clock-frequency-settling", &all, &settling)];
    let hysteresis = [("arcsec_per_h_per_k_per_h", 1.7110), ("width_k", 8.0218e-2)];
    let pulse = [("seconds", -0.25282), ("time_s", 4853.8), ("duration_s", 2738.0)];
    let warming_and_pulse = [
        effect("drift-temperature-hysteresis-temperature-rate", &[Gyro::X], &hysteresis),
        effect("anisoinertia-pulse", &[Gyro::X], &pulse),
    ];
    let pulse = [("ppm", -11.162), ("time_s", 6833.9), ("duration_s", 2586.8)];
    let clearance_and_pulse = [
        effect("pivot-clearance-ramp", &[Gyro::Za], &[("clearance_arcsec_per_day", 81.928)]),
        effect("scale-factor-quadratic-pulse", &all, &pulse),
    ];
    let pulse = [("arcsec_per_deg", 0.11415), ("time_constant_s", 321.71), ("time_s", 8968.7), ("duration_s", 1574.6)];
    let warming_and_thermal_pulse = [
        effect("misalignment-temperature", &[Gyro::X], &[("z_arcsec_per_k", 1.4008)]),
        effect("misalignment-thermal-pulse", &all, &pulse),
    ];
    let pulse = [("clearance_arcsec", 0.70619), ("time_s", 6678.4), ("duration_s", 1553.8)];
    let time_and_short_clearance = [
        effect("time-offset-temperature", &all, &[("seconds_per_k", -2.2108e-4)]),
        effect("pivot-clearance-pulse", &[Gyro::X], &pulse),
    ];
    let slow = ReferenceKind::Quaternions { steps: 400, sigma_arcsec: 3.0 };
    let noisy = ReferenceKind::Quaternions { steps: 40, sigma_arcsec: 5.0 };
    let fast = ReferenceKind::Quaternions { steps: 10, sigma_arcsec: 1.0 };
    for (seed, motion, reference, injected) in [
        (9_651_100_505, MotionKind::Survey, fast, &heating),
        (9_651_110_504, MotionKind::Survey, slow, &ramps),
        (10_396_648_043, MotionKind::Survey, slow, &clock),
        (10_714_361_568, MotionKind::Survey, noisy, &accelerations),
        (9_651_140_505, MotionKind::RateTable, fast, &wave_and_trend),
        (10_714_426_568, MotionKind::ClosedLoop, slow, &drift_and_clock),
        (10_926_163_921, MotionKind::Survey, ReferenceKind::Rates, &warming_and_pulse),
        (11_349_858_625, MotionKind::ClosedLoop, noisy, &clearance_and_pulse),
        (11_455_694_807, MotionKind::Survey, ReferenceKind::Rates, &warming_and_thermal_pulse),
        (11_455_734_807, MotionKind::RateTable, ReferenceKind::Rates, &time_and_short_clearance),
    ] {
        let model = IndependentModel { motion, reference, ..IndependentModel::new(seed, injected.to_vec()) };
        assert_all_named(&diagnosed(&model, as_recorded), injected);
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn steps_are_named_alone() {
    let drift =
        |gyro, onset_s| PlantedEffect::new("drift-step", &[gyro], &[("arcsec_per_h", 16.0), ("time_s", onset_s)]);
    let pivot = |gyro, onset_s| {
        PlantedEffect::new("pivot-clearance-step", &[gyro], &[("clearance_arcsec", 9.0), ("time_s", onset_s)])
    };
    let cases = [
        (361, drift(Gyro::X, 5200.0)),
        (362, drift(Gyro::X, 3900.0)),
        (363, drift(Gyro::Za, 6100.0)),
        (364, pivot(Gyro::X, 5200.0)),
        (365, pivot(Gyro::Y, 5200.0)),
        (366, pivot(Gyro::Zb, 4400.0)),
    ];
    for (seed, injected) in cases {
        assert_named(&diagnosed(&IndependentModel::new(seed, vec![injected.clone()]), as_recorded), &injected);
    }
}

/// A walk that is nearly as large as the step does not decide.
#[test]
#[ignore = "minutes; .ci/run has it"]
fn a_step_is_named_whatever_drift_walk_is_declared() {
    let walk = PlantedEffect::new("drift-random-walk", &GYROS, &[("arcsec_per_s_per_sqrt_s", 3.9e-4)]);
    let step = PlantedEffect::new("drift-step", &[Gyro::X], &[("arcsec_per_h", 150.0), ("time_s", 5000.0)]);
    for seed in [401, 402, 403] {
        let model = IndependentModel::new(seed, vec![walk.clone(), step.clone()]);
        for declared in [3.9e-4, 3.95e-4, 5e-4] {
            assert_named(&diagnosed_beside(&model, "drift-random-walk.arcsec_per_s_per_sqrt_s", declared), &step);
        }
    }
}
