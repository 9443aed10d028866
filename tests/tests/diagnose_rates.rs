//! `geu diagnose --gyro-csv`: telemetry of real gyros in orbit, if present, and errors of the command.

use std::fs;
use std::process::Output;

use geu_tests::{geu, recordings, root};
use serde_json::Value;

fn diagnose(arguments: &[&str]) -> Output {
    let description = root().join("configs/suchai3.toml");
    geu().arg("diagnose").arg("--gyro-csv").arg(description).args(arguments).output().expect("geu starts")
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
    // Every fault that `geu decode` counts in the same files (tests/gyro_csv.rs).
    let kinds = |kind: &str| {
        let findings = found["findings"].as_array().expect("findings");
        findings.iter().filter(|finding| finding["kind"] == kind).count()
    };
    assert_eq!(["gap", "repeated-stamp", "time-glitch", "time-backwards"].map(kinds), [13, 3, 3, 0]);
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

#[test]
fn samples_are_assigned_to_rate_windows() {
    let directory = tempfile::tempdir().expect("a directory");
    let (link, reference) = (directory.path().join("gyro.csv"), directory.path().join("rate.csv"));
    // Counts of 1/145.6 deg/s once a second; the reference every 10 s. X reads 2 deg/s too much.
    let (mut rows, mut rates) =
        ("timestamp_s,gyro_x_lsb,gyro_y_lsb,gyro_z_lsb\n".to_owned(), "t_s,rate_arcsec_s\n".to_owned());
    for second in 1..=900 {
        let spin = [[20.0, 0.0, 5.0], [0.0, -30.0, 3.0], [-4.0, 2.0, 25.0]][(second - 1) / 300];
        let counts = spin.map(|rate: f64| rate * 145.6);
        rows += &format!("{second},{:.0},{:.0},{:.0}\n", counts[0] + 2.0 * 145.6, counts[1], counts[2]);
        if second % 10 == 0 {
            let jitter = [40.0, -20.0, -35.0, 10.0, 25.0, -15.0, 5.0][second / 10 % 7];
            let magnitude = spin.iter().map(|rate| rate * rate).sum::<f64>().sqrt() * 3600.0;
            rates += &format!("{second},{}\n", magnitude + jitter);
        }
    }
    fs::write(&link, rows).expect("written");
    fs::write(&reference, rates).expect("written");
    let (link, reference) = (link.to_string_lossy(), reference.to_string_lossy());
    let output = diagnose(&["--link", &link, "--reference", &reference]);
    let text = reported(&output);
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(text.contains("bias of X: +1.99") || text.contains("bias of X: +2.00"), "{text}");
    assert!(!text.contains("phase rate"), "a caveat of another reference: {text}");

    let output = diagnose(&["--reference", &reference]);
    assert_eq!(output.status.code(), Some(2));
    assert!(reported(&output).contains("--link: expected CSV of gyros"), "{}", reported(&output));
    let output = diagnose(&["--reference", &link, "--link", &link]);
    assert_eq!(output.status.code(), Some(2));
    assert!(
        reported(&output).contains("line 1: header: expected the columns day, wx, wy, wz, magrate; or t_s and"),
        "{}",
        reported(&output)
    );
}
