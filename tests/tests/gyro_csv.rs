//! Plain gyro CSV: telemetry of a real gyro in orbit, if present, and errors of `geu decode --gyro-csv`.

use std::collections::BTreeMap;
use std::fs;

use geu_recording::{GyroCsv, GyroCsvDefectKind as Kind, GyroCsvSpec};
use geu_tests::{geu, recordings, root};

fn description() -> GyroCsvSpec {
    let path = root().join("configs/suchai3.toml");
    let text = fs::read_to_string(&path).expect("it ships");
    GyroCsvSpec::parse(&path.to_string_lossy(), &text).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn real_telemetry_is_taken_in_with_its_faults() {
    let Some(directory) = recordings("suchai3") else { return };
    // Number of rows as the telemetry's README states it; time steps counted by another program (Python's csv module).
    for (day, rows, faults) in [
        ("20230824", 5586, &[("gap", 5)][..]),
        ("20230904", 5349, &[("gap", 6), ("repeated-stamp", 2), ("time-glitch", 2)]),
        ("20231113", 1000, &[("time-glitch", 1)]),
        ("20231211", 2001, &[("gap", 2), ("repeated-stamp", 1)]),
    ] {
        let path = directory.join(format!("suchai3_{day}.csv"));
        let read = GyroCsv::read(&path.to_string_lossy(), description()).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(read.samples.len(), rows, "{day}");
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        read.defects.iter().for_each(|defect| *counts.entry(defect.kind.name()).or_default() += 1);
        assert_eq!(counts.into_iter().collect::<Vec<_>>(), faults, "{day}");
        for defect in &read.defects {
            match defect.kind {
                Kind::Glitch { offset_s, .. } => assert_eq!(offset_s, 100.0),
                // The first row of 11 December belongs to the month before.
                Kind::Gap { length_s } if day == "20231211" && defect.line == 3 => assert_eq!(length_s, 2_416_444.0),
                Kind::Gap { length_s } => assert!((2.0..=28.0).contains(&length_s), "{day}: {length_s}"),
                _ => {}
            }
        }
        // Tumbling at 25 to 57 deg/s, rounded.
        let squares = |rates: &[f64]| rates.iter().map(|rate| rate * rate).sum::<f64>();
        let means = read.samples.iter().map(|sample| squares(&sample.rates_arcsec_s).sqrt() / 3600.0);
        let mean = means.sum::<f64>() / rows as f64;
        assert!((24.5..57.5).contains(&mean), "{day}: {mean} deg/s");
    }
}

#[test]
fn geu_decode_reads_a_gyro_csv_as_described() {
    let directory = tempfile::tempdir().expect("a directory");
    let (file, defects) = (directory.path().join("gyro.csv"), directory.path().join("defects.jsonl"));
    let header = "sat_index,timestamp_s,gyro_x_lsb,gyro_y_lsb,gyro_z_lsb";
    let rows =
        "1,1000.0,-1456,0,1\n2,1001.0,-1456,0,1\n2,1001.0,-1456,0,1\n3,1102.0,0,0,1\n4,1003.0,0,x,1\n5,1004.0,0,0,1\n";
    fs::write(&file, format!("{header}\n{rows}")).expect("written");
    let decode = |more: &[&str]| {
        let mut command = geu();
        command.arg("decode").arg(&file).arg("--gyro-csv").arg(root().join("configs/suchai3.toml")).args(more);
        command.output().expect("geu starts")
    };
    let output = decode(&["--defects", defects.to_str().expect("UTF-8"), "--strict"]);
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).expect("UTF-8");
    assert!(text.starts_with("t_s,line,X_arcsec_s,Y_arcsec_s,Z_arcsec_s\n1000.000000,2,-36000,0,24.72"), "{text}");
    assert_eq!(text.lines().count(), 6);
    let reported = fs::read_to_string(&defects).expect("written");
    let kinds: Vec<&str> = reported.lines().map(|line| line.split('"').nth(3).expect("a kind")).collect();
    assert_eq!(kinds, ["repeated-stamp", "time-glitch", "not-a-number"], "{reported}");

    let summary = String::from_utf8(decode(&["--format", "summary"]).stdout).expect("UTF-8");
    assert!(summary.contains("rows         6: 5 samples, 1 refused"), "{summary}");
    let jsonl = String::from_utf8(decode(&["--format", "jsonl", "-q"]).stdout).expect("UTF-8");
    assert!(jsonl.starts_with("{\"t_s\":1000.000000,\"line\":2,\"X_arcsec_s\":-36000,"), "{jsonl}");

    let mut missing = geu();
    missing.arg("decode").arg(&file).arg("--gyro-csv").arg(directory.path().join("none.toml"));
    let output = missing.output().expect("geu starts");
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("none.toml: cannot be read"));
}
