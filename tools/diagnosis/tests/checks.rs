//! Each kind of thing that the exact checks look for, put into a recording, is found with its place; what is only an
//! ordinary effect, however large, is not.

use std::io::Write;
use std::path::Path;

use geu_diagnosis::checks::{CheckResult, WiringFault, check};
use geu_model::Configuration;
use geu_plant::{GYROS, Gyro as Of, IndependentModel, PlantedEffect};
use geu_protocol::Gyro;
use geu_protocol::capture::{Format, Reader, RecordPosition, Timestamp};
use geu_protocol::field::unit_flag;
use geu_recording::{
    Decoder, DecoderOptions, Defect, DefectKind, InputReader, ReceivedSample, ReferenceAttitude, Sink, Stop,
};

#[derive(Default)]
struct Rows(Vec<ReceivedSample>);

impl Sink for Rows {
    fn row(&mut self, row: &ReceivedSample) {
        self.0.push(*row);
    }
    fn defect(&mut self, defect: &Defect) {
        panic!("{}", defect.place_text());
    }
}

struct Recording {
    rows: Vec<ReceivedSample>,
    reference: ReferenceAttitude,
}

impl Recording {
    fn of(plant: &IndependentModel) -> Recording {
        let recording = plant.record();
        let (mut decoder, mut rows) = (Decoder::new(&DecoderOptions::default()), Rows::default());
        decoder.begin("link.log", &mut rows);
        let mut reader = Reader::new(Format::Candump);
        reader.finish(recording.link.as_bytes(), &mut |place, event| decoder.event(place, event, &mut rows));
        decoder.count_records(reader.records());
        decoder.finish(&mut rows);
        let reference = ReferenceAttitude::parse("reference.csv", &recording.reference).expect("a reference");
        Recording { rows: rows.0, reference }
    }

    fn hiding(seed: u64, hidden: &[PlantedEffect]) -> Recording {
        Recording::of(&IndependentModel::new(seed, hidden.to_vec()))
    }

    fn checked(&self) -> CheckResult {
        check(&self.rows, &[], &Configuration::reference(), &self.reference)
    }
}

/// 400 s of the plant, with nothing hidden.
fn short() -> Recording {
    Recording::of(&IndependentModel { duration_s: 400.0, ..IndependentModel::new(3, Vec::new()) })
}

fn kinds(checked: &CheckResult) -> Vec<&str> {
    checked.findings.iter().map(|finding| finding.kind.as_str()).collect()
}

/// What was found of a kind: place and text.
fn told<'a>(checked: &'a CheckResult, kind: &str) -> Vec<(&'a str, &'a str)> {
    let of_kind = checked.findings.iter().filter(|finding| finding.kind == kind);
    of_kind.map(|finding| (finding.place.as_str(), finding.text.as_str())).collect()
}

fn wired(code: &str, gyros: &[Of], onset_s: Option<f64>) -> PlantedEffect {
    let on = [("on", 1.0), ("time_s", onset_s.unwrap_or(0.0))];
    let code = if onset_s.is_some() { format!("{code}-step") } else { code.to_owned() };
    PlantedEffect::new(&code, gyros, &on[..1 + usize::from(onset_s.is_some())])
}

/// One fault, of that code, on those gyros, whose onset may be where it was.
fn assert_named(checked: &CheckResult, hidden: &PlantedEffect, onset_s: Option<f64>) {
    let [fault @ WiringFault { gyros, onset_s: found_s, onset_between_s: [from_s, to_s], end_s, .. }] =
        &checked.faults[..]
    else {
        panic!("{hidden:?}: {:?}", checked.faults);
    };
    let hidden_gyros: Vec<&str> = hidden.gyros.iter().map(|gyro| gyro.name()).collect();
    let found_gyros: Vec<&str> = gyros.iter().map(|gyro| gyro.name()).collect();
    assert_eq!((fault.code().as_str(), found_gyros, *end_s), (hidden.code.as_str(), hidden_gyros, None));
    assert_eq!(found_s.is_some(), onset_s.is_some(), "{hidden:?}");
    if let Some(onset_s) = onset_s {
        assert!((from_s - 2.0..=to_s + 2.0).contains(&onset_s), "{hidden:?}: {from_s} to {to_s} s");
    }
    assert_eq!(kinds(checked), [fault.code()], "{hidden:?}");
}

