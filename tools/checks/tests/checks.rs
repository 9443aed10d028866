//! The exact checks find each kind of defect with its place, and report no ordinary effect, however large.

use std::io::Write;
use std::path::Path;
use std::thread;

use geu_checks::{CheckResult, WiringFault, check};
use geu_model::Configuration;
use geu_plant::{GYROS, Gyro as Of, IndependentModel, PlantedEffect};
use geu_protocol::Gyro;
use geu_protocol::capture::{Format, RecordPosition, Timestamp};
use geu_protocol::field::unit_flag;
use geu_recording::{
    Decode, Decoder, DecoderOptions, Defect, DefectKind, InputReader, ReceivedSample, ReferenceAttitude, Sink, Stop,
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
    fn new(model: &IndependentModel) -> Recording {
        let recording = model.record();
        let (mut decoder, mut rows) = (Decoder::new(&DecoderOptions::default()), Rows::default());
        decoder.begin("link.log", &mut rows);
        let mut reader = Format::from_name("candump").expect("a format").reader().expect("a reader");
        reader
            .read(recording.link.as_bytes(), true, &mut |position, record| decoder.event(position, &record, &mut rows));
        decoder.count_records(reader.records());
        decoder.finish(&mut rows);
        let reference = ReferenceAttitude::parse("reference.csv", &recording.reference).expect("a reference");
        Recording { rows: rows.0, reference }
    }

    fn with(seed: u64, effects: &[PlantedEffect]) -> Recording {
        Recording::new(&IndependentModel::new(seed, effects.to_vec()))
    }

    fn checked(&self) -> CheckResult {
        check(&self.rows, &[], &Configuration::reference(), &self.reference)
    }
}

/// 400 s of the independent model without effects.
fn short() -> Recording {
    Recording::new(&IndependentModel { duration_s: 400.0, ..IndependentModel::new(3, Vec::new()) })
}

fn kinds(checked: &CheckResult) -> Vec<&str> {
    checked.findings.iter().map(|finding| finding.kind.as_str()).collect()
}

/// Place and text of the findings of a kind.
fn findings<'a>(checked: &'a CheckResult, kind: &str) -> Vec<(&'a str, &'a str)> {
    let of_kind = checked.findings.iter().filter(|finding| finding.kind == kind);
    of_kind.map(|finding| (finding.place.as_str(), finding.text.as_str())).collect()
}

fn wired(code: &str, gyros: &[Of], onset_s: Option<f64>) -> PlantedEffect {
    let on = [("on", 1.0), ("time_s", onset_s.unwrap_or(0.0))];
    let code = if onset_s.is_some() { format!("{code}-step") } else { code.to_owned() };
    PlantedEffect::new(&code, gyros, &on[..1 + usize::from(onset_s.is_some())])
}

/// Asserts that exactly this fault was found, with an interval that contains its onset.
fn assert_found(checked: &CheckResult, planted: &PlantedEffect, onset_s: Option<f64>) {
    let [fault @ WiringFault { gyros, onset_s: found_s, onset_between_s: [from_s, to_s], end_s, .. }] =
        &checked.faults[..]
    else {
        panic!("{planted:?}: {:?}", checked.faults);
    };
    let planted_gyros: Vec<&str> = planted.gyros.iter().map(|gyro| gyro.name()).collect();
    let found_gyros: Vec<&str> = gyros.iter().map(|gyro| gyro.name()).collect();
    assert_eq!((fault.code().as_str(), found_gyros, *end_s), (planted.code.as_str(), planted_gyros, None));
    assert_eq!(found_s.is_some(), onset_s.is_some(), "{planted:?}");
    if let Some(onset_s) = onset_s {
        assert!((from_s - 2.0..=to_s + 2.0).contains(&onset_s), "{planted:?}: {from_s} to {to_s} s");
    }
    assert_eq!(kinds(checked), [fault.code()], "{planted:?}");
}

const PAIRS: [[Of; 2]; 6] =
    [[Of::X, Of::Y], [Of::X, Of::Za], [Of::X, Of::Zb], [Of::Y, Of::Za], [Of::Y, Of::Zb], [Of::Za, Of::Zb]];

