//! `geu diagnose` on minutes, which do not determine all calibration parameters, and an output that cannot be written.

use geu_model::Configuration;
use geu_tests::{geu, give_way};
use serde_json::Value;

#[test]
fn a_pivot_clearance_is_found_in_15_min_and_two_unwritable_outputs_are_reported() {
    give_way();
    let directory = tempfile::tempdir().expect("a directory");
    let at = |name: &str| directory.path().join(name).display().to_string();
    let injected = "gyro.GYRX.pivot-clearance.clearance_arcsec=11.5";
    let simulated = geu().args(["simulate", "--duration", "900", "--set", injected, "--out", &at("run")]).output();
    assert!(simulated.expect("geu starts").status.success());
    let [link, reference, json] = ["run/link.log", "run/reference.csv", "said.json"].map(at);
    // Opens, and fails at the first write.
    let full = "/dev/full";
    let mut command = geu();
    command.args([
        "diagnose",
        "--link",
        &link,
        "--reference",
        &reference,
        "--json",
        &json,
        "--out",
        full,
        "--html",
        full,
    ]);
    let output = command.env("XDG_CACHE_HOME", at("cache")).output().expect("geu starts");
    // Findings are printed and written though two files fail.
    let (report, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(1), "{report}{errors}");
    assert!(report.starts_with("explained: 1 effect is missing in the model"), "{report}");
    assert!(report.contains("\n1. pivot-clearance on GYRX\n") && report.contains("\n   what next "), "{report}");
    assert!(report.lines().all(|line| line.chars().count() <= 100), "{report}");
    assert_eq!(errors.matches("/dev/full: cannot be written").count(), 2, "{errors}");
    let said: Value = serde_json::from_str(&std::fs::read_to_string(&json).expect("written")).expect("JSON");
    let effects = said["effects"].as_array().expect("a list");
    let missing: Vec<&Value> = effects.iter().filter(|effect| effect["class"] == "missing-effect").collect();
    let [found] = missing[..] else { panic!("{report}") };
    assert_eq!((&found["code"], &found["gyros"][0]), (&"pivot-clearance".into(), &"GYRX".into()), "{report}");
    // The noise never changes: three sigma. A sigma of 0.2 arcsec is a sixtieth of the injected amplitude.
    let number = |name: &str| found["parameters"]["clearance_arcsec"][name].as_f64().expect("a number");
    assert!((number("value") - 11.5).abs() < 3.0 * number("sigma") && number("sigma") < 0.2, "{report}");
    let left = said["gap"]["after"]["fitted"]["rms_arcsec"].as_f64().expect("a number");
    // Rounding at both ends 0.41, angle random walk in 15 min 0.21; a third more for refitted parameters.
    assert!(left < 0.6, "{report}");
}

/// At rest scale factors, misalignments and drifts have one signature.
#[test]
fn at_rest_changed_drifts_have_no_other_name() {
    give_way();
    let directory = tempfile::tempdir().expect("a directory");
    let at = |name: &str| directory.path().join(name).display().to_string();
    std::fs::write(at("ideal.toml"), "seed = 77\n").expect("written");
    let mut command = geu();
    command.args(["simulate", &at("ideal.toml"), "--duration", "900", "--out", &at("run")]);
    assert!(command.output().expect("geu starts").status.success());
    let [link, reference, json, out] = ["run/link.log", "run/reference.csv", "said.json", "out.toml"].map(at);
    let mut command = geu();
    command.args(["diagnose", "--link", &link, "--reference", &reference, "--json", &json, "--out", &out]);
    let output = command.env("XDG_CACHE_HOME", at("cache")).output().expect("geu starts");
    let report = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{report}");
    let said: Value = serde_json::from_str(&std::fs::read_to_string(&json).expect("written")).expect("JSON");
    let new = std::fs::read_to_string(&out).expect("written");
    let new = Configuration::parse("out.toml", &new, &[]).expect("valid");
    let given = Configuration::reference();
    let found = said["effects"].as_array().expect("a list");
    assert_eq!(found.len(), 4, "{report}");
    for ((entry, given), new) in found.iter().zip(&given.gyros).zip(&new.gyros) {
        assert_eq!(entry["code"], "drift", "{report}");
        let moved = new.calibration.drift_arcsec_per_half_s - given.calibration.drift_arcsec_per_half_s;
        let [value, sigma] = ["value", "sigma"].map(|name| entry["parameters"]["arcsec_per_h"][name].as_f64());
        let off = value.expect("a number") - moved * 7200.0;
        assert!(off.abs() < 0.1 * sigma.expect("a number"), "{off}: {report}");
    }
}
