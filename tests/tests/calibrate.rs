//! `geu calibrate`: the recovered parameters for each kind of input, and the handling of defective recordings and lists.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::OnceLock;

use geu_calibration::transfer::misalignment_matrix;
use geu_calibration::{CountsReader, PriorCalibration};
use geu_model::Configuration;
use geu_model::package::Calibration;
use geu_recording::{DecoderOptions, InputReader, ReferenceAttitude, Stop};
use geu_tests::{geu, recordings, root};
use nalgebra::{UnitQuaternion, Vector3};
use tempfile::TempDir;

/// Four hours of the default scenario up to the survey, with pointing, scans about Y, Z and X; shared by all tests.
fn recording() -> &'static Path {
    static RECORDING: OnceLock<TempDir> = OnceLock::new();
    RECORDING
        .get_or_init(|| {
            let temp_dir = tempfile::tempdir().expect("a directory");
            for (wire, name) in [("can", "can"), ("serial", "serial")] {
                let out = temp_dir.path().join(name);
                let start = if wire == "can" { "1800000000" } else { "0" };
                run(&["simulate", "--wire", wire, "--start", start, "--duration", "14000", "--out", text(&out)]);
            }
            temp_dir
        })
        .path()
}

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

fn output(arguments: &[&str]) -> Output {
    geu().args(arguments).output().expect("geu starts")
}

fn run(arguments: &[&str]) -> (String, String) {
    let output = output(arguments);
    let [out, error] = [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    assert!(output.status.success(), "{arguments:?}: {error}");
    (out, error)
}

fn refused(arguments: &[&str]) -> String {
    let output = output(arguments);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}");
    assert!(output.stdout.is_empty());
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A file beside the recording's, written anew from one of them.
fn edited(temp_dir: &TempDir, name: &str, edit: impl Fn(&str) -> String) -> PathBuf {
    edited_file(temp_dir, &recording().join("can").join(name), edit)
}

fn edited_file(temp_dir: &TempDir, source: &Path, edit: impl Fn(&str) -> String) -> PathBuf {
    let path = temp_dir.path().join(source.file_name().expect("a file"));
    fs::write(&path, edit(&fs::read_to_string(source).expect("recorded"))).expect("writable");
    path
}

fn in_can(name: &str) -> String {
    text(&recording().join("can").join(name)).to_owned()
}

/// Arguments of `geu calibrate` with a list and a reference.
fn arguments<'a>(link: &'a str, manoeuvres: &'a str, reference: &'a str) -> Vec<&'a str> {
    vec!["calibrate", "--link", link, "--manoeuvres", manoeuvres, "--reference", reference]
}

fn solved(json: &Path) -> ([Calibration; 4], [f64; 16]) {
    let text = fs::read_to_string(json).expect("written");
    let prior = PriorCalibration::parse("result.json", &text, &[]).expect("a calibration");
    (prior.calibrations, geu_calibration::solve::values(&prior.sigmas))
}

