//! Effects beyond the paper follow their laws; the expected numbers are in the comments.

use std::sync::Arc;

use geu_model::attitude::{AttitudeRow, RecordedAttitude};
use geu_model::{Configuration, GyroUnit, Truth};

/// Angle that GYRX counts in each sample interval, arcsec, with `effects` on it and no other effect or error, at a rate about
/// X of `from` arcsec/s that grows by `by` arcsec/s².
fn counted(effects: &str, seed: u64, samples: usize, from: f64, by: f64) -> Vec<f64> {
    let angle = |t_s: f64| from * t_s + 0.5 * by * t_s * t_s;
    let rows: Vec<AttitudeRow> = (0..=samples.max(3) + 1)
        .map(|index| {
            let t_s = index as f64 * 0.5;
            let angle_arcsec = if index == 0 { 0.0 } else { angle(t_s) - angle(t_s - 0.5) };
            AttitudeRow { t_s, angle_control_arcsec: [angle_arcsec, 0.0, 0.0], theta_psi_rad: None }
        })
        .collect();
    let truth = Truth::Recorded(Arc::new(RecordedAttitude::new(rows).expect("good rows")));
    let mut configuration =
        Configuration::parse("test.toml", effects, &[]).unwrap_or_else(|error| panic!("{effects}: {error}"));
    configuration.seed = seed;
    let mut unit = GyroUnit::on(&configuration, &truth);
    (0..samples).map(|_| unit.end_sample_traced().1[0].unquantised).collect()
}

/// All that GYRX counts in `samples` sample intervals.
fn total(effects: &str, samples: usize, from: f64, by: f64) -> f64 {
    counted(effects, 1, samples, from, by).iter().sum()
}

fn assert_near(found: f64, expected: f64, what: &str) {
    assert!((found - expected).abs() < 1e-6, "{what}: {found}, not {expected}");
}

#[test]
fn a_quadratic_scale_factor_takes_from_a_rate_of_either_sign() {
    // 10⁻³ · 360²/720 = 0.18″/s for 10 s.
    let effect = "gyro.GYRX.scale-factor-quadratic.ppm = 1000";
    assert_near(total(effect, 20, 360.0, 0.0), 3600.0 - 1.8, "forward");
    assert_near(total(effect, 20, -360.0, 0.0), -3600.0 - 1.8, "backward");
    // Half of the rate, a quarter of the loss.
    assert_near(total(effect, 20, 180.0, 0.0), 1800.0 - 0.45, "half");
}

#[test]
fn a_rate_in_the_dead_zone_is_not_sensed_and_a_larger_one_whole() {
    let effect = "gyro.GYRX.dead-zone.arcsec_per_s = 3.2";
    for (rate, sensed) in [(3.1, 0.0), (-3.1, 0.0), (3.3, 33.0), (-3.3, -33.0), (0.0, 0.0), (300.0, 3000.0)] {
        assert_near(total(effect, 20, rate, 0.0), sensed, &rate.to_string());
    }
    // From −10 to 10″/s in 10 s the zone loses as much on either side of 0. From 0 to 10″/s in 5 s it loses the first 1.6 s, a mean of
    // 1.6″/s; from 0.1″/s, which meets the limit in mid-step, the first 1.55 s, a mean of 1.65″/s.
    assert_near(total(effect, 20, -10.0, 2.0), 0.0, "through zero");
    assert_near(total(effect, 10, 0.0, 2.0), 25.0 - 2.56, "from rest");
    assert_near(total(effect, 10, 0.1, 2.0), 25.5 - 1.55 * 1.65, "in mid-step");
}

#[test]
fn a_lag_starts_settled_and_stays_behind_a_growing_rate() {
    let effect = "gyro.GYRX.sensor-lag.time_constant_s = 2";
    assert_near(total(effect, 10, 10.0, 0.0), 50.0, "constant rate");
    // At 2t arcsec/s the mean rate grows by 0.2″/s from sub-step to sub-step. With q = e^−0.05 the sensed rate is then behind
    // by 0.2 (1 − qᵏ)/(1 − q) in sub-step k, and the angle of 25″ by 0.2·2·Σ(1 − qᵏ) over 50 of them:
    // 0.4·(50 − (1 − e^−2.5)/(1 − e^−0.05)) = 0.4·(50 − 18.821082).
    assert_near(total(effect, 10, 0.0, 2.0), 25.0 - 12.471_567, "growing rate");
}

