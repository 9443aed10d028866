//! The unit, sample by sample.

use geu_protocol::{CommandResult, command};

use geu_protocol::field::unit_flag;

use super::*;
use crate::attitude::{AttitudeRow, Knot, RecordedAttitude, SampleQuality, StreamedAttitude};

fn unit(overrides: &[&str]) -> GyroUnit {
    let overrides: Vec<String> = overrides.iter().map(|text| text.to_string()).collect();
    GyroUnit::new(&Configuration::reference_with(&overrides).expect("valid"))
}

fn run(unit: &mut GyroUnit, samples: usize) -> Vec<Sample> {
    (0..samples).map(|_| unit.end_sample().sample).collect()
}

fn outcome(unit: &mut GyroUnit, payload: &[u8]) -> CommandResult {
    unit.command(payload).expect("no fault keeps it from hearing").reply.outcome()
}

#[test]
fn rounding_is_half_away_from_zero_and_never_accumulates() {
    let mut channel = unit(&[]).channels[0].clone();
    // Accumulated −1.5, −0.5, 0.5, 1.5 round to −2, −1, 1, 2.
    let increments = [-1.5, 1.0, 1.0, 1.0].map(|counts| channel.accumulate(counts, Rounding::Accumulated));
    assert_eq!(increments, [-2.0, 1.0, 2.0, 1.0]);
}

#[test]
fn a_truth_covers_what_its_clock_needs() {
    let within = |overrides: &[&str], truth: &Truth, most: u64| {
        let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
        let configuration = Configuration::reference_with(&overrides).expect("valid");
        GyroUnit::samples_within(&configuration, truth, most)
    };
    let recorded = |tenths: u32| {
        let row =
            |tenth| AttitudeRow { t_s: f64::from(tenth) / 10.0, angle_control_arcsec: [0.0; 3], theta_psi_rad: None };
        let rows: Vec<AttitudeRow> = (0..=tenths).map(row).collect();
        Truth::Recorded(Arc::new(RecordedAttitude::new(rows).expect("good rows")))
    };
    let stepped = |t_s: f64| {
        let knots = StreamedAttitude::default();
        knots.append(Knot { t_s, angle_control_arcsec: [0.0; 3], basis: SampleQuality::Received, sun: None });
        Truth::Stepped(Arc::new(knots))
    };
    assert_eq!(within(&[], &recorded(1000), 1000), 200);
    assert_eq!(within(&[], &recorded(1000), 150), 150);
    assert_eq!(within(&[], &recorded(999), 1000), 199);
    assert_eq!(within(&[], &Truth::Scenario, 1000), 1000);
    // A slow clock: its 200th sample ends 1 ms after 100 s; only a recorded truth must cover that whole sample.
    let slow = &["unit.clock-frequency.ppm=-10"];
    assert_eq!(within(slow, &recorded(1000), 1000), 199);
    assert_eq!(within(slow, &stepped(100.0), 1000), 199);
    assert_eq!(within(slow, &stepped(100.002), 1000), 200);
    assert_eq!(within(&["unit.clock-frequency.ppm=10"], &recorded(1000), 1000), 200);
    // Counts of the motion 0.2 s ahead.
    let ahead = &["unit.time-offset.seconds=-0.2"];
    assert_eq!((within(ahead, &recorded(1000), 1000), within(ahead, &stepped(100.2), 1000)), (199, 200));
}

#[test]
fn accumulated_counts_stay_within_half_a_count_of_the_unquantised() {
    let mut unit = unit(&[]);
    let (mut counted, mut unquantised) = ([0.0; 4], [0.0; 4]);
    for _ in 0..20_000 {
        let (ended, traces) = unit.end_sample_traced();
        for index in 0..4 {
            counted[index] += f64::from(ended.sample.increments[index]);
            unquantised[index] += traces[index].unquantised;
            assert!((counted[index] - unquantised[index]).abs() < 0.500_001);
        }
    }
    for (accumulated, summed) in unit.accumulated_counts().zip(unquantised) {
        assert!((accumulated - summed).abs() < 1e-6, "{accumulated} {summed}");
    }
}