#[test]
fn can_and_serial_with_reference_or_sensors_recover_the_unit_and_update_a_configuration() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    let truth = geu_calibration::solve::values(&Configuration::reference().calibrations());
    for wire in ["can", "serial"] {
        let directory = recording().join(wire);
        let file = |name: &str| text(&directory.join(name)).to_owned();
        let (link, manoeuvres) = (file(if wire == "can" { "link.log" } else { "link.bin" }), file("manoeuvres.csv"));
        let attitudes = [
            vec!["--reference".to_owned(), file("reference.csv")],
            vec!["--fss".to_owned(), file("fss.csv"), "--sse".to_owned(), file("sse.csv")],
        ];
        for attitude in attitudes {
            let (json, out) = (temp_dir.path().join("result.json"), temp_dir.path().join("unit.toml"));
            let mut arguments = vec!["calibrate", "--link", &link, "--manoeuvres", &manoeuvres];
            arguments.extend(attitude.iter().map(String::as_str));
            arguments.extend(["--json", text(&json), "--out", text(&out)]);
            let (table, _) = run(&arguments);
            assert!(table.contains("GYRZB misalignment y"), "{table}");
            let (calibrations, sigmas) = solved(&json);
            for ((value, sigma), truth) in geu_calibration::solve::values(&calibrations).iter().zip(sigmas).zip(truth) {
                assert!((value - truth).abs() < 4.5 * sigma && sigma > 0.0, "{attitude:?}: {value} ± {sigma}, {truth}");
            }
            // The configuration has the values to its digits, and every comment.
            let written = fs::read_to_string(&out).expect("written");
            let comments = |text: &str| text.lines().filter(|line| line.starts_with('#')).count();
            assert_eq!(comments(&written), comments(Configuration::reference_text()));
            let read = Configuration::parse("unit.toml", &written, &[]).expect("valid");
            assert!((read.gyros[0].calibration.scale_factor - calibrations[0].scale_factor).abs() < 1e-10);
            assert!((read.gyros[3].calibration.y_arcsec - calibrations[3].y_arcsec).abs() < 1e-4);
        }
    }
}

#[test]
fn a_recording_of_another_emulator_is_reproduced_to_the_end() {
    let Some(directory) = recordings("01") else { return };
    let temp_dir = tempfile::tempdir().expect("a directory");
    let (link, reference) = (directory.join("link.log.gz"), directory.join("reference.csv.gz"));
    let json = temp_dir.path().join("result.json");
    run(&["calibrate", "--link", text(&link), "--reference", text(&reference), "--json", text(&json)]);
    let (calibrations, _) = solved(&json);
    let (mut reader, mut counts) =
        (InputReader::new(DecoderOptions::default(), Stop::default()), CountsReader::default());
    reader.read(text(&link), &mut counts).expect("a recording");
    reader.finish(&mut counts).1.expect("a recording");
    let counts = counts.finish(0).expect("samples");
    let reference = ReferenceAttitude::read(text(&reference)).expect("a reference");
    let offset_s = (counts.start_ns - reference.start_ns) as f64 * 1e-9;
    let matrix = misalignment_matrix(&calibrations);
    let mut near = 0;
    let start = Vector3::from(reference.truth.at(offset_s, &mut near).0);
    for (node, node_s) in
        counts.node_s.iter().enumerate().filter(|(_, node_s)| **node_s + offset_s <= reference.truth.end_s())
    {
        let turned = Vector3::from(reference.truth.at(node_s + offset_s, &mut near).0) - start;
        for (gyro, Calibration { scale_factor, drift_arcsec_per_half_s, .. }) in calibrations.iter().enumerate() {
            let expected = ((matrix.row(gyro) * turned)[0] - drift_arcsec_per_half_s * node as f64) / scale_factor;
            let left = counts.accumulated[gyro][node] - expected;
            assert!(left.abs() < 3.2, "gyro {gyro} at {node_s} s: {left:.2} counts left");
        }
    }
}

#[test]
fn unusable_data_is_left_out_and_reported_with_its_time() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    let (manoeuvres, reference) = (in_can("manoeuvres.csv"), in_can("reference.csv"));
    let said = |link: &Path| run(&arguments(text(link), &manoeuvres, &reference)).1;
    // Samples end at 1800000000.5 and on; one is cut from the middle of the second scan about Y.
    let gap = edited(&temp_dir, "link.log", |log| {
        log.lines().filter(|line| !line.starts_with("(1800000800.5")).map(|line| format!("{line}\n")).collect()
    });
    let error = said(&gap);
    assert!(error.contains("left out: y-scan at 1800000770.0 s: 1 sample is missing at 1800000800.0 s"), "{error}");
    // The bus recorder's clock jumps by 10 s.
    let jump = edited(&temp_dir, "link.log", |log| {
        let late = |line: &str| match line.split_once('.') {
            Some((seconds, rest)) if seconds[1..].parse::<u64>().is_ok_and(|seconds| seconds > 1_800_010_000) => {
                format!("({}.{rest}\n", seconds[1..].parse::<u64>().expect("a number") + 10)
            }
            _ => format!("{line}\n"),
        };
        log.lines().map(late).collect()
    });
    let output = output(&arguments(text(&jump), &manoeuvres, &reference));
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(error.contains("receive times jump at 18000100"), "{error}");
    // Without the scan about the sun vector at 60° X is not turned about.
    assert_eq!(output.status.code(), Some(2));
    assert!(error.contains("GYRX scale factor: no manoeuvre turns about X"), "{error}");
}

