//! Sources that are on time, late, missing, behind, or jump.

use super::*;

/// An attitude sample after a rotation about X.
fn about_x(t_s: f64, arcsec: f64) -> TruthSample {
    let half = (arcsec / 3600.0 / 2.0_f64).to_radians();
    TruthSample { t_s, motion: MotionValue::Attitude([half.cos(), half.sin(), 0.0, 0.0]), sun: None }
}

fn rate(t_s: f64, x: f64) -> TruthSample {
    TruthSample { t_s, motion: MotionValue::Rate([x, 0.0, 0.0]), sun: None }
}

fn push(synchroniser: &mut TruthSynchroniser, samples: &[TruthSample]) {
    samples.iter().for_each(|sample| drop(synchroniser.push(*sample)));
}

fn synchroniser() -> TruthSynchroniser {
    TruthSynchroniser::new(Arc::default(), TruthNumbers::default())
}

/// The rotation about X that was used in each sample interval.
fn used(synchroniser: &TruthSynchroniser) -> Vec<f64> {
    let knots = synchroniser.truth.knots_from(0);
    let ends: Vec<f64> = knots.iter().step_by(KNOTS).map(|knot| knot.angle_control_arcsec[0]).collect();
    ends.windows(2).map(|pair| pair[1] - pair[0]).collect()
}

fn assert_near(got: &[f64], expected: &[f64]) {
    let near = got.iter().zip(expected).all(|(got, expected)| (got - expected).abs() < 1e-6);
    assert!(got.len() == expected.len() && near, "{got:?} is not {expected:?}");
}

#[test]
fn samples_on_time_are_used_unchanged() {
    let mut synchroniser = synchroniser();
    for step in 0..=10 {
        let t_s = f64::from(step) * 0.1;
        synchroniser.push(about_x(1e6 + t_s, 50.0 * t_s * t_s));
    }
    assert!(synchroniser.covers(1.0) && !synchroniser.covers(1.01));
    assert_eq!((synchroniser.finish(0.5), synchroniser.finish(1.0)), (None, None));
    assert_near(&used(&synchroniser), &[12.5, 37.5]);
    assert_eq!(synchroniser.counts, TruthStatistics { received: 11, ..TruthStatistics::default() });
}

#[test]
fn used_truth_does_not_depend_on_early_samples() {
    // The unit's samples end a rounding after the samples.
    let ends: Vec<f64> = (1..=40).map(|step| f64::from(step) * 0.5 * (1.0 + 3e-16)).collect();
    let samples: Vec<TruthSample> =
        (0..=40).map(|step| about_x(f64::from(step) * 0.5, (f64::from(step) * 0.7).sin() * 3e4)).collect();
    let (mut ahead, mut just_in_time) = (synchroniser(), synchroniser());
    push(&mut ahead, &samples);
    just_in_time.push(samples[0]);
    for (end_s, sample) in ends.iter().zip(&samples[1..]) {
        just_in_time.push(*sample);
        assert!(just_in_time.covers(*end_s));
        just_in_time.finish(*end_s);
        ahead.finish(*end_s);
    }
    assert_eq!(ahead.truth.knots_from(0), just_in_time.truth.knots_from(0));
}

#[test]
fn a_late_sample_is_compensated_over_the_next_without_loss_of_angle() {
    let mut synchroniser = synchroniser();
    push(&mut synchroniser, &[rate(0.0, 0.0), rate(0.5, 100.0)]);
    synchroniser.finish(0.5);
    // The reversal is not received yet: 100″/s are held.
    synchroniser.finish(1.0);
    push(&mut synchroniser, &[rate(1.0, -100.0), rate(1.5, -100.0)]);
    synchroniser.finish(1.5);
    push(&mut synchroniser, &[rate(2.0, -100.0)]);
    synchroniser.finish(2.0);
    assert_near(&used(&synchroniser), &[50.0, 50.0, -150.0, -50.0]);
    let bases: Vec<SampleQuality> =
        synchroniser.truth.knots_from(1).iter().step_by(KNOTS).map(|knot| knot.basis).collect();
    assert_eq!(bases, [SampleQuality::Received, SampleQuality::Held, SampleQuality::Received, SampleQuality::Received]);
    assert_eq!(synchroniser.counts.late, 1);
    // Evenly: every tenth of the sample has the same share.
    let knots = synchroniser.truth.knots_from(10);
    let tenths: Vec<f64> = knots
        .windows(2)
        .take(5)
        .map(|pair| pair[1].angle_control_arcsec[0] - pair[0].angle_control_arcsec[0])
        .collect();
    assert_near(&tenths, &[-30.0; 5]);
}

