//! `geu calibrate --html` and `--compare`: a self-contained page, and calibrations of one unit or of two.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

use geu_tests::page::well_formed;
use geu_tests::{geu, give_way, root};
use serde_json::Value;
use tempfile::TempDir;

const PARAMETERS: [&str; 16] = [
    "GYRX scale factor",
    "GYRX drift",
    "GYRX misalignment y",
    "GYRX misalignment z",
    "GYRY scale factor",
    "GYRY drift",
    "GYRY misalignment x",
    "GYRY misalignment z",
    "GYRZA scale factor",
    "GYRZA drift",
    "GYRZA misalignment x",
    "GYRZA misalignment y",
    "GYRZB scale factor",
    "GYRZB drift",
    "GYRZB misalignment x",
    "GYRZB misalignment y",
];

fn run(arguments: &[&str]) -> Output {
    geu().args(arguments).output().expect("geu starts")
}

fn checkout() -> String {
    root().join("configs/checkout.toml").display().to_string()
}

/// Simulates the checkout, about fourteen hours, into a directory of its own.
fn simulate_checkout(temp_dir: &Path, name: &str, start: &str, seed: &str, changes: &[&str]) {
    give_way();
    let out = temp_dir.join(name).display().to_string();
    let config = checkout();
    let mut arguments =
        vec!["simulate", &config, "--out", &out, "--start", start, "--seed", seed, "--duration", "55000"];
    changes.iter().for_each(|change| arguments.extend(["--set", change]));
    let output = run(&arguments);
    assert!(output.status.success(), "{}", stderr(&output));
}