#[test]
fn saturated_counts_are_left_out() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    // More than 16 bits in one sample interval.
    let saturated = temp_dir.path().join("saturated");
    let course = "gyro.GYRY.lost-counts={ counts = 100000.0, time_s = 700.0 }";
    run(&["simulate", "--duration", "14000", "--set", course, "--out", text(&saturated)]);
    let file = |name: &str| text(&saturated.join(name)).to_owned();
    let (link, manoeuvres, reference) = (file("link.log"), file("manoeuvres.csv"), file("reference.csv"));
    let (table, error) = run(&arguments(&link, &manoeuvres, &reference));
    assert!(error.contains("left out: y-scan at 600.0 s, GYRY: the count is saturated at 700.0 s"), "{error}");
    assert!(table.contains("of 11 spare equations"), "{table}");
}

#[test]
fn outputs_that_are_one_file_are_refused() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    let (link, reference, both) = (in_can("link.log"), in_can("reference.csv"), temp_dir.path().join("both"));
    let recording = ["--link", &link, "--reference", &reference];
    for command in [&["calibrate", "--manoeuvres", &in_can("manoeuvres.csv")][..], &["diagnose"]] {
        for [one, other] in [["--out", "--json"], ["--out", "--html"], ["--json", "--html"]] {
            let message = refused(&[command, &recording, &[one, text(&both), other, text(&both)]].concat());
            // In the order of the command's help.
            let says = |one: &str, other: &str| {
                message.contains(&format!("{one} {0}: expected another file than {other} {0}", text(&both)))
            };
            assert!(says(one, other) || says(other, one), "{message}");
        }
        assert!(!both.exists());
    }
}

