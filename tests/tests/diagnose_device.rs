//! Diagnosis of described units on recordings of the independent model.

use std::fs;
use std::process::Output;

use geu_plant::{Case, DeviceEffect, DeviceMotionKind, DevicePlant, DeviceUnit, Mix};
use geu_tests::geu;
use serde_json::Value;

/// Exit code and JSON of the diagnosis of a recording of `duration_s`.
fn diagnosed(
    unit: &str,
    seed: u64,
    motion: DeviceMotionKind,
    duration_s: f64,
    effects: Vec<DeviceEffect>,
) -> (Option<i32>, Value) {
    let unit = DeviceUnit::all().into_iter().find(|own| own.name == unit).expect("a unit");
    diagnosed_case(Case::drawn(&unit, Mix::Effects, seed, 0, Some(motion), Some(duration_s)), effects)
}

/// Exit code and JSON of the diagnosis of a drawn recording, with other effects.
fn diagnosed_case(case: Case, effects: Vec<DeviceEffect>) -> (Option<i32>, Value) {
    let (output, json) = output(case, effects);
    let text = json.unwrap_or_else(|| panic!("{}", String::from_utf8_lossy(&output.stderr)));
    (output.status.code(), serde_json::from_str(&text).expect("JSON"))
}

/// Output and JSON, if there is one.
fn output(Case { plant, .. }: Case, effects: Vec<DeviceEffect>) -> (Output, Option<String>) {
    let unit = plant.unit.clone();
    let recording = DevicePlant { effects, ..plant }.record(false);
    let folder = tempfile::tempdir().expect("a folder");
    let [link, reference, json] = ["link", "reference.csv", "out.json"].map(|name| folder.path().join(name));
    fs::write(&link, &recording.link).expect("written");
    fs::write(&reference, &recording.reference).expect("written");
    let arguments = ["diagnose", "--device", unit.name, "--no-cache", "--link"];
    let output: Output = geu()
        .args(arguments)
        .arg(&link)
        .arg("--reference")
        .arg(&reference)
        .arg("--json")
        .arg(&json)
        .output()
        .expect("geu starts");
    (output, fs::read_to_string(&json).ok())
}

/// Codes and gyros of the missing effects.
fn missing(diagnosis: &Value) -> Vec<(String, Vec<String>)> {
    let effects = diagnosis["effects"].as_array().expect("effects");
    let names = |gyros: &Value| -> Vec<String> {
        let names = gyros.as_array().expect("gyros").iter();
        names.map(|own| own.as_str().expect("a name").to_owned()).collect()
    };
    let is_missing = |effect: &&Value| effect["class"] == "missing-effect";
    let named = |effect: &Value| (effect["code"].as_str().expect("a code").to_owned(), names(&effect["gyros"]));
    effects.iter().filter(is_missing).map(named).collect()
}

fn injected(code: &str, heads: &[usize], parameters: &[(&str, f64)]) -> Vec<DeviceEffect> {
    vec![DeviceEffect::new(code, heads, parameters).expect("a known effect")]
}

#[test]
fn described_units_without_an_effect_are_consistent() {
    for (unit, motion) in [
        ("tetrad", DeviceMotionKind::Vehicle),
        ("stim300", DeviceMotionKind::Hand),
        ("mm5.10", DeviceMotionKind::Table),
    ] {
        let (code, diagnosis) = diagnosed(unit, 71, motion, 900.0, Vec::new());
        assert_eq!(missing(&diagnosis), [], "{unit}");
        assert_eq!((code, &diagnosis["verdict"]), (Some(0), &Value::from("consistent")), "{unit}");
    }
}

#[test]
fn a_fast_noisy_reference_shows_no_time_offset_and_no_coning() {
    // A step of the time at the start of a vehicle's motion; products of a rate and an acceleration of a hand.
    for run in [9, 4] {
        let case = Case::drawn(&DeviceUnit::stim300(), Mix::Effects, 6, run, None, None);
        let (code, diagnosis) = diagnosed_case(case, Vec::new());
        assert_eq!((code, missing(&diagnosis)), (Some(0), vec![]), "{diagnosis}");
        assert_eq!(diagnosis["verdict"], "consistent", "{diagnosis}");
    }
}