#[test]
fn a_missing_source_leaves_the_unit_at_rest_and_is_reported_once_with_its_return() {
    let mut synchroniser = synchroniser();
    push(&mut synchroniser, &[rate(0.0, 0.0), rate(0.5, 10.0)]);
    let notes: Vec<String> = (1..=16).filter_map(|step| synchroniser.finish(f64::from(step) * 0.5)).collect();
    assert_eq!(notes.len(), 1, "{notes:?}");
    let rates = used(&synchroniser);
    assert_near(&rates[..11], &[5.0; 11]);
    assert_near(&rates[11..], &[0.0; 5]);
    assert_eq!((synchroniser.counts.late, synchroniser.counts.missing), (10, 5));
    // Its time has jumped when it is back, and continues from there.
    assert!(synchroniser.push(rate(8.2, 1000.0)).is_some_and(|note| note.contains("time jumped by +7.700 s")));
    synchroniser.push(rate(8.7, 20.0));
    assert!(synchroniser.finish(8.5).is_some_and(|note| note.contains("back")));
    assert_near(&used(&synchroniser)[16..], &[6.0]);
    assert_eq!(synchroniser.counts.jumps, 1);
}

#[test]
fn delayed_samples_are_all_counted() {
    let mut synchroniser = synchroniser();
    (0..=1).for_each(|step| drop(synchroniser.push(rate(f64::from(step) * 0.5, 10.0))));
    (1..=20).for_each(|step| drop(synchroniser.finish(f64::from(step) * 0.5)));
    (2..=21).for_each(|step| drop(synchroniser.push(rate(f64::from(step) * 0.5, 10.0))));
    synchroniser.finish(10.5);
    assert!((used(&synchroniser).iter().sum::<f64>() - 105.0).abs() < 1e-9);
    assert_eq!(synchroniser.counts.jumps, 0);
}

#[test]
fn the_lag_of_a_paused_source_is_compensated() {
    let mut synchroniser = synchroniser();
    (0..=2).for_each(|step| drop(synchroniser.push(rate(f64::from(step) * 0.5, 10.0))));
    // The simulator pauses for 10 s, the unit does not.
    (1..=22).for_each(|step| drop(synchroniser.finish(f64::from(step) * 0.5)));
    let mut notes = Vec::new();
    for step in 3..=20 {
        synchroniser.push(rate(f64::from(step) * 0.5, 10.0));
        notes.extend(synchroniser.finish(f64::from(step + 20) * 0.5));
    }
    assert_eq!(notes.len(), 1, "{notes:?}");
    assert!(notes[0].starts_with("it is 10.000 s behind"), "{notes:?}");
    assert_eq!(synchroniser.counts.jumps, 1);
    // Its 10 s of 10″/s.
    assert!((used(&synchroniser).iter().sum::<f64>() - 100.0).abs() < 1e-9, "{:?}", used(&synchroniser));
}

#[test]
fn time_that_jumps_back_continues_from_the_unit_time() {
    let mut synchroniser = synchroniser();
    (0..=4).for_each(|step| drop(synchroniser.push(about_x(100.0 + f64::from(step) * 0.5, 10.0 * f64::from(step)))));
    (1..=4).for_each(|step| drop(synchroniser.finish(f64::from(step) * 0.5)));
    assert!(synchroniser.push(about_x(0.0, 5000.0)).is_some_and(|note| note.contains("jumped by -102.000 s")));
    synchroniser.push(about_x(0.6, 5006.0));
    assert!(synchroniser.covers(2.5));
    synchroniser.finish(2.5);
    assert!((used(&synchroniser)[4] - 5.0).abs() < 1e-3, "{:?}", used(&synchroniser));
}

#[test]
fn attitude_jumps_are_not_counted() {
    let mut synchroniser = synchroniser();
    synchroniser.push(about_x(0.0, 0.0));
    synchroniser.push(about_x(0.5, 50.0));
    // 111° in 0.5 s.
    assert!(synchroniser.push(about_x(1.0, 400_000.0)).is_some_and(|note| note.contains("attitude jumped")));
    synchroniser.push(about_x(1.5, 400_020.0));
    (1..=3).for_each(|step| drop(synchroniser.finish(f64::from(step) * 0.5)));
    assert_near(&used(&synchroniser), &[50.0, 50.0, 20.0]);
    assert_eq!((synchroniser.counts.jumps, synchroniser.counts.late), (1, 0));
}

#[test]
fn rates_beyond_the_range_are_used_up_to_the_configured_limit() {
    let mut synchroniser = synchroniser();
    // 30°/s, while the unit's range is 18.2°/s.
    (0..=4).for_each(|step| drop(synchroniser.push(about_x(f64::from(step) * 0.5, 54_000.0 * f64::from(step)))));
    (1..=4).for_each(|step| drop(synchroniser.finish(f64::from(step) * 0.5)));
    assert!(used(&synchroniser).iter().all(|used| (used - 54_000.0).abs() < 1e-3), "{:?}", used(&synchroniser));
    assert_eq!(synchroniser.counts.jumps, 0);
    let numbers = TruthNumbers { max_rate_deg_s: 20.0, ..TruthNumbers::default() };
    let mut limited = TruthSynchroniser::new(Arc::default(), numbers);
    limited.push(about_x(0.0, 0.0));
    let note = limited.push(about_x(0.5, 54_000.0)).expect("a note");
    assert!(note.contains("by 30.0°/s") && note.contains("expected 20°/s at most (truth.max_rate_deg_s)"), "{note}");
    assert_eq!(limited.counts.jumps, 1);
}