#[test]
fn lists_and_references_that_do_not_fit_are_refused_or_left_out() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    let (link, manoeuvres, reference) = (in_can("link.log"), in_can("manoeuvres.csv"), in_can("reference.csv"));
    let list = |text_: &str| {
        let path = temp_dir.path().join("list.csv");
        fs::write(&path, text_).expect("writable");
        text(&path).to_owned()
    };
    let of_list = |text: &str| refused(&arguments(&link, &list(text), &reference));
    let header = "manoeuvre,start_s,end_s\n";
    let at = 1_800_000_000;
    for (bad, part) in [
        (String::new(), "line 1: header: expected the columns manoeuvre, start_s, end_s"),
        (format!("{header}pointing,x,{at}\n"), "line 2: start_s: expected a number, got \"x\""),
        (format!("{header}pointing,{at},{at}\n"), "line 2: end_s: expected an end after the start"),
        (
            format!("{header}pointing,{at},{}\nz-scan,{},{}\n", at + 600, at + 500, at + 700),
            "line 3: start_s: expected a manoeuvre beside the pointing of 1800000000…1800000600 s",
        ),
        (header.to_owned(), "expected calibration manoeuvres"),
        (format!("{header}slew,{at},{}\nsurvey,{},{}\n", at + 60, at + 60, at + 90), "got only slew, survey"),
        (format!("{header}pointing,{at},{}\n", at + 600), "GYRX scale factor: no manoeuvre turns about X"),
        (format!("{header}pointing,5,605\n"), "left out: pointing at 5.0 s: the recording does not cover it"),
    ] {
        let message = of_list(&bad);
        assert!(message.contains(part), "{part} not in {message}");
    }
    // The order of the lines does not matter.
    let backwards = edited(&temp_dir, "manoeuvres.csv", |text| {
        let (header, rows) = text.split_once('\n').expect("a header");
        rows.lines().rev().fold(format!("{header}\n"), |text, row| text + row + "\n")
    });
    let of = |manoeuvres: &str| run(&arguments(&link, manoeuvres, &reference)).0;
    assert_eq!(of(text(&backwards)), of(&manoeuvres));
    // A reference that ends inside the scan about Z.
    let short =
        edited(&temp_dir, "reference.csv", |text| text.lines().take(10_000).map(|line| format!("{line}\n")).collect());
    let message = refused(&arguments(&link, &manoeuvres, text(&short)));
    assert!(
        message.contains("left out: z-scan at 1800001260.0 s: the reference does not cover it: it ends at"),
        "{message}"
    );
    assert!(message.contains("no manoeuvre turns about Z"), "{message}");
    // Quaternions, scalar last, that drop out at the start of the scan about Z.
    let dropout = edited(&temp_dir, "reference.csv", |text| {
        let mut attitude = UnitQuaternion::identity();
        let row = |row: &str| {
            let numbers: Vec<f64> = row.split(',').map(|number| number.parse().expect("a number")).collect();
            let turn = Vector3::new(numbers[1], numbers[2], numbers[3]) * 0.5 / 206_264.806_247_096_36;
            attitude *= UnitQuaternion::from_scaled_axis(turn);
            match numbers[0] - 1_800_001_260.0 {
                -2.0..=2.0 => format!("{};;nan;;\n", numbers[0]),
                _ => format!("{};{};{};{};{}\n", numbers[0], attitude.i, attitude.j, attitude.k, attitude.w),
            }
        };
        format!("t_s;q1;q2;q3;q4\n{}", text.lines().skip(1).map(row).collect::<String>())
    });
    let message = refused(&arguments(&link, &manoeuvres, text(&dropout)));
    let part = "left out: z-scan at 1800001260.0 s: the reference has a gap at its start or end";
    assert!(message.contains(part) && message.contains("no manoeuvre turns about Z"), "{message}");
    let message = refused(&["calibrate", "--link", &link, "--manoeuvres", &manoeuvres, "--reference", &manoeuvres]);
    assert!(message.contains("expected the columns t_s (or"), "{message}");
    let sse = in_can("sse.csv");
    let message = refused(&["calibrate", "--link", &link, "--fss", &sse, "--sse", &sse]);
    assert!(message.contains("line 1: header: expected the columns"), "{message}");
    let missing = refused(&arguments("nowhere.log", &manoeuvres, &reference));
    assert!(missing.contains("nowhere.log"), "{missing}");
}