/// Calibrates a recording with further arguments; `{}` in them is the directory.
fn calibrate(temp_dir: &Path, name: &str, further: &[&str]) -> Output {
    let of = |file: &str| temp_dir.join(name).join(file).display().to_string();
    let (link, manoeuvres, reference, config) = (of("link.log"), of("manoeuvres.csv"), of("reference.csv"), checkout());
    let further: Vec<String> = further.iter().map(|text| text.replace("{}", &temp_dir.display().to_string())).collect();
    let mut arguments = vec!["calibrate", "--config", &config, "--link", &link];
    arguments.extend(["--manoeuvres", &manoeuvres, "--reference", &reference]);
    arguments.extend(further.iter().map(String::as_str));
    run(&arguments)
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn text(temp_dir: &TempDir, name: &str) -> String {
    fs::read_to_string(temp_dir.path().join(name)).expect("a file")
}

fn json(temp_dir: &TempDir, name: &str) -> Value {
    serde_json::from_str(&text(temp_dir, name)).expect("JSON")
}

#[test]
fn two_checkouts_of_one_unit_are_compatible_and_the_page_is_complete() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    simulate_checkout(temp_dir.path(), "first", "1790000000", "1", &[]);
    simulate_checkout(temp_dir.path(), "second", "1791209600", "2", &[]);
    let output = calibrate(temp_dir.path(), "first", &["--json", "{}/first.json", "--html", "{}/alone.html"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(json(&temp_dir, "first.json")["time_s"], 1_790_000_000.0);
    let results = ["--json", "{}/second.json", "--html", "{}/page.html", "--out", "{}/merged.toml"];
    let output = calibrate(temp_dir.path(), "second", &[&results[..], &["--compare", "{}/first.json"]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(String::from_utf8_lossy(&output.stdout).contains("compatible, merged"));

    let second = json(&temp_dir, "second.json");
    let comparison = &second["comparison"];
    assert_eq!((&comparison["compatible"], &comparison["moved"]), (&Value::Bool(true), &serde_json::json!([])));
    assert_eq!(comparison["chi2"]["dof"], 16);
    assert!(comparison["chi2"]["probability"].as_f64().expect("a number") > 1e-3, "{}", comparison["chi2"]);
    for gyro in ["GYRX", "GYRY", "GYRZA", "GYRZB"] {
        let numbers = |of: &Value| {
            let one = &of["gyros"][gyro]["scale_factor"];
            [&one["value"], &one["sigma"]].map(|number| number.as_f64().expect("a number"))
        };
        let [merged, sigma] = numbers(&comparison["merged"]);
        let ([first, first_sigma], [second, second_sigma]) =
            (numbers(&json(&temp_dir, "first.json")), numbers(&second));
        assert!(sigma < first_sigma.min(second_sigma), "{gyro}");
        // Between them, except for correlations with other parameters.
        assert!((merged - (first + second) / 2.0).abs() < (first - second).abs() / 2.0 + sigma, "{gyro}");
        assert!(text(&temp_dir, "merged.toml").contains(&format!("scale_factor = {merged:.11}")), "{gyro}");
    }

    let (page, alone) = (text(&temp_dir, "page.html"), text(&temp_dir, "alone.html"));
    for page in [&page, &alone] {
        let tags = well_formed(page);
        for (tag, min_count) in [("svg", 16), ("table", 2), ("caption", 2), ("pre", 1)] {
            assert!(tags.iter().filter(|name| *name == tag).count() >= min_count, "{tag}");
        }
        assert!(tags.iter().all(|tag| !["script", "link", "img", "iframe", "a"].contains(&tag.as_str())));
        for outside in ["://", "src=", "href=", "url(", "@import"] {
            assert!(!page.contains(outside), "{outside}");
        }
        for name in PARAMETERS {
            assert!(page.contains(&format!("<th scope=\"row\">{name}</th>")), "{name}");
        }
        for name in ["1 pointing", "2 pointing", "3 z-scan", "4 y-scan", "5 y-scan", "6 x-scan"] {
            assert!(page.contains(&format!("<th scope=\"row\">{name}</th>")), "{name}");
        }
        assert!(page.contains("The calibration parameters explain these data."));
        // A drift, its sigma and its change are in one unit.
        let drift = page.split("<th scope=\"row\">GYRX drift</th>").nth(1).and_then(|rest| rest.split("</tr>").next());
        let drift = drift.expect("a row");
        assert!(drift.matches("arcsec/h<").count() == 3 && !page.contains("arcsec/half s"), "{drift}");
    }
    assert!(page.contains("2026-09-21 14:13:20 UTC") && page.contains("Compatible with the earlier calibrations"));
    assert_eq!(page.matches(" over time\"").count(), 16);
    assert!(alone.contains("No earlier calibration was given"));
}

#[test]
fn a_scale_factor_that_moved_by_100_ppm_is_reported_and_not_merged() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    simulate_checkout(temp_dir.path(), "first", "0", "3", &[]);
    simulate_checkout(temp_dir.path(), "second", "0", "4", &["gyro.GYRY.calibration.scale_factor=0.9988"]);
    assert!(calibrate(temp_dir.path(), "first", &["--json", "{}/first.json"]).status.success());
    let results = ["--json", "{}/second.json", "--html", "{}/page.html", "--out", "{}/out.toml"];
    let output = calibrate(temp_dir.path(), "second", &[&results[..], &["--compare", "{}/first.json"]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let summary = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(summary.contains("not compatible, not merged: GYRY scale factor moved"), "{summary}");
    let second = json(&temp_dir, "second.json");
    let comparison = &second["comparison"];
    assert_eq!(comparison["moved"], serde_json::json!(["GYRY scale factor"]));
    assert_eq!((&comparison["compatible"], &comparison["merged"]), (&Value::Bool(false), &Value::Null));
    let change = comparison["parameters"]["GYRY scale factor"]["change"].as_f64().expect("a number");
    assert!((change - 1e-4).abs() < 1e-5, "{change}");
    let solved = second["gyros"]["GYRY"]["scale_factor"]["value"].as_f64().expect("a number");
    assert!(text(&temp_dir, "out.toml").contains(&format!("scale_factor = {solved:.11}")));
    well_formed(&text(&temp_dir, "page.html"));

    // Neither the very same recording nor a result without covariance can be compared.
    let output = calibrate(temp_dir.path(), "first", &["--compare", "{}/first.json"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("expected calibrations of different recordings"), "{}", stderr(&output));
    // An earlier result is not overwritten by a later one.
    let output = calibrate(temp_dir.path(), "second", &["--compare", "{}/first.json", "--json", "{}/first.json"]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    let mut bare = json(&temp_dir, "first.json");
    bare.as_object_mut().expect("an object").remove("covariance");
    let path: PathBuf = temp_dir.path().join("bare.json");
    fs::write(&path, bare.to_string()).expect("written");
    let output = calibrate(temp_dir.path(), "second", &["--compare", "{}/bare.json"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("bare.json: covariance: expected the 16 × 16 covariance"), "{}", stderr(&output));
}