const PAIRS: [[Of; 2]; 6] =
    [[Of::X, Of::Y], [Of::X, Of::Za], [Of::X, Of::Zb], [Of::Y, Of::Za], [Of::Y, Of::Zb], [Of::Za, Of::Zb]];

#[test]
fn a_wiring_fault_is_named_on_every_gyro_from_the_start_and_from_later() {
    for onset_s in [None, Some(5200.0)] {
        let single = ["sign-inversion", "stuck-output"];
        let single = single.iter().flat_map(|code| GYROS.map(|gyro| wired(code, &[gyro], onset_s)));
        for hidden in single.chain(PAIRS.map(|pair| wired("axis-swap", &pair, onset_s))) {
            let recording = Recording::hiding(9, std::slice::from_ref(&hidden));
            let checked = recording.checked();
            println!("{hidden:?}: {:?}", checked.faults);
            assert_named(&checked, &hidden, onset_s);
            // What was put right is in order.
            let again = Recording { rows: checked.rows, ..recording }.checked();
            assert!(again.faults.is_empty(), "{hidden:?}: {:?}", again.faults);
        }
    }
}

#[test]
fn rows_are_as_without_the_fault_and_what_is_stuck_is_marked() {
    let null = Recording::hiding(9, &[]).rows;
    for code in ["sign-inversion", "axis-swap"] {
        let gyros = if code == "axis-swap" { &[Of::X, Of::Zb][..] } else { &[Of::X] };
        let checked = Recording::hiding(9, &[wired(code, gyros, Some(5200.0))]).checked();
        let differ = checked.rows.iter().zip(&null).filter(|(row, null)| row.sample != null.sample).count();
        assert!(differ <= 4, "{code}: {differ} rows differ");
    }
    let checked = Recording::hiding(9, &[wired("stuck-output", &[Of::Y], Some(5200.0))]).checked();
    for (index, (row, null)) in checked.rows.iter().zip(&null).enumerate() {
        let is_stuck = index >= 10_400;
        // A gyro may have stood still before it stuck.
        if !(10_390..10_400).contains(&index) {
            assert_eq!(row.sample.gyro_flags, if is_stuck { 0x0D } else { 0x0F }, "{index}");
        }
        assert!(is_stuck || row.sample.increments == null.sample.increments);
    }
}

#[test]
fn faults_beside_large_ordinary_effects_and_beside_each_other_are_named() {
    let ordinary = [
        PlantedEffect::new("scale-factor", &GYROS, &[("ppm", 2000.0)]),
        PlantedEffect::new("drift", &GYROS, &[("arcsec_per_h", 100.0)]),
        PlantedEffect::new("pivot-clearance", &GYROS, &[("clearance_arcsec", 12.0)]),
    ];
    for (seed, faults) in [
        (11, vec![wired("sign-inversion", &[Of::X], Some(4000.0))]),
        (12, vec![wired("stuck-output", &[Of::Za], Some(4000.0))]),
        (13, vec![wired("axis-swap", &[Of::X, Of::Y], None), wired("stuck-output", &[Of::Zb], Some(6000.0))]),
        (14, vec![wired("sign-inversion", &[Of::Y], None), wired("sign-inversion", &[Of::Za], Some(6000.0))]),
    ] {
        let checked = Recording::hiding(seed, &[&ordinary[..], &faults].concat()).checked();
        let named: Vec<(String, &str)> =
            checked.faults.iter().map(|fault| (fault.code(), fault.gyros[0].name())).collect();
        let hidden: Vec<(String, &str)> =
            faults.iter().map(|hidden| (hidden.code.clone(), hidden.gyros[0].name())).collect();
        assert_eq!(named, hidden, "{:?}", checked.faults);
    }
}