#[test]
fn wiring_faults_are_found_on_every_gyro_with_and_without_onset() {
    thread::scope(|scope| {
        for onset_s in [None, Some(5200.0)] {
            scope.spawn(move || wiring_faults_are_found(onset_s));
        }
    });
}

fn wiring_faults_are_found(onset_s: Option<f64>) {
    let single = ["sign-inversion", "stuck-output"];
    let single = single.iter().flat_map(|code| GYROS.map(|gyro| wired(code, &[gyro], onset_s)));
    for planted in single.chain(PAIRS.map(|pair| wired("axis-swap", &pair, onset_s))) {
        let recording = Recording::with(9, std::slice::from_ref(&planted));
        let checked = recording.checked();
        println!("{planted:?}: {:?}", checked.faults);
        assert_found(&checked, &planted, onset_s);
        // The corrected rows have no fault.
        let again = Recording { rows: checked.rows, ..recording }.checked();
        assert!(again.faults.is_empty(), "{planted:?}: {:?}", again.faults);
    }
}

#[test]
fn rows_are_corrected_and_stuck_outputs_are_marked() {
    let null = Recording::with(9, &[]).rows;
    for code in ["sign-inversion", "axis-swap"] {
        let gyros = if code == "axis-swap" { &[Of::X, Of::Zb][..] } else { &[Of::X] };
        let checked = Recording::with(9, &[wired(code, gyros, Some(5200.0))]).checked();
        let differ = checked.rows.iter().zip(&null).filter(|(row, null)| row.sample != null.sample).count();
        assert!(differ <= 4, "{code}: {differ} rows differ");
    }
    let checked = Recording::with(9, &[wired("stuck-output", &[Of::Y], Some(5200.0))]).checked();
    for (index, (row, null)) in checked.rows.iter().zip(&null).enumerate() {
        let is_stuck = index >= 10_400;
        // A gyro may have been at rest before it stuck.
        if !(10_390..10_400).contains(&index) {
            assert_eq!(row.sample.gyro_flags, if is_stuck { 0x0D } else { 0x0F }, "{index}");
        }
        assert!(is_stuck || row.sample.increments == null.sample.increments);
    }
}

#[test]
fn faults_are_found_with_large_ordinary_effects_and_other_faults() {
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
        let checked = Recording::with(seed, &[&ordinary[..], &faults].concat()).checked();
        let found: Vec<(String, &str)> =
            checked.faults.iter().map(|fault| (fault.code(), fault.gyros[0].name())).collect();
        let planted: Vec<(String, &str)> =
            faults.iter().map(|planted| (planted.code.clone(), planted.gyros[0].name())).collect();
        assert_eq!(found, planted, "{:?}", checked.faults);
    }
}