#[test]
fn a_unit_that_follows_measured_temperatures_counts_as_any_other() {
    let one_effect = &["gyro.GYRX.pivot-clearance.clearance_arcsec=12"];
    let of_unit = &["unit.misalignment-thermal.arcsec_per_deg=0.9", "unit.clock-frequency.ppm=14"];
    let of_temperature = &["temperature.electronics.amplitude_k=5", "gyro.GYRY.drift-temperature.arcsec_per_h_per_k=9"];
    let negative_pulse = &[
        "unit.time-offset-pulse.seconds=-0.01",
        "unit.time-offset-pulse.time_s=600",
        "unit.time-offset-pulse.duration_s=300",
    ];
    let falling_clock = &["unit.clock-frequency-ramp.ppm_per_day=-50"];
    let keep_time = [&[][..], one_effect, of_temperature].map(|overrides| (overrides, true));
    let move_time = [&of_unit[..], negative_pulse, falling_clock].map(|overrides| (overrides, false));
    for (overrides, keeps_time) in keep_time.into_iter().chain(move_time) {
        let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
        let configuration = Configuration::reference_with(&overrides).expect("valid").without_noise();
        let temperatures = Arc::new(MeasuredTemperatures::new(&configuration.electronics, &[], 4000, 0.5));
        let mut unit = GyroUnit::new(&configuration);
        let mut following = GyroUnit::following(&configuration, &Truth::Scenario, temperatures.clone());
        assert_eq!(following.keeps_time(), keeps_time, "{overrides:?}");
        let mut gyros: Vec<_> = (0..4).map(|gyro| FollowingGyro::new(&configuration, gyro, &temperatures)).collect();
        let followed = following.follow(4000);
        for samples in followed.chunks(300) {
            let mut counts = [const { [0.0; 300] }; 4];
            gyros.iter_mut().zip(&mut counts).for_each(|(gyro, counts)| gyro.count(samples, counts));
            for (place, end_ns) in samples.ends_ns().enumerate() {
                assert_eq!(unit.end_sample().end_ns, end_ns);
                for (expected, counts) in unit.accumulated_counts().zip(&counts) {
                    let error = (counts[place] - expected).abs();
                    assert!(error < 1e-6 * expected.abs().max(1.0), "{overrides:?}: {error}");
                }
            }
        }
    }
}

#[test]
fn self_test_adds_its_counts_for_its_samples_and_flags_them() {
    let (mut plain, mut tested) = (unit(&[]), unit(&[]));
    assert_eq!(outcome(&mut tested, &[4, 0b0101, 0, 100, 3]), CommandResult::Done);
    assert_eq!(outcome(&mut tested, &[4, 1, 0, 1, 1]), CommandResult::NotPossibleNow);
    let (plain, tested) = (run(&mut plain, 5), run(&mut tested, 5));
    for index in 0..5 {
        let added: Vec<i16> =
            tested[index].increments.iter().zip(plain[index].increments).map(|(a, b)| a - b).collect();
        let (counts, flag) = if index < 3 { (100, unit_flag("self_test")) } else { (0, 0) };
        assert_eq!(added, [counts, 0, counts, 0]);
        assert_eq!(tested[index].unit_flags & unit_flag("self_test"), flag);
    }
}

#[test]
fn what_commands_do_to_counts_stands_in_the_trace() {
    let mut unit = unit(&[]);
    let _ = unit.command(&[4, 1, 0, 100, 2]);
    let _ = unit.command(&[6, 0b1101]);
    for _ in 0..4 {
        let (ended, traces) = unit.end_sample_traced();
        for (trace, count) in traces.iter().zip(ended.sample.increments) {
            let sum: f64 = trace.true_arcsec + trace.changes.iter().sum::<f64>();
            assert!((sum - trace.unquantised).abs() < 1e-9);
            assert!((trace.unquantised - f64::from(count)).abs() <= 1.0, "{} {count}", trace.unquantised);
        }
    }
}