#[test]
fn a_fault_that_ends_is_told_with_its_end() {
    let mut recording = Recording::hiding(9, &[]);
    for row in &mut recording.rows[6000..12_000] {
        row.sample.increments[0] = -row.sample.increments[0];
    }
    let checked = recording.checked();
    let [fault @ WiringFault { onset_s: Some(onset_s), end_s: Some(end_s), .. }] = &checked.faults[..] else {
        panic!("{:?}", checked.faults)
    };
    assert_eq!(fault.code(), "sign-inversion-step");
    assert!((onset_s - 3000.0).abs() < 2.0 && (end_s - 6000.0).abs() < 2.0, "{onset_s} to {end_s} s");
}

#[test]
fn wiring_that_the_configuration_has_is_no_fault() {
    for (hidden, believed) in [
        (wired("sign-inversion", &[Of::X], None), "gyro.GYRX.sign-inversion.on=true"),
        (wired("axis-swap", &[Of::Y, Of::Za], None), "gyro.GYRY.axis-swap.with=\"GYRZA\""),
    ] {
        let recording = Recording::hiding(9, std::slice::from_ref(&hidden));
        let configuration = Configuration::reference_with(&[believed.to_owned()]).expect("valid");
        let checked = check(&recording.rows, &[], &configuration, &recording.reference);
        assert!(checked.findings.is_empty() && checked.rows == recording.rows, "{hidden:?}: {:?}", checked.findings);
    }
}

#[test]
fn ordinary_effects_however_large_are_no_finding() {
    let each = |code: &str, number: &str, sizes: [f64; 4]| -> Vec<PlantedEffect> {
        GYROS.iter().zip(sizes).map(|(gyro, size)| PlantedEffect::new(code, &[*gyro], &[(number, size)])).collect()
    };
    for (seed, hidden) in [
        vec![],
        each("pivot-clearance", "clearance_arcsec", [12.0; 4]),
        each("scale-factor", "ppm", [2000.0; 4]),
        // What exchanges the scale factors of GYRZA and GYRZB is not yet their exchange.
        each("scale-factor", "ppm", [0.0, 0.0, -1300.0, 1300.0]),
        each("scale-factor", "ppm", [50_000.0, -50_000.0, 50_000.0, -50_000.0]),
        each("drift", "arcsec_per_h", [100.0; 4]),
        each("drift", "arcsec_per_h", [6000.0, -6000.0, 6000.0, -6000.0]),
        each("misalignment", "z_arcsec", [3600.0, -3600.0, 0.0, 0.0]),
        each("angle-random-walk", "arcsec_per_sqrt_s", [3.0; 4]),
        each("lost-counts", "counts", [1e6, -3000.0, 500.0, 20.0]),
        vec![PlantedEffect::new("time-offset", &[], &[("seconds", 0.4)])],
        // A gyro that rests within its play repeats its count, and is not stuck.
        each("count-backlash", "play_arcsec", [8.0; 4]),
        each("count-backlash", "play_arcsec", [100.0; 4]),
    ]
    .into_iter()
    .enumerate()
    {
        let checked = Recording::hiding(20 + seed as u64, &hidden).checked();
        assert!(checked.faults.is_empty(), "{hidden:?}: {:?}", checked.faults);
        let lost = hidden.iter().any(|hidden| hidden.code == "lost-counts");
        // A million counts in one sample interval are clipped.
        assert_eq!(kinds(&checked), if lost { vec!["saturated"] } else { vec![] }, "{hidden:?}");
    }
}

#[test]
fn a_gyro_at_rest_is_not_called_anything() {
    let recording = short();
    let still = |rates: &str| format!("t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s\n{rates}");
    let first = recording.reference.start_ns / 1_000_000_000;
    let rows: String = (1..=800).map(|row| format!("{}.{},0,0,0\n", first + row / 2, row % 2 * 5)).collect();
    let reference = ReferenceAttitude::parse("reference.csv", &still(&rows)).expect("a reference");
    let mut rows = recording.rows;
    rows.iter_mut().for_each(|row| row.sample.increments = [0; 4]);
    let checked = check(&rows, &[], &Configuration::reference(), &reference);
    assert!(checked.findings.is_empty(), "{:?}", checked.findings);
}