#[test]
fn end_of_a_fault_is_found() {
    let mut recording = Recording::with(9, &[]);
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
fn configured_wiring_is_no_fault() {
    for (planted, configured) in [
        (wired("sign-inversion", &[Of::X], None), "gyro.GYRX.sign-inversion.on=true"),
        (wired("axis-swap", &[Of::Y, Of::Za], None), "gyro.GYRY.axis-swap.with=\"GYRZA\""),
    ] {
        let recording = Recording::with(9, std::slice::from_ref(&planted));
        let configuration = Configuration::reference_with(&[configured.to_owned()]).expect("valid");
        let checked = check(&recording.rows, &[], &configuration, &recording.reference);
        assert!(checked.findings.is_empty() && checked.rows == recording.rows, "{planted:?}: {:?}", checked.findings);
    }
}

#[test]
fn large_ordinary_effects_are_no_finding() {
    let each = |code: &str, number: &str, sizes: [f64; 4]| -> Vec<PlantedEffect> {
        GYROS.iter().zip(sizes).map(|(gyro, size)| PlantedEffect::new(code, &[*gyro], &[(number, size)])).collect()
    };
    for (seed, planted) in [
        vec![],
        each("pivot-clearance", "clearance_arcsec", [12.0; 4]),
        each("scale-factor", "ppm", [2000.0; 4]),
        // Exchanged scale factors of GYRZA and GYRZB are no exchange of the gyros.
        each("scale-factor", "ppm", [0.0, 0.0, -1300.0, 1300.0]),
        each("scale-factor", "ppm", [50_000.0, -50_000.0, 50_000.0, -50_000.0]),
        each("drift", "arcsec_per_h", [100.0; 4]),
        each("drift", "arcsec_per_h", [6000.0, -6000.0, 6000.0, -6000.0]),
        each("misalignment", "z_arcsec", [3600.0, -3600.0, 0.0, 0.0]),
        each("angle-random-walk", "arcsec_per_sqrt_s", [3.0; 4]),
        each("lost-counts", "counts", [1e6, -3000.0, 500.0, 20.0]),
        vec![PlantedEffect::new("time-offset", &[], &[("seconds", 0.4)])],
        // A gyro at rest within its play repeats its count without being stuck.
        each("count-backlash", "play_arcsec", [8.0; 4]),
        each("count-backlash", "play_arcsec", [100.0; 4]),
    ]
    .into_iter()
    .enumerate()
    {
        let checked = Recording::with(20 + seed as u64, &planted).checked();
        assert!(checked.faults.is_empty(), "{planted:?}: {:?}", checked.faults);
        let lost = planted.iter().any(|planted| planted.code == "lost-counts");
        // A million counts in one sample interval are clipped.
        assert_eq!(kinds(&checked), if lost { vec!["saturated"] } else { vec![] }, "{planted:?}");
    }
}

#[test]
fn gyro_at_rest_is_no_finding() {
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
fn counts_in_another_unit_are_reported_with_their_factor() {
    let recording = Recording::with(5, &[]);
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
        let found = findings(&checked, "unit-factor");
        assert!(found.len() >= 2 && found.iter().all(|(_, text)| text.contains(name)), "{:?}", checked.findings);
        assert!(checked.faults.is_empty(), "{:?}", checked.faults);
        assert!(checked.mismatch.is_some_and(|why| why.contains(name)));
    }
}

#[test]
fn a_reference_of_opposite_sign_is_no_wiring_of_all_gyros() {
    let (recording, unit) = (Recording::with(5, &[]), Configuration::reference());
    let inverted = |gyros: &[usize]| {
        let mut rows = recording.rows.clone();
        let all = rows.iter_mut().flat_map(|row| row.sample.increments.iter_mut().enumerate());
        all.filter(|(gyro, _)| gyros.contains(gyro)).for_each(|(_, count)| *count = -*count);
        check(&rows, &[], &unit, &recording.reference)
    };
    let all = inverted(&[0, 1, 2, 3]);
    assert!(all.faults.is_empty(), "{:?}", all.faults);
    assert!(all.mismatch.is_some_and(|why| why.contains("GYRX, GYRY, GYRZA, GYRZB turn against it")));
    // A gyro that stands still says nothing.
    let mut rows = recording.rows.clone();
    for row in &mut rows {
        row.sample.increments = row.sample.increments.map(|count| -count);
        row.sample.increments[3] = 0;
    }
    assert!(
        check(&rows, &[], &unit, &recording.reference)
            .mismatch
            .is_some_and(|why| why.contains("GYRX, GYRY, GYRZA turn"))
    );
    // One gyro that follows the motion shows that the others are inverted.
    let three = inverted(&[0, 1, 2]);
    assert_eq!((three.faults.len(), three.mismatch), (3, None));
}

#[test]
fn link_defects_are_reported_with_their_place() {
    let mut recording = short();
    let rows = &mut recording.rows;
    let valid = |row: &mut ReceivedSample, gyro: Gyro| row.sample.gyro_flags &= !gyro.bit();
    rows[100..110].iter_mut().for_each(|row| valid(row, Gyro::Y));
    rows[120].sample.increments[0] = i16::MAX;
    rows[130].sample.increments[1] = i16::MIN;
    rows[130].sample.gyro_flags |= Gyro::Y.bit() << 4;
    rows[140].sample.gyro_flags |= Gyro::ZA.bit() << 4;
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
        let found = findings(&checked, kind);
        assert!(found.len() == 1 && found[0].0 == place && found[0].1.starts_with(text), "{kind}: {found:?}");
    }
    assert_eq!(checked.findings.len(), 14, "{:?}", checked.findings);
    assert!(checked.faults.is_empty() && checked.rows.len() == recording.rows.len());
    assert_ne!(checked.rows[120].sample.gyro_flags & Gyro::X.bit() << 4, 0);
}

