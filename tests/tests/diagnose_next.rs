//! `geu diagnose --next-manoeuvre`: two effects that a recording does not distinguish, and a recording of the proposed scenario.

use std::fs;
use std::path::Path;

use geu_tests::{geu, give_way};
use serde_json::Value;

/// One turn about Z.
const MOTION: &str = "[[manoeuvre]]\nkind = \"pointing\"\nduration_s = 1500.0\n\n\
    [[manoeuvre]]\nkind = \"z-scan\"\nangle_deg = 200.0\nrate_arcmin_s = 12.0\n\n\
    [[manoeuvre]]\nkind = \"pointing\"\nduration_s = 1500.0\n";
/// Runs `geu` in a directory; returns what it prints, and standard error.
fn run(directory: &Path, arguments: &[&str]) -> (String, String) {
    let output = geu().args(arguments).env("XDG_CACHE_HOME", "cache").current_dir(directory).output();
    let output = output.expect("geu starts");
    let [out, errors] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    assert!(output.status.success(), "{arguments:?}: {out}{errors}");
    (out, errors)
}

/// Simulates a configuration with an effect, and diagnoses the recording without it: the first effect found, the report, and errors.
fn diagnosed(directory: &Path, config: &str, injected: &str, seed: &str, next: &str) -> (Value, String, String) {
    run(directory, &["simulate", config, "--set", injected, "--set", seed, "--out", "run", "--force"]);
    let inputs = ["--config", config, "--link", "run/link.log", "--reference", "run/reference.csv"];
    let (text, errors) =
        run(directory, &[&["diagnose", "--json", "found.json", "--next-manoeuvre", next], &inputs[..]].concat());
    let said: Value =
        serde_json::from_str(&fs::read_to_string(directory.join("found.json")).expect("written")).expect("JSON");
    (said["effects"][0].clone(), text, errors)
}

/// The alternatives of an effect.
fn alternatives(effect: &Value) -> &Vec<Value> {
    effect["rivals"].as_array().expect("a list")
}

/// Codes of an effect and of indistinguishable alternatives.
fn group(effect: &Value) -> Vec<&str> {
    let same =
        alternatives(effect).iter().filter(|other| other["behind_chi2"].as_f64().is_some_and(|behind| behind < 9.0));
    std::iter::once(effect).chain(same).filter_map(|own| own["code"].as_str()).collect()
}

/// A recording of one turn with `injected` does not exclude `other`, but the proposed scenario does.
fn separated(injected: &str, other: &str) {
    give_way();
    let directory = tempfile::tempdir().expect("a directory");
    let directory = directory.path();
    let reference = run(directory, &["config", "show"]).0;
    let (before, _) = reference.split_once("[[manoeuvre]]").expect("a manoeuvre");
    let (_, after) = reference.split_once("\n[temperature]").expect("temperatures");
    fs::write(directory.join("unit.toml"), format!("{before}{MOTION}\n[temperature]{after}")).expect("written");
    let code = injected.split('.').nth(2).expect("a code");
    let (effect, text, _) = diagnosed(directory, "unit.toml", injected, "seed=11", "next.toml");
    let codes = group(&effect);
    assert!(codes.contains(&code) && codes.contains(&other), "{text}");
    assert!(text.contains("--next-manoeuvre FILE writes the scenario of "), "{text}");
    assert!(text.lines().all(|line| line.chars().count() <= 100), "{text}");
    let all = alternatives(&effect).iter();
    let next = all.map(|other| &other["next_manoeuvre"]).find(|next| !next.is_null()).expect("a manoeuvre");
    assert!(next["sigma"].as_f64().is_some_and(|sigma| sigma >= 7.0), "{next}");
    assert!(next["duration_s"].as_f64().is_some_and(|duration_s| duration_s < 10_800.0), "{next}");
    assert!(next["manoeuvres"][0]["kind"] == "pointing", "{next}");
    let (effect, text, errors) = diagnosed(directory, "next.toml", injected, "seed=12", "none.toml");
    let codes = group(&effect);
    assert!(codes.contains(&code) && !codes.contains(&other), "{text}");
    // If nothing is ambiguous any more, there is no further file.
    let has_next = alternatives(&effect).iter().any(|other| !other["next_manoeuvre"].is_null());
    assert_eq!(directory.join("none.toml").exists(), has_next);
    assert_eq!(errors.contains("none.toml: not written: no manoeuvre separates"), !has_next, "{errors}");
}

#[test]
fn a_nonlinear_scale_factor_is_separated_from_a_quadratic_one() {
    separated("gyro.GYRZA.scale-factor-nonlinearity.cubic_ppm=145", "scale-factor-quadratic");
}