#[test]
fn counts_in_another_unit_are_told_with_their_factor() {
    let recording = Recording::hiding(5, &[]);
    for (factor, name) in
        [(10.0, "0.1 arcsec"), (1.0 / 60.0, "arcmin"), (1.0 / 3600.0, "degrees"), (2.0, "counts per second")]
    {
        let (mut rows, mut angle) = (recording.rows.clone(), [0.0; 4]);
        for row in &mut rows {
            for (count, angle) in row.sample.increments.iter_mut().zip(&mut angle) {
                let before = f64::round(*angle);
                *angle += f64::from(*count) * factor;
                *count = (angle.round() - before) as i16;
            }
        }
        let checked = check(&rows, &[], &Configuration::reference(), &recording.reference);
        println!("{factor}: {:?}", checked.findings);
        let told = told(&checked, "unit-factor");
        assert!(told.len() >= 2 && told.iter().all(|(_, text)| text.contains(name)), "{:?}", checked.findings);
        assert!(checked.faults.is_empty(), "{:?}", checked.faults);
    }
}

#[test]
fn what_is_wrong_with_the_link_is_told_with_its_place() {
    let mut recording = short();
    let rows = &mut recording.rows;
    let valid = |row: &mut ReceivedSample, gyro: Gyro| row.sample.gyro_flags &= !gyro.bit();
    rows[100..110].iter_mut().for_each(|row| valid(row, Gyro::Y));
    rows[120].sample.increments[0] = i16::MAX;
    rows[130].sample.increments[1] = i16::MIN;
    rows[130].sample.gyro_flags |= Gyro::Y.bit() << 4;
    rows[140].sample.gyro_flags |= Gyro::Za.bit() << 4;
    rows[150..160].iter_mut().for_each(|row| row.sample.unit_flags |= unit_flag("self_test"));
    rows[170].sample.unit_flags &= !unit_flag("motors_synchronous");
    rows[180..200].iter_mut().for_each(|row| row.sample.unit_flags &= !unit_flag("heater_in_band"));
    rows[210].sample.sensor_centi_c = 6500;
    rows[220].sample.electronics_centi_c += 500;
    rows[230].sample.unit_flags &= !unit_flag("clock_locked");
    let mut again = rows[400];
    again.sample.increments[2] += 1;
    rows.insert(401, again);
    rows.insert(301, rows[300]);
    rows.drain(250..253);
    let checked = recording.checked();
    for (kind, place, text) in [
        ("invalid", "GYRY, 50.0–55.0 s", "10 samples"),
        ("clipped", "GYRX, 60.0–60.5 s", "1 samples"),
        ("saturated", "GYRY, 65.0–65.5 s", "1 samples"),
        ("saturated-inside", "GYRZA, 70.0–70.5 s", "1 samples"),
        ("self-test", "75.0–80.0 s", "10 samples"),
        ("synchronous-flag", "85.0–85.5 s", "1 samples"),
        ("heater", "90.0–100.0 s", "20 samples"),
        ("heater-flag", "105.0–105.5 s", "1 samples"),
        ("sensor-temperature-jump", "105.0–106.0 s", "2 jumps"),
        ("electronics-temperature-jump", "110.0–111.0 s", "2 jumps"),
        ("clock-unlocked", "115.0–115.5 s", "1 samples"),
        ("gap", "126.5–127.0 s", "3 samples are missing"),
        ("repeat", "150.0–150.5 s", "1 samples came again"),
        ("repeat-differs", "200.0–200.5 s", "1 samples"),
    ] {
        let told = told(&checked, kind);
        assert!(told.len() == 1 && told[0].0 == place && told[0].1.starts_with(text), "{kind}: {told:?}");
    }
    assert_eq!(checked.findings.len(), 14, "{:?}", checked.findings);
    assert!(checked.faults.is_empty() && checked.rows.len() == recording.rows.len());
    assert_ne!(checked.rows[120].sample.gyro_flags & Gyro::X.bit() << 4, 0);
}

