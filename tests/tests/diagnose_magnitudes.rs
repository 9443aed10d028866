//! `geu diagnose` against magnitudes: telemetry of real gyros in orbit, if present, and errors of the command.

use std::fs;
use std::path::Path;
use std::process::Output;

use geu_tests::{geu, recordings};
use serde_json::Value;

fn diagnose(arguments: &[&str]) -> Output {
    geu().args(["diagnose", "--device", "suchai3"]).args(arguments).output().expect("geu starts")
}

fn reported(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

#[test]
fn real_gyros_have_a_bias_and_a_scale_error() {
    let Some(directory) = recordings("suchai3") else { return };
    let file = |name: &str| directory.join(name).to_string_lossy().into_owned();
    let reference = file("suchai3_gyro_vs_magphase_300s.csv");
    let directory = tempfile::tempdir().expect("a directory");
    let json = directory.path().join("diagnosis.json").to_string_lossy().into_owned();
    let links = ["20230824", "20230904", "20231113", "20231211"].map(|day| file(&format!("suchai3_{day}.csv")));
    let mut arguments = vec!["--reference", &reference, "--json", &json, "--link"];
    arguments.extend(links.iter().map(String::as_str));
    let output = diagnose(&arguments);
    assert_eq!(output.status.code(), Some(0), "{}", reported(&output));
    let found: Value = serde_json::from_str(&fs::read_to_string(&json).expect("written")).expect("JSON");
    assert_eq!(found["verdict"], "explained");
    let effects = found["effects"].as_array().expect("effects");
    let mut codes: Vec<&str> = effects.iter().filter_map(|effect| effect["code"].as_str()).collect();
    codes.sort_unstable();
    assert_eq!(codes, ["drift", "scale-factor"]);
    // A least-squares fit in Python gives −4.5 ± 1.9 deg/s and −1.2 ± 0.3 %. Limits: 2.5 sigma farther from 0, and half the value, below
    // which most of the error would remain.
    for effect in effects {
        let (unit, min, max) = match effect["code"].as_str() {
            Some("drift") => ("arcsec_per_h", -9.0 * 3600.0 * 3600.0, -2.0 * 3600.0 * 3600.0),
            _ => ("ppm", -20_000.0, -6_000.0),
        };
        let value = effect["parameters"][unit]["value"].as_f64().expect("a value");
        assert!((min..max).contains(&value), "{effect}");
    }
    // Every fault that `geu decode` counts in the same files (tests/tables.rs).
    let kinds = |kind: &str| {
        let findings = found["findings"].as_array().expect("findings");
        findings.iter().filter(|finding| finding["kind"] == kind).count()
    };
    assert_eq!(["time-gap", "time-repeated", "time-backwards"].map(kinds), [16, 3, 3]);
    let rms = |when: &str| found["gap"][when]["held_out"]["rms_arcsec_s"].as_f64().expect("a gap");
    // 0.105 of 0.253 deg/s (docs/diagnosis-suchai3.md), with a margin for another fit.
    assert!(rms("after") < 0.5 * rms("before"), "{}", found["gap"]);
    assert_eq!(found["groups"].as_array().map(Vec::len), Some(4));
    let text = reported(&output);
    for part in
        ["bias of X and bias of Y: cosine", "bias of X and scale error: cosine", "would bring it to", "not fully"]
    {
        assert!(text.contains(part), "{part} not in {text}");
    }
}

/// Telemetry of 900 s as counts of 1/145.6 deg/s, in which X reads 2 deg/s too much, and the magnitude every 10 s.
fn written(directory: &Path, header: &str) -> (String, String) {
    let (mut rows, mut rates) = ("timestamp_s,gyro_x_lsb,gyro_y_lsb,gyro_z_lsb\n".to_owned(), format!("{header}\n"));
    for second in 1..=900 {
        let spin = [[20.0, 0.0, 5.0], [0.0, -30.0, 3.0], [-4.0, 2.0, 25.0]][(second - 1) / 300];
        let counts = spin.map(|rate: f64| rate * 145.6);
        // Ten rows are 100 s ahead.
        let stamp = if (400..410).contains(&second) { second + 100 } else { second };
        rows += &format!("{stamp},{:.0},{:.0},{:.0}\n", counts[0] + 2.0 * 145.6, counts[1], counts[2]);
        if second % 10 == 0 {
            let jitter = [40.0, -20.0, -35.0, 10.0, 25.0, -15.0, 5.0][second / 10 % 7];
            let magnitude = spin.iter().map(|rate| rate * rate).sum::<f64>().sqrt() * 3600.0;
            rates += &format!("{second},{}\n", magnitude + jitter);
        }
    }
    let write = |name: &str, text: String| {
        fs::write(directory.join(name), text).expect("written");
        directory.join(name).to_string_lossy().into_owned()
    };
    (write("gyro.csv", rows), write("rate.csv", rates))
}

#[test]
fn samples_are_assigned_to_windows() {
    let directory = tempfile::tempdir().expect("a directory");
    let (link, reference) = written(directory.path(), "t_s,rate_arcsec_s");
    let output = diagnose(&["--link", &link, "--reference", &reference]);
    let text = reported(&output);
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(text.contains("bias of X: +1.99") || text.contains("bias of X: +2.00"), "{text}");
    assert!(text.contains("rows-left-out: 10 with times"), "{text}");
    assert!(!text.contains("phase rate"), "a caveat of another reference: {text}");
    let output = geu().args(["diagnose", "--gyro-csv", "suchai3", "--link", &link, "--reference", &reference]).output();
    assert_eq!(reported(&output.expect("geu starts")), text);
}

#[test]
fn what_a_magnitude_does_not_serve_is_refused() {
    let directory = tempfile::tempdir().expect("a directory");
    let (link, reference) = written(directory.path(), "t_s,rate_arcsec_s");
    let bad = |name: &str, text: &str| {
        fs::write(directory.path().join(name), text).expect("written");
        directory.path().join(name).to_string_lossy().into_owned()
    };
    let refused = |arguments: &[&str], part: &str| {
        let output = diagnose(arguments);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && message.contains(part), "{part} not in {message}");
        assert_eq!(message.lines().count(), 1, "{message}");
    };
    let html = directory.path().join("new.html").to_string_lossy().into_owned();
    let more = ["--link", &link, "--reference", &reference, "--html", &html, "--verbose"];
    refused(&more, "without these options, got --html, --verbose");
    refused(
        &["--link", &link, "--reference", &link],
        "expected the columns day, wx, wy, wz, magrate; or a time and a magnitude, rate_deg_s; or t_s",
    );
    for (text, part) in [
        ("", "line 1: header: expected the columns"),
        ("t_s,rate_deg_s\n1,2\n2,fast\n", "line 3: rate_deg_s: expected a number, got \"fast\""),
        ("t_s,rate_deg_s\n1,nan\n", "line 2: rate_deg_s: expected a number, got \"nan\""),
        ("t_s,rate_deg_s\n1,-2\n", "line 2: rate_deg_s: expected a magnitude, 0 to 1e12 arcsec/s, got \"-2\""),
        ("t_s,rate_deg_s\n2,2\n1,2\n", "line 3: t_s: expected a time after that of the row before"),
        ("start_s,end_s,rate_deg_s\n2,2,1\n", "line 2: start_s: expected a start before the end"),
        (
            "start_s,end_s,rate_deg_s\n0,2,1\n1,3,1\n",
            "line 3: start_s: expected a start before the end, and not before",
        ),
        ("day,wx,wy,wz,magrate\na,1,2,x,4\n", "line 2: wz: expected a number, got \"x\""),
        ("day,wx,wy,wz,magrate\na,1,2,3,4\n", "expected 14 windows or more, to separate noise from errors; got 1"),
        ("t_s,rate_deg_s\n1e6,2\n1000010,2\n", "expected samples in half of a window of"),
    ] {
        refused(&["--link", &link, "--reference", &bad("bad.csv", text)], part);
    }
    refused(&["--link", &bad("empty.csv", ""), "--reference", &reference], "empty.csv");
    let output = geu().args(["diagnose", "--device", "tetrad", "--link", &link, "--reference", &reference]).output();
    let message = reported(&output.expect("geu starts"));
    assert!(message.contains("expected a unit of three gyros with perpendicular axes, got A about"), "{message}");
}