#[test]
fn an_update_finds_the_survey_scans_and_rewrites_four_values() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    let (day, out, json) =
        (temp_dir.path().join("day"), temp_dir.path().join("out.toml"), temp_dir.path().join("update.json"));
    // 40 ppm more than configured.
    let moved = "gyro.GYRZA.calibration.scale_factor=1.00054002";
    run(&["simulate", "--start", "1800000000", "--duration", "40000", "--set", moved, "--out", text(&day)]);
    let [link, reference] = ["link.log", "reference.csv"].map(|name| text(&day.join(name)).to_owned());
    let config = root().join("configs/reference.toml");
    let update = ["calibrate", "--update", "--config", text(&config), "--link", &link, "--reference", &reference];
    let results = ["--out", text(&out), "--json", text(&json), "--calibrated", "1798790400"];
    let (table, said) = run(&[&update[..], &results].concat());
    assert!(table.contains("GYRZA scale factor") && table.contains("redetermination due"), "{table}");
    assert!(said.contains("assumed accuracy of the calibration") && !said.contains("assumed time"), "{said}");
    let ([_, _, za, zb], sigmas) = solved(&json);
    assert!((za.scale_factor - 1.00054002).abs() < 3.0 * sigmas[8] && sigmas[8] < 6e-6, "{za:?} {sigmas:?}");
    // Only four numbers change.
    let [before, after] = [&config, &out].map(|path| fs::read_to_string(path).expect("a configuration"));
    let changed: Vec<&str> =
        before.lines().zip(after.lines()).filter(|(before, after)| before != after).map(|(_, after)| after).collect();
    assert_eq!((before.lines().count(), changed.len()), (after.lines().count(), 2), "{changed:?}");
    let [of_out, configured] = [&after, &before].map(|text| Configuration::parse("x", text, &[]).expect("valid"));
    assert!((of_out.gyros[2].calibration.scale_factor - za.scale_factor).abs() < 1e-10);
    assert!((of_out.gyros[3].calibration.drift_arcsec_per_half_s - zb.drift_arcsec_per_half_s).abs() < 1e-7);
    assert_eq!(of_out.gyros[2].calibration.x_arcsec, configured.gyros[2].calibration.x_arcsec);
    // The next update uses the result of this one.
    let later = ["--known", text(&json), "--calibrated", "1800000000"];
    let (_, said) = run(&[&update[..], &later].concat());
    assert!(!said.contains("assumed"), "{said}");
    // A recording without a survey is refused.
    let link = in_can("link.log");
    let reference = in_can("reference.csv");
    let manoeuvres = edited(&temp_dir, "manoeuvres.csv", |text| text.replace("survey", "slew"));
    let error = refused(&[
        "calibrate",
        "--update",
        "--link",
        &link,
        "--reference",
        &reference,
        "--manoeuvres",
        text(&manoeuvres),
    ]);
    assert!(error.contains("expected survey scans: 120 s or more at a steady 60…289 arcsec/s about Z"), "{error}");
}

#[test]
fn an_unexplained_solution_is_reported_and_written_only_on_request() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    let simulated = temp_dir.path().join("simulated");
    // In the middle of the pointing, which determines the drift.
    let course = "gyro.GYRX.drift-step={ arcsec_per_h = 3000.0, time_s = 900.0 }";
    run(&["simulate", "--duration", "14000", "--set", course, "--out", text(&simulated)]);
    let file = |name: &str| text(&simulated.join(name)).to_owned();
    let (link, manoeuvres, reference) = (file("link.log"), file("manoeuvres.csv"), file("reference.csv"));
    let (json, out) = (temp_dir.path().join("result.json"), temp_dir.path().join("unit.toml"));
    let results = ["--json", text(&json), "--out", text(&out)];
    let arguments = [&arguments(&link, &manoeuvres, &reference)[..], &results].concat();
    let refused = output(&arguments);
    let error = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(1), "{error}");
    assert!(error.contains("do not explain these data") && error.contains("--anyway"), "{error}");
    assert!(
        String::from_utf8_lossy(&refused.stdout).contains("GYRZB misalignment y") && json.exists() && !out.exists()
    );
    let (_, error) = run(&[&arguments[..], &["--anyway"]].concat());
    assert!(error.contains("do not explain these data") && out.exists(), "{error}");
}

#[test]
fn a_reference_with_an_axis_of_the_opposite_sign_gives_no_configuration() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    let reference = edited(&temp_dir, "reference.csv", |text| {
        let (header, rows) = text.split_once('\n').expect("rows");
        let reversed = rows.lines().map(|row| row.replacen(',', ",-", 1).replace(",--", ",") + "\n");
        format!("{header}\n{}", reversed.collect::<String>())
    });
    let (link, manoeuvres, out) = (in_can("link.log"), in_can("manoeuvres.csv"), temp_dir.path().join("unit.toml"));
    let refused = output(&[&arguments(&link, &manoeuvres, text(&reference))[..], &["--out", text(&out)]].concat());
    let error = String::from_utf8_lossy(&refused.stderr);
    assert_eq!((refused.status.code(), out.exists()), (Some(1), false), "{error}");
    assert!(error.contains("gyro.GYRX.calibration.scale_factor`, got -1.0") && error.contains("its sign?"), "{error}");
}