#[test]
fn many_runs_of_one_thing_are_one_finding() {
    let mut recording = Recording::hiding(5, &[]);
    recording.rows.iter_mut().step_by(500).for_each(|row| row.sample.gyro_flags = 0x0E);
    let checked = recording.checked();
    assert_eq!(told(&checked, "invalid").len(), 1, "{:?}", checked.findings);
    assert!(checked.findings[0].text.contains("44 samples") && checked.findings[0].text.contains("44 runs"));
}

#[test]
fn times_that_jump_stray_or_run_back_are_told_and_sequences_that_restart() {
    let shifted = |from: usize, to: usize, by_s: f64| {
        let mut recording = short();
        for row in &mut recording.rows[from..to] {
            let time = row.time.expect("a time");
            row.time = Some(Timestamp { t_ns: time.t_ns + (by_s * 1e9) as i64, ..time });
        }
        recording.checked()
    };
    for (by_s, text) in [(7.0, "+7.000 s"), (-0.3, "-0.300 s"), (-7.0, "-7.000 s")] {
        let checked = shifted(300, 800, by_s);
        let told = told(&checked, "time-jump");
        assert!(told.len() == 1 && told[0].1.ends_with(text), "{:?}", checked.findings);
        assert_eq!(kinds(&checked).contains(&"time-backwards"), by_s < -0.5);
        assert!(!kinds(&checked).contains(&"clock-frequency"), "{:?}", checked.findings);
    }
    let checked = shifted(300, 301, 0.2);
    assert_eq!(told(&checked, "interval").len(), 1);
    assert_eq!(kinds(&checked), ["interval"], "{:?}", checked.findings);

    let mut slow = short();
    let first = slow.rows[0].time.expect("a time").t_ns;
    for row in &mut slow.rows {
        let time = row.time.expect("a time");
        row.time = Some(Timestamp { t_ns: first + 2 * (time.t_ns - first), ..time });
    }
    let checked = slow.checked();
    assert!(told(&checked, "interval")[0].1.contains("every 1.0000 s"), "{:?}", checked.findings);

    for (clock, kind) in [(0, "reset"), (123_456_789, "sequence-jump")] {
        let mut recording = short();
        for (index, row) in recording.rows[400..].iter_mut().enumerate() {
            row.sample.sequence = index as u16;
            row.sample.clock_count = clock + 500_000 * (index as u64 + 1);
        }
        let checked = recording.checked();
        assert_eq!(kinds(&checked), [kind], "{:?}", checked.findings);
        assert_eq!(checked.findings[0].place, "200.0–200.5 s");
    }
}

#[test]
fn a_clock_is_measured_and_only_told_where_the_configuration_has_another() {
    let hidden = PlantedEffect::new("clock-frequency", &[], &[("ppm", 14.0)]);
    let recording = Recording::hiding(6, &[hidden]);
    let checked = recording.checked();
    let [(_, text)] = told(&checked, "clock-frequency")[..] else { panic!("{:?}", checked.findings) };
    assert!(text.contains("fast by 14.00") || text.contains("fast by 13.99"), "{text}");
    let believed = Configuration::reference_with(&["unit.clock-frequency.ppm=14.0".to_owned()]).expect("valid");
    let checked = check(&recording.rows, &[], &believed, &recording.reference);
    assert!(checked.findings.is_empty(), "{:?}", checked.findings);
}

#[test]
fn a_reference_of_another_time_is_told() {
    let recording = short();
    for (by_s, kinds_told) in [(-100, vec!["reference-short"]), (100_000, vec!["reference-apart"])] {
        let mut reference = recording.reference.clone();
        reference.start_ns += by_s * 1_000_000_000;
        let checked = check(&recording.rows, &[], &Configuration::reference(), &reference);
        let kinds: Vec<&str> = kinds(&checked).into_iter().filter(|kind| kind.starts_with("reference")).collect();
        assert_eq!(kinds, kinds_told, "{:?}", checked.findings);
    }
}

