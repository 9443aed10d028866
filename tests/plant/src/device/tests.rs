use super::*;

fn plant(unit: DeviceUnit, effects: Vec<DeviceEffect>) -> DevicePlant {
    let motion = DeviceMotionKind::Table;
    let reference = Case::reference(&unit, motion, false);
    DevicePlant { unit, seed: 1, duration_s: 60.0, start_unix_s: 1000, motion, reference, effects }
}

/// Numbers of a head.
fn numbers(recording: &DeviceRecording, head: usize) -> Vec<f64> {
    recording.samples.iter().map(|(_, numbers)| numbers[head]).collect()
}

fn effect(code: &str, heads: &[usize], parameters: &[(&str, f64)]) -> DeviceEffect {
    DeviceEffect::new(code, heads, parameters).expect("a known effect")
}

/// Without errors and noises of its own.
fn ideal(unit: DeviceUnit) -> DeviceUnit {
    DeviceUnit {
        scale_factor_ppm: 0.0,
        bias_arcsec_h: 0.0,
        misalignment_arcsec: 0.0,
        angle_random_walk_arcsec_sqrt_s: 0.0,
        bias_instability_arcsec_h: 0.0,
        rate_random_walk_arcsec_s_sqrt_s: 0.0,
        ..unit
    }
}

#[test]
fn a_seed_gives_the_same_bytes_and_another_seed_other_bytes() {
    for unit in DeviceUnit::all() {
        let one = plant(unit, vec![]);
        let [again, other] = [one.record(false), DevicePlant { seed: 2, ..one.clone() }.record(false)];
        let one = one.record(false);
        assert!(one.link == again.link && one.reference == again.reference);
        assert!(one.link != other.link && one.reference != other.reference);
    }
}

#[test]
fn an_effect_on_a_head_changes_neither_the_others_nor_the_reference() {
    for (code, parameters) in [
        ("drift-step", &[("arcsec_per_h", 1e5), ("time_s", 20.0)][..]),
        ("scale-factor", &[("ppm", 3000.0)]),
        ("scale-factor-step", &[("ppm", 3000.0), ("time_s", 20.0)]),
        ("scale-factor-asymmetry", &[("ppm", 3000.0)]),
        ("misalignment", &[("arcsec", 18_000.0)]),
        ("drift-temperature", &[("arcsec_per_h_per_k", 1e5)]),
        ("sensor-lag", &[("time_constant_s", 0.05)]),
        ("stuck-output", &[("time_s", 20.0), ("duration_s", 5.0)]),
        ("dead-output", &[("time_s", 20.0), ("duration_s", 5.0)]),
        ("sign-inversion", &[("on", 1.0)]),
        ("unit-factor", &[("factor", 0.0174)]),
        ("clipping", &[("arcsec_s", 1800.0)]),
    ] {
        let [null, injected] = [vec![], vec![effect(code, &[1], parameters)]]
            .map(|effects| plant(DeviceUnit::tetrad(), effects).record(true));
        assert!(null.reference == injected.reference, "{code}");
        for head in 0..4 {
            assert_eq!(numbers(&null, head) == numbers(&injected, head), head != 1, "{code} {head}");
        }
    }
}

#[test]
fn increments_of_an_ideal_unit_add_up_to_the_true_angle() {
    for kind in DeviceMotionKind::ALL {
        let plant = DevicePlant { motion: kind, ..plant(ideal(DeviceUnit::tetrad()), vec![]) };
        let motion = DeviceMotion::drawn(kind, &plant.unit, &mut Noise::new(1, 0), 60.0);
        let (_, [x, y, z]) = motion.at(60.0);
        let recording = plant.record(true);
        let sum: f64 = numbers(&recording, 0).iter().sum();
        let expected = (x + y + z) / 3f64.sqrt();
        // Half a count.
        assert!((0.01 * sum - expected).abs() < 0.005001, "{kind:?}: {sum} {expected}");
        let parity: f64 = (0..4).map(|head| numbers(&recording, head).iter().sum::<f64>()).sum();
        assert!(parity.abs() <= 2.0, "{kind:?}: {parity}");
    }
}

#[test]
fn the_white_noise_of_a_stim300_has_the_deviation_of_its_data_sheet() {
    let mut unit = ideal(DeviceUnit::stim300());
    unit.angle_random_walk_arcsec_sqrt_s = DeviceUnit::stim300().angle_random_walk_arcsec_sqrt_s;
    let recording = plant(unit, vec![]).record(true);
    // At rest up to 10 s. 0.15 deg/√h in 0.5 ms: 0.15/60/√0.0005 deg/s.
    let rates = numbers(&recording, 0)[..20_000].iter().map(|number| number / 16384.0).collect::<Vec<f64>>();
    let rms = (rates.iter().map(|rate| rate * rate).sum::<f64>() / rates.len() as f64).sqrt();
    assert!((rms / 0.111_80 - 1.0).abs() < 0.03, "{rms} deg/s");
}