#[test]
fn clipping_is_flagged_never_wrapped_and_the_loss_counted() {
    let largest = command::payload(&command::COMMANDS[3], &[1, 32_767, 1]);
    // A drift of 10″ per sample interval reduces the counts, one of −10″ increases them.
    let mut below = unit(&["gyro.GYRX.calibration.drift_arcsec_per_half_s=10"]);
    let _ = below.command(&largest);
    let sample = run(&mut below, 1)[0];
    assert!((32_750..32_767).contains(&sample.increments[0]));
    assert_eq!((sample.gyro_flags, below.lost_counts()[0]), (0x0F, 0.0));
    let mut above = unit(&["gyro.GYRX.calibration.drift_arcsec_per_half_s=-10"]);
    let _ = above.command(&largest);
    let sample = run(&mut above, 1)[0];
    assert_eq!((sample.increments[0], sample.gyro_flags), (i16::MAX, 0x1F));
    assert!((8.0..13.0).contains(&above.lost_counts()[0]), "{:?}", above.lost_counts());
}

#[test]
fn reset_restarts_sequence_and_clock_with_the_running_sample() {
    let mut unit = unit(&[]);
    run(&mut unit, 10);
    let _ = unit.command(&[5]);
    let after = run(&mut unit, 2);
    assert_eq!((after[0].sequence, after[0].clock_count), (0, 500_000));
    assert_eq!((after[1].sequence, after[1].clock_count), (1, 1_000_000));
}

#[test]
fn a_stopped_gyro_reads_nothing_and_takes_a_minute_to_spin_up() {
    let mut unit = unit(&[]);
    let _ = unit.command(&[6, 0b1110]);
    let stopped = run(&mut unit, 4);
    assert!(stopped.iter().all(|h| h.increments[0] == 0 && h.gyro_flags == 0x0E && h.unit_flags & 2 == 2));
    let _ = unit.command(&[6, 0x0F]);
    let _ = unit.command(&[6, 0x0F]);
    let spinning = run(&mut unit, 121);
    assert!(spinning[..120].iter().all(|h| h.gyro_flags == 0x0E && h.unit_flags & 2 == 0));
    assert_eq!((spinning[120].gyro_flags, spinning[120].unit_flags & 2), (0x0F, 2));
}

#[test]
fn a_cold_sensor_leaves_its_band_and_comes_back() {
    let mut unit = unit(&[]);
    let _ = unit.command(&[7, 0]);
    let cooling = run(&mut unit, 240);
    assert_eq!((cooling[0].unit_flags & 1, cooling[239].unit_flags & 1), (1, 0));
    let _ = unit.command(&[7, 1]);
    assert_eq!(run(&mut unit, 12_000)[11_999].unit_flags & 1, 1);
}

#[test]
fn polled_mode_keeps_the_sample_until_it_is_asked_for() {
    let mut unit = unit(&[]);
    assert_eq!(outcome(&mut unit, &[3]), CommandResult::NotPossibleNow);
    assert_eq!(outcome(&mut unit, &[2, 1]), CommandResult::Done);
    assert_eq!(outcome(&mut unit, &[3]), CommandResult::NotPossibleNow);
    let ended = unit.end_sample();
    assert!(!ended.cyclic);
    assert_eq!(ended.sample.unit_flags & 16, 16);
    for _ in 0..2 {
        assert_eq!(unit.command(&[3]).expect("heard").polled, Some(ended));
    }
    let _ = unit.command(&[2, 0]);
    assert!(unit.end_sample().cyclic);
}

#[test]
fn a_fast_clock_ends_samples_early() {
    let mut unit = unit(&["unit.clock-frequency.ppm=100"]);
    for _ in 0..10_000 {
        unit.end_sample();
    }
    // 10 000 samples of 0.5/(1 + 10⁻⁴) s.
    let expected_ns = 5_000e9 / 1.0001;
    assert!((unit.running_end_ns() as f64 - 0.5e9 / 1.0001 - expected_ns).abs() < 2.0);
}
