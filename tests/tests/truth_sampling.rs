//! What a truth that is sampled loses of a tumble: between samples the unit turns about one axis, while the axis of a tumbling
//! body moves (coning). The table of docs/truth.md comes from here:
//! `cargo test --locked -p geu-tests --test geu truth_sampling -- --nocapture`.

use std::fmt::Write as _;

use geu_model::attitude::turn_between_arcsec;
use geu_model::units::ARCSEC_PER_RAD;
use geu_tests::root;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// Length of the tumble, s, and steps of its integration in a second.
const LENGTH_S: usize = 300;
const STEPS: usize = 400;

/// A free body of the moments 700, 1000 and 900 kg m² that begins at 7°/s: its attitude at every step, and the rotation that
/// gyros sense, ∫ω dt about its axes, at the end. Euler's equations by the classical Runge-Kutta method.
fn tumble() -> (Vec<[f64; 4]>, Vector3<f64>) {
    let inertia = Vector3::new(700.0, 1000.0, 900.0);
    let step_s = 1.0 / STEPS as f64;
    let mut rate = Vector3::new(5.0, 2.0, 4.5).normalize() * 7_f64.to_radians();
    let (mut attitude, mut sensed) = (UnitQuaternion::<f64>::identity(), Vector3::zeros());
    let slope = |rate: &Vector3<f64>| -rate.cross(&inertia.component_mul(rate)).component_div(&inertia);
    let turning = |q: &Quaternion<f64>, rate: &Vector3<f64>| q * Quaternion::from_imag(*rate) * 0.5;
    let parts = |q: &UnitQuaternion<f64>| [q.w, q.i, q.j, q.k];
    let mut attitudes = vec![parts(&attitude)];
    for _ in 0..LENGTH_S * STEPS {
        let q = *attitude.quaternion();
        let (a, p) = (slope(&rate), turning(&q, &rate));
        let rate_b = rate + a * (step_s / 2.0);
        let (b, r) = (slope(&rate_b), turning(&(q + p * (step_s / 2.0)), &rate_b));
        let rate_c = rate + b * (step_s / 2.0);
        let (c, s) = (slope(&rate_c), turning(&(q + r * (step_s / 2.0)), &rate_c));
        let rate_d = rate + c * step_s;
        let (d, t) = (slope(&rate_d), turning(&(q + s * step_s), &rate_d));
        sensed += (rate + (rate_b + rate_c) * 2.0 + rate_d) * (step_s / 6.0);
        rate += (a + (b + c) * 2.0 + d) * (step_s / 6.0);
        attitude = UnitQuaternion::new_normalize(q + (p + (r + s) * 2.0 + t) * (step_s / 6.0));
        attitudes.push(parts(&attitude));
    }
    (attitudes, sensed * ARCSEC_PER_RAD)
}

#[test]
fn what_sampling_loses_of_a_tumble_falls_with_the_square_of_the_rate_as_the_docs_say() {
    let (attitudes, sensed) = tumble();
    let mut table = String::new();
    let mut worst = Vec::new();
    for per_second in [2, 4, 10, 20, 50] {
        let samples: Vec<[f64; 4]> = attitudes.iter().step_by(STEPS / per_second).copied().collect();
        let mut turned = Vector3::zeros();
        samples.windows(2).for_each(|pair| turned += Vector3::from(turn_between_arcsec(pair[0], pair[1])));
        let lost = turned - sensed;
        let _ = writeln!(table, "| {per_second} | {:+.2} | {:+.2} | {:+.2} |", lost.x, lost.y, lost.z);
        worst.push(lost.abs().max());
    }
    println!("{table}");
    // The error is of the second order: twice as many samples, a quarter of it.
    assert!((worst[0] / worst[1] - 4.0).abs() < 0.2 && (worst[2] / worst[3] - 4.0).abs() < 0.1, "{worst:?}");
    let docs = std::fs::read_to_string(root().join("docs/truth.md")).expect("the page");
    assert!(table.lines().all(|row| docs.contains(row)), "docs/truth.md does not have\n{table}");
}