#[test]
fn rates_and_quaternions_report_the_same_turn() {
    // About X alone, the table's first axis, up to its rest.
    let unit = DeviceUnit::stim300();
    let rates = plant(unit.clone(), vec![]);
    let reference = DeviceReference { is_attitude: true, sigma_arcsec: 0.0, ..rates.reference.clone() };
    let attitude = DevicePlant { reference, ..rates.clone() }.record(false).reference;
    let exact = DeviceReference { sigma_arcsec: 0.0, ..rates.reference.clone() };
    let rates = DevicePlant { reference: exact, ..rates }.record(false).reference;
    let cell = |line: &str, column: usize| line.split(',').nth(column).and_then(|cell| cell.parse::<f64>().ok());
    let turned_arcsec: f64 = rates.lines().skip(1).filter_map(|line| Some(0.01 * cell(line, 1)?)).sum();
    let last = attitude.lines().last().expect("rows");
    let (w, x) = (cell(last, 1).expect("q_w"), cell(last, 2).expect("q_x"));
    let difference = (2.0 * x.atan2(w)).to_degrees() * 3600.0 - turned_arcsec;
    let turns = difference / (360.0 * 3600.0);
    assert!((turns - turns.round()).abs() * 360.0 * 3600.0 < 0.01, "{turns} turns");
    assert_eq!(rates.lines().count() - 1, 6106);
    assert_eq!(attitude.lines().count() - 1, 6107);
}

#[test]
fn a_time_offset_of_five_samples_shifts_the_numbers_by_five() {
    let recorded = |effects| plant(ideal(DeviceUnit::mm510()), effects).record(true);
    let null = numbers(&recorded(vec![]), 1);
    let late = numbers(&recorded(vec![effect("time-offset", &[], &[("seconds", 0.05)])]), 1);
    assert!(null.iter().any(|number| *number != 0.0));
    // The sum of times rounds otherwise, by one count at most.
    assert!(null.iter().zip(&late[5..]).all(|(one, other)| (one - other).abs() <= 1.0));
}

#[test]
fn clock_asymmetry_and_lag_change_the_counted_angle_by_their_share() {
    let unit = ideal(DeviceUnit::tetrad());
    let motion = DeviceMotion::drawn(DeviceMotionKind::Table, &unit, &mut Noise::new(1, 0), 60.0);
    let turned = |effects: Vec<DeviceEffect>| -> (f64, f64) {
        let numbers = numbers(&plant(unit.clone(), effects).record(true), 0);
        let positive: f64 = numbers.iter().filter(|number| **number > 0.0).sum();
        (0.01 * positive, 0.01 * numbers.iter().sum::<f64>())
    };
    let (positive, angle) = turned(vec![]);
    assert!(positive > 10_000.0 && angle < positive);
    // The sample of the clock is short, its number that of the whole rate: half a count, and a part of the last sample.
    let (_, with_clock) = turned(vec![effect("clock-frequency", &[], &[("ppm", 1000.0)])]);
    assert!((with_clock - 1.001 * angle).abs() < 1e-4 * positive, "{with_clock} {angle}");
    let (_, asymmetric) = turned(vec![effect("scale-factor-asymmetry", &[0], &[("ppm", 1000.0)])]);
    assert!((asymmetric - (angle - positive * 1e-3 / 1.001)).abs() < 0.1, "{asymmetric} {angle} {positive}");
    // Behind by the lag times the rate at the end.
    let (_, lagging) = turned(vec![effect("sensor-lag", &[0], &[("time_constant_s", 0.05)])]);
    let (rates, _) = motion.at(60.0);
    let behind = 0.05 * rates.iter().sum::<f64>() / 3f64.sqrt();
    assert!((angle - lagging - behind).abs() < 0.02, "{lagging} {angle} {behind}");
}

#[test]
fn a_fast_clock_and_lost_samples_change_the_number_of_samples() {
    let count = |effects| plant(DeviceUnit::mm510(), effects).record(true).samples.len();
    assert_eq!(count(vec![]), 6000);
    assert_eq!(count(vec![effect("clock-frequency", &[], &[("ppm", 1000.0)])]), 6006);
    let kept = count(vec![effect("lost-samples", &[], &[("share", 0.05)])]);
    // Five deviations of 6000 draws.
    assert!((kept as f64 - 5700.0).abs() < 85.0, "{kept}");
}

#[test]
fn a_campaign_has_twenty_recordings_of_which_four_have_no_effect() {
    for unit in DeviceUnit::all() {
        let cases: Vec<Case> = (0..20).map(|run| Case::drawn(&unit, Mix::Effects, 1, run, None, None)).collect();
        let count = |code: &str| cases.iter().filter(|case| case.code == code).count();
        assert_eq!([count("null"), count("drift-step"), count("time-offset")], [4, 4, 2]);
        assert!(cases.iter().all(|case| case.plant.effects.len() == usize::from(case.code != "null")));
    }
}