#[test]
fn effects_on_heads_of_described_units_are_named() {
    let step = injected("drift-step", &[1], &[("arcsec_per_h", 2000.0), ("time_s", 180.0)]);
    let (code, diagnosis) = diagnosed("tetrad", 72, DeviceMotionKind::Table, 420.0, step);
    assert_eq!((code, missing(&diagnosis)), (Some(0), vec![("drift-step".to_owned(), vec!["B".to_owned()])]));
    let late = injected("time-offset", &[], &[("seconds", 0.05)]);
    let (code, diagnosis) = diagnosed("stim300", 73, DeviceMotionKind::Hand, 900.0, late);
    let all = ["X", "Y", "Z"].map(str::to_owned).to_vec();
    assert_eq!((code, missing(&diagnosis)), (Some(0), vec![("time-offset".to_owned(), all)]));
    let found = diagnosis["effects"][0]["parameters"]["seconds"]["value"].as_f64().expect("a number");
    assert!((found - 0.05).abs() < 1e-3, "{found}");
}

#[test]
fn exchanged_and_inverted_heads_of_a_described_unit_are_named_and_corrected() {
    let swap = injected("axis-swap", &[0, 1], &[("on", 1.0)]);
    let (_, diagnosis) = diagnosed("stim300", 74, DeviceMotionKind::Hand, 900.0, swap);
    assert_eq!(missing(&diagnosis), [("axis-swap".to_owned(), vec!["X".to_owned(), "Y".to_owned()])]);
    assert_eq!(diagnosis["effects"][0]["parameters"]["with"]["value"], "Y", "{}", diagnosis["effects"][0]);
    let inverted = injected("sign-inversion", &[2], &[("on", 1.0)]);
    let (_, diagnosis) = diagnosed("stim300", 75, DeviceMotionKind::Hand, 900.0, inverted);
    assert_eq!(missing(&diagnosis), [("sign-inversion".to_owned(), vec!["Z".to_owned()])]);
    assert_eq!(diagnosis["verdict"], "explained");
}

#[test]
fn a_reference_of_opposite_sign_is_refused() {
    let case = || Case::drawn(&DeviceUnit::stim300(), Mix::Effects, 76, 0, Some(DeviceMotionKind::Hand), Some(900.0));
    let (output, json) = output(case(), injected("sign-inversion", &[0, 1, 2], &[("on", 1.0)]));
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!((output.status.code(), json), (Some(2), None), "{message}");
    assert!(
        message.contains("the reference: expected the motion that the gyros measure, got the opposite: X, Y, Z"),
        "{message}"
    );
    let (_, diagnosis) = diagnosed_case(case(), injected("sign-inversion", &[0, 1], &[("on", 1.0)]));
    assert_eq!(missing(&diagnosis).len(), 2, "{diagnosis}");
}

/// A unit with a rate and a trial in each row of a table.
const TABLE: &str = r#"
[device]
name = "Rate table"
source = "a test"
interval_s = 0.1
output = "rate"
range_arcsec_s = 360000.0
[[device.head]]
name = "A"
input = [1.0, 0.0, 0.0]
[device.table]
time = { column = "t", unit = "s" }
group = "trial"
fields = [{ column = "a", head = "A", unit = "deg/s" }]
"#;

#[test]
fn rows_that_are_no_part_of_a_recording_are_counted() {
    let rate = |row: usize| 5.0 * (row as f64 / 40.0).sin();
    let (mut rows, mut reference) =
        ("t,trial,a\n".to_owned(), "t_s,rate_x_deg_s,rate_y_deg_s,rate_z_deg_s\n".to_owned());
    for row in 1..7000 {
        // Two gaps, each of which alone a recording may have.
        let t_s = match row {
            5500..6000 => row as f64 * 0.1 + 1e5,
            6000..6300 => row as f64 * 0.1 + 2e5,
            _ => row as f64 * 0.1,
        };
        let trial = if row < 6400 { 1 } else { 2 };
        rows.push_str(&format!("{t_s:.1},{trial},{}\n", rate(row)));
        reference.push_str(&format!("{:.1},{},0,0\n", (row - 1) as f64 * 0.1, rate(row)));
    }
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        let file = folder.path().join(name);
        fs::write(&file, text).expect("written");
        file
    };
    let json = folder.path().join("out.json");
    let output = geu()
        .args(["diagnose", "--no-cache", "--device"])
        .arg(write("unit.toml", TABLE))
        .arg("--link")
        .arg(write("link.csv", &rows))
        .arg("--reference")
        .arg(write("reference.csv", &reference))
        .arg("--json")
        .arg(&json)
        .output()
        .expect("geu starts");
    let text = fs::read_to_string(&json).unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&output.stderr)));
    let diagnosis: Value = serde_json::from_str(&text).expect("JSON");
    let findings = diagnosis["findings"].as_array().expect("findings");
    let left_out = findings.iter().filter(|own| own["kind"] == "rows-left-out");
    let counts: Vec<&str> =
        left_out.map(|own| own["text"].as_str().expect("a text").split(' ').next().expect("a count")).collect();
    assert_eq!(counts, ["100", "600", "300"], "{findings:?}");
}