#[test]
fn what_the_decoder_found_wrong_is_told_once_for_each_kind() {
    let recording = short();
    let defect = |kind, line| Defect {
        input: "link.log",
        place: RecordPosition::Line(line),
        kind,
        bytes: &[],
        time: None,
        lost: 0,
    };
    let defects = [
        defect(DefectKind::BrokenRecord, 17),
        defect(DefectKind::BrokenRecord, 19),
        defect(DefectKind::SequenceGap, 20),
        Defect { lost: 5, ..defect(DefectKind::ReceiverDropped, 30) },
    ];
    let checked = check(&recording.rows, &defects, &Configuration::reference(), &recording.reference);
    assert_eq!(kinds(&checked), ["broken-record", "receiver-dropped"]);
    assert_eq!(checked.findings[0].place, "link.log:17");
    assert!(checked.findings[0].text.starts_with("2 ") && checked.findings[1].text.contains("5 lost"));
}

/// A generator of numbers that is the same everywhere.
fn numbers(mut state: u64) -> impl FnMut() -> u64 {
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        state >> 16
    }
}

#[test]
fn nothing_panics_on_rows_of_any_kind() {
    let recording = short();
    for seed in 0..200 {
        let mut next = numbers(seed);
        let mut rows = recording.rows.clone();
        rows.truncate((next() % 801) as usize * usize::from(seed > 0) / if seed % 3 == 0 { 1 } else { 100 });
        for row in &mut rows {
            let what = next() % 40;
            let word = next();
            let sample = &mut row.sample;
            match what {
                0 => sample.sequence = word as u16,
                1 => sample.clock_count = word % (1 << 48),
                2 => sample.increments[(word % 4) as usize] = (word >> 8) as i16,
                3 => sample.gyro_flags = word as u8,
                4 => sample.unit_flags = word as u8,
                5 => row.time = None,
                6 => {
                    row.time =
                        Some(Timestamp { t_ns: [i64::MIN, i64::MAX, word as i64][(word % 3) as usize], digits: 9 })
                }
                7 => row.has_clock = false,
                8 => row.is_received = false,
                9 => (sample.electronics_centi_c, sample.sensor_centi_c) = (word as i16, (word >> 9) as i16),
                _ => {}
            }
        }
        let checked = check(&rows, &[], &Configuration::reference(), &recording.reference);
        assert_eq!(checked.rows.len(), rows.len(), "seed {seed}");
        assert!(checked.findings.iter().all(|finding| !finding.text.contains("NaN")), "{seed}: {:?}", checked.findings);
    }
}

#[test]
fn measured_recordings_show_nothing_but_a_clock() {
    let recordings = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/recordings");
    if !recordings.exists() {
        // Not eprintln!, which the test harness keeps to itself when a test passes.
        let _ = writeln!(std::io::stderr(), "skipped: {} is not there", recordings.display());
        return;
    }
    for name in 1..=10 {
        let directory = recordings.join(format!("{name:02}"));
        let path = |file: &str| directory.join(file).to_string_lossy().into_owned();
        let (mut reader, mut rows) = (InputReader::new(DecoderOptions::default(), Stop::default()), Rows::default());
        reader.read(&path("link.log.gz"), &mut rows).expect("a recording");
        reader.finish(&mut rows).1.expect("a recording");
        let reference = ReferenceAttitude::read(&path("reference.csv.gz")).expect("a reference");
        let checked = Recording { rows: rows.0, reference }.checked();
        println!("{name:02}: {:?}", checked.findings);
        assert!(checked.faults.is_empty(), "{name}: {:?}", checked.faults);
        let expected: &[&str] = if name == 4 { &["clock-frequency"] } else { &[] };
        assert_eq!(kinds(&checked), expected, "{name}: {:?}", checked.findings);
        assert!(
            name != 4 || checked.findings[0].text.contains("fast by 13.9999 ± 0.0002 ppm"),
            "{:?}",
            checked.findings
        );
    }
}

#[test]
fn a_day_is_checked_within_seconds() {
    let recording = Recording::of(&IndependentModel { duration_s: 86_400.0, ..IndependentModel::new(7, Vec::new()) });
    let start = std::time::Instant::now();
    let checked = recording.checked();
    let took_s = start.elapsed().as_secs_f64();
    println!("{took_s:.2} s");
    assert!(checked.findings.is_empty(), "{:?}", checked.findings);
    // 2 s on a core of its own; tests share theirs.
    assert!(took_s < 10.0, "{took_s:.2} s");
}
