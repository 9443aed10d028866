use super::*;

use geu_model::units::ARCSEC_PER_RAD;
use geu_protocol::capture::Timestamp;
use geu_protocol::{CLOCK_PER_SAMPLE, Sample};
use nalgebra::{UnitQuaternion, Vector3};

#[test]
fn the_times_count_from_the_first_that_was_received() {
    let start_ns = 1_790_000_000_000_000_000;
    let mut reader = NodeReader::new(AccumulatedCounts::starting_at(0));
    for sample in 1..=5 {
        // The first sample has the time of the unit's clock alone.
        let is_received = sample > 1;
        let t_ns = sample * SAMPLE_INTERVAL_NS + if is_received { start_ns } else { 0 };
        reader.push(1, None, &[0.0; 4], 20.0, None, Some((t_ns, is_received)));
    }
    let counts = reader.finish(0).expect("counts");
    assert_eq!((counts.start_ns, counts.is_received), (start_ns, true));
    assert_eq!(counts.node_s, [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]);
    assert_eq!(counts.received_late_s, [(2, 0.0), (3, 0.0), (4, 0.0), (5, 0.0)]);
}

#[test]
fn parts_of_a_recording_follow_each_other() {
    let row = |number: u64| {
        let sample = Sample {
            sequence: number as u16,
            increments: [number as i16 % 100, -3, 5, 7],
            gyro_flags: 0x0F,
            clock_count: (number + 1) * CLOCK_PER_SAMPLE,
            ..Sample::default()
        };
        // Receive times wander by a millisecond, and those before the ends of the parts are late.
        let late_ns = number as i64 % 7 * 150_000 + if [380, 690].contains(&number) { 900_000_000 } else { 0 };
        let time = Timestamp { t_ns: (number as i64 + 1) * SAMPLE_INTERVAL_NS + late_ns, digits: 6 };
        ReceivedSample { time: Some(time), is_received: true, sample, has_clock: true }
    };
    // Samples 390 to 399 are missing, and 400 is the first of a part.
    let rows = || (0..1000).filter(|number| !(390..400).contains(number)).map(row);
    let mut whole = CountsReader::default();
    rows().for_each(|row| whole.row(&row));
    let whole = whole.finish(0).expect("counts");
    let (mut reader, mut parts) = (CountsReader::default(), Vec::new());
    for row in rows() {
        reader.row(&row);
        let is_irregular = (380..383).chain(690..693).any(|sequence| sequence == row.sample.sequence);
        assert_eq!(reader.last_ns(0).is_none(), is_irregular, "{}", row.sample.sequence);
        if [389, 700].contains(&row.sample.sequence) {
            let last_ns =
                reader.last_ns(0).expect("a time") - (i64::from(row.sample.sequence) + 1) * SAMPLE_INTERVAL_NS;
            assert!((0..1_000_000).contains(&last_ns), "{last_ns}");
            parts.push(reader.end_part(0).expect("a part"));
            assert_eq!(reader.samples(), 0);
        }
    }
    parts.extend(reader.end_part(0));
    let (mut first, mut end_ns) = (0, None);
    for part in &parts {
        let of_whole_ns = whole.start_ns + (whole.node_s[first] * 1e9).round() as i64;
        assert!((part.start_ns - of_whole_ns).abs() < 1_000_000, "{} {of_whole_ns}", part.start_ns);
        assert!(end_ns.is_none_or(|end_ns| end_ns == part.start_ns), "{end_ns:?} {}", part.start_ns);
        end_ns = Some(part.start_ns + (part.end_s() * 1e9).round() as i64);
        for node in 0..=part.len() {
            for gyro in 0..4 {
                let of_whole = whole.accumulated[gyro][first + node] - whole.accumulated[gyro][first];
                assert_eq!(part.accumulated[gyro][node], of_whole);
            }
            assert!((part.node_s[node] - (whole.node_s[first + node] - whole.node_s[first])).abs() < 1e-3);
        }
        first += part.len();
    }
    assert_eq!(first, whole.len());
    let broken = |counts: &AccumulatedCounts| counts.breaks.iter().map(|own| own.to - own.from).collect::<Vec<_>>();
    assert_eq!(parts.iter().map(broken).collect::<Vec<_>>(), [vec![], vec![11], vec![]]);
    assert_eq!(broken(&whole), [11]);
}

#[test]
fn the_sum_of_a_node_and_its_coning_are_the_turn_of_its_samples() {
    // A cone of 10 degrees twice a second, at 1000 samples a second.
    let turn = |sample: i32| {
        let angle = std::f64::consts::TAU * 2e-3 * f64::from(sample);
        Vector3::new(angle.cos(), angle.sin(), 0.1) * (0.175 * std::f64::consts::TAU * 2e-3)
    };
    let mut reader = NodeReader::new(AccumulatedCounts::of_unit(Gyros::ALL, 1e-3, 0));
    let mut turned = vec![UnitQuaternion::identity()];
    for sample in 0..1024 {
        let arcsec = turn(sample) * ARCSEC_PER_RAD;
        reader.push(1, None, &[arcsec.x, arcsec.y, arcsec.z, 0.0], 20.0, None, None);
        reader.push_coning(&[[0.0; 4]; 4].map(Vec::from));
        turned.push(turned[turned.len() - 1] * UnitQuaternion::from_scaled_axis(turn(sample)));
    }
    // Nodes of 64 samples.
    (0..6).for_each(|_| reader.halve());
    let counts = &reader.counts;
    let error = |has_coning: bool| {
        let mut attitude = UnitQuaternion::identity();
        for node in 1..counts.node_s.len() {
            let sum = Vector3::from_fn(|axis, _| counts.accumulated[axis][node] - counts.accumulated[axis][node - 1]);
            let pair = |one: usize, other: usize| counts.coning[one][other][node] / ARCSEC_PER_RAD;
            let coning = Vector3::new(pair(1, 2), pair(2, 0), pair(0, 1)) * f64::from(u8::from(has_coning));
            attitude *= UnitQuaternion::from_scaled_axis((sum + coning) / ARCSEC_PER_RAD);
        }
        attitude.angle_to(&turned[1024]) * ARCSEC_PER_RAD
    };
    assert!(error(false) > 3000.0 && error(true) < 30.0, "{} {}", error(false), error(true));
}