/// Findings and missing effects of a table of three heads about X, Y, Z in deg/s, at 20 rows a second for 300 s: each row by its number, its
/// time and the rates of a fast motion, compared with the true ones.
fn of_table(
    row: impl Fn(usize, f64, [f64; 3]) -> Option<(f64, [f64; 3])>,
    celsius: impl Fn(f64) -> f64,
    reference_noise_deg: f64,
) -> Value {
    let heads = ["1.0, 0.0, 0.0", "0.0, 1.0, 0.0", "0.0, 0.0, 1.0"].iter().zip(["X", "Y", "Z"]);
    let heads: String =
        heads.map(|(input, name)| format!("[[device.head]]\nname = \"{name}\"\ninput = [{input}]\n")).collect();
    let fields = ["X", "Y", "Z"]
        .map(|name| format!("{{ column = \"{name}\", head = \"{name}\", unit = \"deg/s\" }}"))
        .join(", ");
    let device = format!(
        "[device]\nname = \"Wrist\"\nsource = \"a test\"\ninterval_s = 0.05\noutput = \"rate\"\nrange_arcsec_s = 7200000.0\n{heads}\
         [device.table]\ntime = {{ column = \"t\", unit = \"s\" }}\nfields = [{fields}]\n"
    );
    let rates = |t_s: f64| -> [f64; 3] {
        std::array::from_fn(|axis| {
            let part = |wave: usize| {
                let frequency = 0.05 + 0.07 * (wave * 3 + axis) as f64 + 0.0113 * (wave * wave) as f64;
                15.0 * (std::f64::consts::TAU * frequency * t_s + (axis + 2 * wave) as f64).sin()
            };
            (0..4).map(part).sum()
        })
    };
    // Noise between ±0.05 deg/s by a hash of the number (SplitMix64).
    let noise = |number: usize| {
        let mut bits = (number as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        bits = (bits ^ bits >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ bits >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        0.1 * ((bits ^ bits >> 31) >> 11) as f64 / (1u64 << 53) as f64 - 0.05
    };
    let (mut link, mut reference) = ("t,X,Y,Z\n".to_owned(), "t_s,wx_deg_s,wy_deg_s,wz_deg_s,sensor_c\n".to_owned());
    for number in 1..=6000 {
        let t_s = number as f64 * 0.05;
        let true_rates = rates(t_s);
        // Noise of the attitude about an axis, as a rate: its change since the row before.
        let attitude_deg =
            |number: usize, axis: usize| 20.0 * reference_noise_deg * noise(1_000_000 + 3 * number + axis);
        let [x, y, z]: [f64; 3] = std::array::from_fn(|axis| {
            true_rates[axis] + (attitude_deg(number, axis) - attitude_deg(number - 1, axis)) / 0.05
        });
        reference.push_str(&format!("{t_s:.2},{x},{y},{z},{}\n", celsius(t_s)));
        let noisy = std::array::from_fn(|axis| true_rates[axis] + noise(3 * number + axis));
        if let Some((t_s, [x, y, z])) = row(number, t_s, noisy) {
            link.push_str(&format!("{t_s:.6},{x:.5},{y:.5},{z:.5}\n"));
        }
    }
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str| folder.path().join(name);
    for (name, text) in [("unit.toml", &device), ("link.csv", &link), ("reference.csv", &reference)] {
        fs::write(file(name), text).expect("written");
    }
    let arguments = ["diagnose", "--no-cache", "--device"];
    let mut command = geu();
    command.args(arguments).arg(file("unit.toml")).arg("--link").arg(file("link.csv"));
    command.arg("--reference").arg(file("reference.csv")).arg("--json").arg(file("out.json"));
    let output = command.output().expect("geu starts");
    let text = fs::read_to_string(file("out.json"));
    let text = text.unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&output.stderr)));
    serde_json::from_str(&text).expect("JSON")
}

/// Kinds of the findings.
fn findings(diagnosis: &Value) -> Vec<&str> {
    diagnosis["findings"].as_array().expect("findings").iter().filter_map(|own| own["kind"].as_str()).collect()
}