#[test]
fn many_runs_of_one_kind_are_one_finding() {
    let mut recording = Recording::with(5, &[]);
    recording.rows.iter_mut().step_by(500).for_each(|row| row.sample.gyro_flags = 0x0E);
    let checked = recording.checked();
    assert_eq!(findings(&checked, "invalid").len(), 1, "{:?}", checked.findings);
    assert!(checked.findings[0].text.contains("44 samples") && checked.findings[0].text.contains("44 runs"));
}

#[test]
fn time_jumps_outliers_and_sequence_restarts_are_reported() {
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
        let found = findings(&checked, "time-jump");
        assert!(found.len() == 1 && found[0].1.ends_with(text), "{:?}", checked.findings);
        assert_eq!(kinds(&checked).contains(&"time-backwards"), by_s < -0.5);
        assert!(!kinds(&checked).contains(&"clock-frequency"), "{:?}", checked.findings);
    }
    let checked = shifted(300, 301, 0.2);
    assert_eq!(findings(&checked, "interval").len(), 1);
    assert_eq!(kinds(&checked), ["interval"], "{:?}", checked.findings);

    let mut slow = short();
    let first = slow.rows[0].time.expect("a time").t_ns;
    for row in &mut slow.rows {
        let time = row.time.expect("a time");
        row.time = Some(Timestamp { t_ns: first + 2 * (time.t_ns - first), ..time });
    }
    let checked = slow.checked();
    assert!(findings(&checked, "interval")[0].1.contains("every 1.0000 s"), "{:?}", checked.findings);

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
fn clock_frequency_is_reported_if_the_configuration_differs() {
    let planted = PlantedEffect::new("clock-frequency", &[], &[("ppm", 14.0)]);
    let recording = Recording::with(6, &[planted]);
    let checked = recording.checked();
    let [(_, text)] = findings(&checked, "clock-frequency")[..] else { panic!("{:?}", checked.findings) };
    assert!(text.contains("fast by 14.00") || text.contains("fast by 13.99"), "{text}");
    let configured = Configuration::reference_with(&["unit.clock-frequency.ppm=14.0".to_owned()]).expect("valid");
    let checked = check(&recording.rows, &[], &configured, &recording.reference);
    assert!(checked.findings.is_empty(), "{:?}", checked.findings);
}

#[test]
fn reference_of_another_time_is_reported() {
    let recording = short();
    for (by_s, expected) in [(-100, vec!["reference-short"]), (100_000, vec!["reference-apart"])] {
        let mut reference = recording.reference.clone();
        reference.start_ns += by_s * 1_000_000_000;
        let checked = check(&recording.rows, &[], &Configuration::reference(), &reference);
        let kinds: Vec<&str> = kinds(&checked).into_iter().filter(|kind| kind.starts_with("reference")).collect();
        assert_eq!(kinds, expected, "{:?}", checked.findings);
    }
}

#[test]
fn decoder_defects_are_one_finding_for_each_kind() {
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

/// A generator of numbers that does not depend on the platform.
fn numbers(mut state: u64) -> impl FnMut() -> u64 {
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        state >> 16
    }
}

#[test]
fn checks_do_not_panic_on_any_rows() {
    let recording = short();
    for seed in 0..200 {
        let mut next = numbers(seed);
        let mut rows = recording.rows.clone();
        rows.truncate((next() % 801) as usize * usize::from(seed > 0) / if seed % 3 == 0 { 1 } else { 100 });
        for row in &mut rows {
            let field = next() % 40;
            let word = next();
            let sample = &mut row.sample;
            match field {
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
fn measured_recordings_have_no_finding_but_the_clock() {
    let recordings = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/recordings");
    if !recordings.exists() {
        // The test harness does not show eprintln! output of a passed test.
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
    let recording = Recording::new(&IndependentModel { duration_s: 86_400.0, ..IndependentModel::new(7, Vec::new()) });
    let start = std::time::Instant::now();
    let checked = recording.checked();
    let took_s = start.elapsed().as_secs_f64();
    println!("{took_s:.2} s");
    assert!(checked.findings.is_empty(), "{:?}", checked.findings);
    // 2 s on one core; tests share theirs.
    assert!(took_s < 10.0, "{took_s:.2} s");
}