#[test]
fn the_sun_is_used_if_in_the_first_sample_and_held_if_missing_later() {
    let sun_on_z = |sample: TruthSample| TruthSample { sun: Some([0.0, 0.0, 1.0]), ..sample };
    let mut synchroniser = synchroniser();
    // It turns about Y by 10° in a second: θ, between the sun and X, grows from 90° by as much.
    let about_y = |t_s: f64, deg: f64| {
        let half = (deg / 2.0).to_radians();
        TruthSample { t_s, motion: MotionValue::Attitude([half.cos(), 0.0, half.sin(), 0.0]), sun: None }
    };
    synchroniser.push(sun_on_z(about_y(0.0, 0.0)));
    synchroniser.push(about_y(1.0, 10.0));
    assert!(synchroniser.has_sun());
    (1..=3).for_each(|step| drop(synchroniser.finish(f64::from(step) * 0.5)));
    let theta_deg: Vec<f64> =
        synchroniser.truth.knots_from(1).iter().map(|knot| knot.sun.expect("a sun").theta_rad.to_degrees()).collect();
    let expected: Vec<f64> = (1..=15).map(|tenth| 90.0 + f64::from(tenth.min(10))).collect();
    assert_near(&theta_deg, &expected);

    let mut late = self::synchroniser();
    late.push(about_y(0.0, 0.0));
    assert!(late.push(sun_on_z(about_y(0.5, 1.0))).is_some_and(|note| note.contains("its first sample did not")));
    assert_eq!(late.push(sun_on_z(about_y(1.0, 2.0))), None);
    late.finish(0.5);
    assert!(!late.has_sun() && late.truth.knots_from(1).iter().all(|knot| knot.sun.is_none()));
}

#[test]
fn samples_out_of_order_are_counted_and_not_used() {
    let mut synchroniser = synchroniser();
    push(&mut synchroniser, &[rate(0.0, 0.0), rate(0.2, 10.0), rate(0.1, 900.0), rate(0.2, 900.0), rate(0.5, 10.0)]);
    synchroniser.finish(0.5);
    assert_near(&used(&synchroniser), &[5.0]);
    assert_eq!(synchroniser.counts.out_of_order, 2);
}

#[test]
fn a_source_that_ran_before_the_unit_starts_shortly_before_its_last_sample() {
    let mut synchroniser = synchroniser();
    for step in 0..=100 {
        synchroniser.push(rate(50.0 + f64::from(step) * 0.3, f64::from(step)));
        synchroniser.reset_origin();
    }
    assert!((synchroniser.last_s() - 1.0).abs() < 1e-9 && synchroniser.curve.len() <= 5);
    synchroniser.finish(1.0);
    // 0.3 s at each of 100, 99 and 98″/s, 0.1 s at 97″/s.
    assert_near(&used(&synchroniser), &[0.3 * 297.0 + 9.7]);
}

#[test]
fn used_truth_is_finite_and_monotonic_for_any_samples() {
    let mut synchroniser = synchroniser();
    let mut state = 1_u64;
    let mut draw = |most: u64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 33) % most
    };
    let (mut t_s, mut end_s) = (0.0, 0.0);
    for _ in 0..20_000 {
        t_s = match draw(20) {
            0 => -1e12,
            1 => 1e12,
            2 => t_s - 0.3,
            3 => t_s + 1e-300,
            4 => t_s + 4.9,
            _ => t_s + 0.1,
        };
        let motion = match draw(6) {
            0 => MotionValue::Rate([f64::MAX, -f64::MAX, 1.0]),
            1 => MotionValue::Rate([1e4, 0.0, -1e4]),
            2 => MotionValue::Attitude([0.0, 0.6, -0.8, 0.0]),
            3 => MotionValue::Attitude([1.0, 5e-324, 0.0, 0.0]),
            _ => MotionValue::Attitude([-1.0, 0.0, 0.0, 0.0]),
        };
        synchroniser.push(TruthSample { t_s, motion, sun: None });
        if draw(3) == 0 {
            end_s += 0.5;
            synchroniser.finish(end_s);
        }
    }
    let knots = synchroniser.truth.knots_from(0);
    assert!(knots.windows(2).all(|pair| pair[0].t_s < pair[1].t_s), "time rises");
    assert!(knots.iter().all(|knot| knot.angle_control_arcsec.iter().all(|angle| angle.abs() < 1e12)));
}

#[test]
fn memory_is_bounded_to_one_sample_per_millisecond() {
    let mut synchroniser = synchroniser();
    (0..100_000).for_each(|index| drop(synchroniser.push(rate(f64::from(index) * 1e-5, 10.0))));
    assert!(synchroniser.curve.len() < 2100, "{}", synchroniser.curve.len());
    synchroniser.finish(0.5);
    assert_near(&used(&synchroniser), &[5.0]);
}