#[test]
fn exchanged_heads_late_samples_and_a_fast_clock_are_found_together() {
    // 200 s: the less the clock shows, the more a fit without it would spoil.
    let late = |number, t_s: f64, [x, y, z]: [f64; 3]| (number <= 4000).then_some((t_s * 1.003 + 0.8, [x, z, y]));
    let diagnosis = of_table(late, |_| 20.0, 0.2);
    let named: Vec<String> = missing(&diagnosis).into_iter().map(|own| own.0).collect();
    assert_eq!(named, ["axis-swap", "clock-frequency", "time-offset"], "{diagnosis}");
    let number = |index: usize, name: &str| {
        let number = &diagnosis["effects"][index]["parameters"][name];
        [&number["value"], &number["sigma"]].map(|own| own.as_f64().expect("a number"))
    };
    let [[ppm, ppm_sigma], [seconds, seconds_sigma]] = [number(1, "ppm"), number(2, "seconds")];
    assert!((ppm - 3000.0).abs() < 5.0 * ppm_sigma, "{ppm} ± {ppm_sigma}");
    assert!((seconds - 0.8).abs() < 5.0 * seconds_sigma, "{seconds} ± {seconds_sigma}");
}

#[test]
fn clipped_output_is_not_stuck_output_in_any_unit() {
    let clip = |rate: f64| (rate.clamp(-25.0, 24.9)).to_radians();
    let diagnosis = of_table(|_, t_s, [x, y, z]| Some((t_s, [clip(x), y.to_radians(), z.to_radians()])), |_| 20.0, 0.0);
    let found = findings(&diagnosis);
    assert!(
        found.contains(&"clipped") && found.contains(&"unit-factor") && !found.contains(&"stuck-output"),
        "{found:?}"
    );
    let stuck = |number: usize, t_s, [x, y, z]: [f64; 3]| Some((t_s, [x, if number > 3000 { 3.0 } else { y }, z]));
    let diagnosis = of_table(stuck, |_| 20.0, 0.0);
    let found = findings(&diagnosis);
    assert!(found.contains(&"stuck-output") && !found.contains(&"clipped"), "{found:?}");
}

#[test]
fn a_drift_follows_the_temperature_of_the_reference() {
    let celsius = |t_s: f64| 25.0 + 10.0 * (t_s / 60.0).sin() + 0.02 * t_s;
    let drifting = |_, t_s, [x, y, z]: [f64; 3]| Some((t_s, [x, y + 0.001 * (celsius(t_s) - 25.0), z]));
    let diagnosis = of_table(drifting, celsius, 0.0);
    assert_eq!(missing(&diagnosis), [("drift-temperature".to_owned(), vec!["Y".to_owned()])], "{diagnosis}");
}

#[test]
fn output_without_noise_is_stuck_where_the_unit_does_not_turn_about_its_axis() {
    let dead = injected("dead-output", &[0], &[("time_s", 400.0), ("duration_s", 80.0)]);
    let (_, diagnosis) = diagnosed("mm5.10", 76, DeviceMotionKind::Table, 900.0, dead);
    assert_eq!(missing(&diagnosis), [("stuck-output-pulse".to_owned(), vec!["Z".to_owned()])], "{diagnosis}");
    let duration_s = diagnosis["effects"][0]["parameters"]["duration_s"]["value"].as_f64().expect("a number");
    assert!((duration_s - 80.0).abs() < 0.5, "{duration_s}");
    assert!(!findings(&diagnosis).contains(&"outliers"), "{diagnosis}");
}

#[test]
fn output_of_zero_from_the_start_is_stuck() {
    let dead = |_, t_s, [x, _, z]: [f64; 3]| Some((t_s, [x, 0.0, z]));
    let diagnosis = of_table(dead, |_| 20.0, 0.2);
    assert_eq!(missing(&diagnosis), [("stuck-output".to_owned(), vec!["Y".to_owned()])], "{diagnosis}");
}

#[test]
fn few_lost_samples_of_many_are_interpolated() {
    let lost = injected("lost-samples", &[], &[("share", 0.05)]);
    let (_, diagnosis) = diagnosed("tetrad", 77, DeviceMotionKind::Hand, 900.0, lost);
    assert_eq!((missing(&diagnosis), &diagnosis["verdict"]), (vec![], &Value::from("consistent")), "{diagnosis}");
    assert!(findings(&diagnosis).contains(&"samples-lost"), "{diagnosis}");
}

#[test]
fn another_unit_of_the_output_explains_a_recording() {
    let factor = injected("unit-factor", &[], &[("factor", 1f64.to_radians())]);
    let (_, diagnosis) = diagnosed("stim300", 78, DeviceMotionKind::Table, 900.0, factor);
    assert_eq!((missing(&diagnosis), &diagnosis["verdict"]), (vec![], &Value::from("explained")), "{diagnosis}");
}