#[test]
fn a_serial_recording_starts_with_the_attitude_data() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    let simulated = temp_dir.path().join("simulated");
    run(&["simulate", "--wire", "serial", "--start", "1800000000", "--duration", "14000", "--out", text(&simulated)]);
    let file = |name: &str| text(&simulated.join(name)).to_owned();
    let (link, fss, sse) = (file("link.bin"), file("fss.csv"), file("sse.csv"));
    let sensors = ["--link", &link, "--fss", &fss, "--sse", &sse];
    let (table, _) = run(&[&["calibrate", "--manoeuvres", &file("manoeuvres.csv")], &sensors[..]].concat());
    assert!(table.contains("GYRX scale factor"), "{table}");
    let (summary, error) = run(&[&["reconstruct"], &sensors[..]].concat());
    assert!(summary.contains("28000 samples") && !error.contains("outside"), "{summary}{error}");
    assert!(!error.contains("depart"), "{error}");
    // Of fixes with exchanged angles no attitude is written.
    let exchanged = edited_file(&temp_dir, &simulated.join("sse.csv"), |text| {
        let (header, rows) = text.split_once('\n').expect("rows");
        let exchanged = rows.lines().map(|row| {
            let cells: Vec<&str> = row.split(',').collect();
            [&cells[..3], &[cells[4], cells[3]], &cells[5..]].concat().join(",") + "\n"
        });
        format!("{header}\n{}", exchanged.collect::<String>())
    });
    let out = temp_dir.path().join("attitude.csv");
    let arguments = ["reconstruct", "--link", &link, "--fss", &fss, "--sse", text(&exchanged), "--out", text(&out)];
    let reconstructed = output(&arguments);
    let error = String::from_utf8_lossy(&reconstructed.stderr);
    assert_eq!((reconstructed.status.code(), out.exists()), (Some(1), false), "{error}");
    assert!(error.contains("depart from the filter's attitude") && error.contains("its sign?"), "{error}");
    let (_, error) = run(&[&arguments[..], &["--anyway"]].concat());
    assert!(error.contains("is written anyway") && out.exists(), "{error}");
    for command in ["calibrate", "reconstruct"] {
        for bad in ["NaN", "1e30", "-1", "inf"] {
            let message = refused(&[&[command, "--start", bad], &sensors[..]].concat());
            assert!(message.contains("expected 0…4e9 seconds"), "{command} {bad}: {message}");
        }
    }
    let message = refused(&["checkout", "--runs", "0"]);
    assert!(message.contains("--runs"), "{message}");
}

#[test]
fn an_ephemeris_that_is_not_in_utc_is_refused() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    let path = temp_dir.path().join("attitude.aem");
    let link = in_can("link.log");
    for (system, update) in [("TAI", false), ("GPS", true)] {
        let mut aem = format!(
            "CCSDS_AEM_VERS = 1.0\nCREATION_DATE = 2027-01-15T00:00:00\nORIGINATOR = TEST\nMETA_START\nOBJECT_NAME = GEU\n\
             OBJECT_ID = 1983-004A\nREF_FRAME_A = EME2000\nREF_FRAME_B = SC_BODY_1\nATTITUDE_DIR = A2B\n\
             TIME_SYSTEM = {system}\nSTART_TIME = 2027-01-15T08:00:00\nSTOP_TIME = 2027-01-15T08:01:00\n\
             ATTITUDE_TYPE = QUATERNION\nQUATERNION_TYPE = FIRST\nMETA_STOP\nDATA_START\n"
        );
        (0..60).for_each(|second| aem += &format!("2027-01-15T08:00:{second:02} 1 0 0 0\n"));
        fs::write(&path, aem + "DATA_STOP\n").expect("writable");
        let mut arguments = vec!["calibrate", "--link", &link, "--reference", text(&path)];
        arguments.extend(update.then_some("--update"));
        let message = refused(&arguments);
        assert!(message.contains(system) && message.contains("convert the ephemeris to UTC"), "{message}");
    }
}