#[test]
fn noise_of_the_scale_factor_is_proportional_to_the_rate() {
    // 10 000 ppm·√s at 100″/s is 1″/√s: a variance of 0.5 arcsec² in half a second.
    let effect = "gyro.GYRX.scale-factor-noise.ppm_sqrt_s = 10000";
    let samples = 20_000;
    let noise = |rate: f64| -> Vec<f64> {
        counted(effect, 1, samples, rate, 0.0).iter().map(|angle| angle - 0.5 * rate).collect()
    };
    let (forward, twice) = (noise(100.0), noise(200.0));
    let variance = forward.iter().map(|angle| angle * angle).sum::<f64>() / samples as f64;
    // Five deviations of a variance from this number of draws, √(2/20 000).
    assert!((variance / 0.5 - 1.0).abs() < 0.05, "{variance}");
    for ((one, twice), backward) in forward.iter().zip(twice).zip(noise(-100.0)) {
        assert_near(twice, 2.0 * one, "twice the rate");
        assert_near(backward, -one, "backward");
    }
    assert!(noise(0.0).iter().all(|angle| *angle == 0.0));
}

#[test]
fn bias_instability_starts_in_its_stationary_state() {
    // Six processes of variance ln 10/π each; the drift of the first sample interval is their sum, less what the fastest, of
    // 1 s, loses in the mean over half a second: 15 % of its variance, 2.5 % of all.
    let seeds = 4000;
    let drift = |seed: u64| counted("gyro.GYRX.bias-instability.arcsec_per_h = 3600", seed, 1, 0.0, 0.0)[0] / 0.5;
    let variance = (1..=seeds).map(|seed| drift(seed).powi(2)).sum::<f64>() / seeds as f64;
    let expected = 0.975 * 6.0 * 10f64.ln() / std::f64::consts::PI;
    // Five deviations of a variance from this number of draws, √(2/4000).
    assert!((variance / expected - 1.0).abs() < 0.112, "{variance}, not {expected}");
}

#[test]
fn hysteresis_follows_the_direction_of_the_temperature_after_its_play() {
    // At 1 K in 10 s; the play is 0.2 K. From its middle it is taken up in 1 s, from end to end in 2 s.
    let counts = counted(
        "temperature.electronics_table = [[0, 20], [10, 21], [20, 20]]
         gyro.GYRX.drift-temperature-hysteresis = { arcsec_per_h = 3600, width_k = 0.2 }",
        1,
        40,
        0.0,
        0.0,
    );
    // The temperature of a sample interval is that of its middle; the first is the play's middle. A drift of 1″/s is not counted.
    let rates: Vec<f64> = counts.iter().map(|angle| -angle / 0.5).collect();
    for (sample, rate) in
        [(0, 0.0), (1, 0.5), (2, 1.0), (19, 1.0), (20, 1.0), (21, 0.5), (22, 0.0), (24, -1.0), (39, -1.0)]
    {
        assert_near(rates[sample], rate, &format!("sample {sample}"));
    }
}

#[test]
fn a_course_of_an_effect_beyond_the_paper_acts_from_its_onset() {
    for (effect, lost) in [
        ("scale-factor-quadratic-step = { ppm = 1000, time_s = 5 }", 0.9),
        ("dead-zone-step = { arcsec_per_s = 400, time_s = 5 }", 1800.0),
        ("sensor-lag-step = { time_constant_s = 2, time_s = 5 }", 0.0),
        ("scale-factor-noise-step = { ppm_sqrt_s = 0, time_s = 5 }", 0.0),
        ("bias-instability-step = { arcsec_per_h = 0, time_s = 5 }", 0.0),
        ("drift-temperature-hysteresis-step = { arcsec_per_h = 3600, time_s = 5 }", 0.0),
    ] {
        assert_near(total(&format!("gyro.GYRX.{effect}"), 20, 360.0, 0.0), 3600.0 - lost, effect);
    }
}
