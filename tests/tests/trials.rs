//! References in parts: trials with times and drifts of their own, known turns between rests, gaps; accelerations beside the motion.

use std::fs;
use std::path::Path;

use geu_tests::geu;
use serde_json::Value;

const RATE_HZ: usize = 20;
const TRIALS: usize = 4;
/// Drift of each head in each trial, deg/h.
const DRIFTS_DEG_H: [[f64; 3]; TRIALS] =
    [[20.0, -5.0, 3.0], [-30.0, 40.0, 3.0], [0.0, -60.0, 50.0], [90.0, 15.0, -25.0]];
/// Standard deviation of a sample's rate, deg/s: an angle random walk of 0.67 deg/√h.
const NOISE_DEG_S: f64 = 0.05;

/// Noise of uniform distribution by a hash of a number (SplitMix64).
fn noise_deg_s(number: usize) -> f64 {
    let mut bits = (number as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ bits >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ bits >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    NOISE_DEG_S * 12f64.sqrt() * (((bits ^ bits >> 31) >> 11) as f64 / (1u64 << 53) as f64 - 0.5)
}

/// The description of a table of three heads about X, Y, Z, with trials or without.
fn description(group: &str) -> String {
    let heads = [("X", "1.0, 0.0, 0.0"), ("Y", "0.0, 1.0, 0.0"), ("Z", "0.0, 0.0, 1.0")];
    let heads = heads.map(|(name, input)| format!("[[device.head]]\nname = \"{name}\"\ninput = [{input}]\n")).concat();
    let fields = ["X", "Y", "Z"].map(|name| format!("{{ column = \"{name}\", head = \"{name}\", unit = \"deg/s\" }}"));
    format!(
        "[device]\nname = \"Bench\"\nsource = \"a test\"\ninterval_s = 0.05\noutput = \"rate\"\nrange_arcsec_s = 1440000.0\n{heads}\
         [device.table]\ntime = {{ column = \"t\", unit = \"s\" }}\n{group}fields = [{}]\n",
        fields.join(", ")
    )
}

/// Runs a command on a table and a reference; its exit code, JSON and message.
fn run(folder: &Path, command: &str, texts: [&str; 3]) -> (Option<i32>, Value, String) {
    let [unit, link, reference, json] =
        ["unit.toml", "link.csv", "reference.csv", "out.json"].map(|name| folder.join(name));
    for (file, text) in [&unit, &link, &reference].into_iter().zip(texts) {
        fs::write(file, text).expect("written");
    }
    let mut run = geu();
    run.arg(command).arg("--device").arg(unit).arg("--link").arg(link).arg("--reference").arg(reference);
    let output = run.arg("--json").arg(&json).output().expect("geu starts");
    let found = fs::read_to_string(&json).map_or(Value::Null, |text| serde_json::from_str(&text).expect("JSON"));
    (output.status.code(), found, String::from_utf8_lossy(&output.stderr).into_owned())
}

/// Acceleration along the axes, m/s²: gravity on a unit that is turned over, in another order in each trial.
fn acceleration_m_s2(trial: usize, t_s: f64) -> [f64; 3] {
    let places = [(t_s / 30.0) as usize, trial, (t_s / 30.0) as usize * trial];
    let axis = places.iter().sum::<usize>() % 3;
    std::array::from_fn(|own| if own == axis { 9.81 - 19.62 * (places[0] / 3 % 2) as f64 } else { 0.0 })
}

/// Rows of the samples and of the reference of all trials, each of which begins at 0 s; `added_deg_s` is an effect.
fn trials(added_deg_s: impl Fn(usize, f64, [f64; 3]) -> [f64; 3]) -> (String, String) {
    let mut link = "trial,t,X,Y,Z\n".to_owned();
    let mut reference = "trial,t_s,wx_deg_s,wy_deg_s,wz_deg_s,ax_m_s2,ay_m_s2,az_m_s2\n".to_owned();
    for (trial, drifts) in DRIFTS_DEG_H.iter().enumerate() {
        for number in 1..=180 * RATE_HZ {
            let t_s = number as f64 / RATE_HZ as f64;
            let rates: [f64; 3] = std::array::from_fn(|axis| {
                let wave = |wave: usize| {
                    let hz = 0.05 + 0.07 * (3 * wave + axis) as f64 + 0.0113 * (wave * wave + trial) as f64;
                    15.0 * (std::f64::consts::TAU * hz * t_s + (axis + 2 * wave) as f64).sin()
                };
                (0..4).map(wave).sum()
            });
            let added = added_deg_s(trial, t_s, rates);
            let [x, y, z]: [f64; 3] = std::array::from_fn(|axis| {
                let noise = noise_deg_s(3 * (trial * 100_000 + number) + axis);
                rates[axis] + added[axis] - drifts[axis] / 3600.0 + noise
            });
            link.push_str(&format!("run {trial},{t_s:.2},{x:.6},{y:.6},{z:.6}\n"));
            let [x, y, z] = rates;
            let [along_x, along_y, along_z] = acceleration_m_s2(trial, t_s);
            reference.push_str(&format!("run {trial},{t_s:.2},{x},{y},{z},{along_x},{along_y},{along_z}\n"));
        }
    }
    (link, reference)
}

#[test]
fn drifts_of_trials_are_no_effect_and_an_effect_beside_them_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let diagnosed = |(link, reference): (String, String)| {
        run(folder.path(), "diagnose", [&description("group = \"trial\"\n"), &link, &reference])
    };
    let missing = |found: &Value| -> Vec<(String, Value)> {
        let effects = found["effects"].as_array().expect("effects").iter();
        let missing = effects.filter(|own| own["class"] == "missing-effect");
        missing.map(|own| (own["code"].as_str().expect("a code").to_owned(), own["gyros"].clone())).collect()
    };
    let (code, found, message) = diagnosed(trials(|_, _, _| [0.0; 3]));
    assert_eq!((code, found["verdict"].as_str()), (Some(0), Some("consistent")), "{message}{found:#}");
    assert_eq!(missing(&found), []);
    let drifts = found["findings"].as_array().expect("findings").iter().filter(|own| own["kind"] == "trial-drift");
    let texts: Vec<&str> = drifts.map(|own| own["text"].as_str().expect("a text")).collect();
    assert_eq!(texts.len(), TRIALS - 1);
    for (text, drifts) in texts.iter().zip(&DRIFTS_DEG_H[1..]) {
        let values: Vec<&str> = text.split("deg/h: ").nth(1).expect("values").split(", ").collect();
        for (axis, value) in values.into_iter().enumerate() {
            let words: Vec<f64> = value.split(' ').filter_map(|word| word.parse().ok()).collect();
            let off = words[0] - (drifts[axis] - DRIFTS_DEG_H[0][axis]);
            assert!(off.abs() < 4.0 * words[1] && words[1] < 8.0, "{text}");
        }
    }
    // 120 deg/h from 60 s of the third trial on.
    let step = |trial, t_s, _: [f64; 3]| [0.0, if trial == 2 && t_s > 60.0 { -120.0 / 3600.0 } else { 0.0 }, 0.0];
    let (_, found, _) = diagnosed(trials(step));
    let named = missing(&found);
    assert!(
        named.len() == 1 && named[0].0.starts_with("drift-") && named[0].1 == serde_json::json!(["Y"]),
        "{found:#}"
    );
    let asymmetry = |_, _, rates: [f64; 3]| [2e-3 * rates[0].abs(), 0.0, 0.0];
    let (_, found, _) = diagnosed(trials(asymmetry));
    assert_eq!(missing(&found), [("scale-factor-asymmetry".to_owned(), serde_json::json!(["X"]))], "{found:#}");
}

#[test]
fn a_drift_by_an_acceleration_is_stated_with_its_value() {
    let folder = tempfile::tempdir().expect("a folder");
    // 12 deg/h per m/s² along Z on X; a positive drift makes the measured angle smaller.
    let (link, reference) = trials(|trial, t_s, _| [-12.0 / 3600.0 * acceleration_m_s2(trial, t_s)[2], 0.0, 0.0]);
    let texts = [&description("group = \"trial\"\n"), &link[..], &reference[..]];
    let (_, found, message) = run(folder.path(), "diagnose", texts);
    assert_eq!(found["verdict"], "explained", "{message}{found:#}");
    let findings = found["findings"].as_array().expect("findings").iter();
    let own: Vec<&Value> = findings.filter(|own| own["kind"] == "drift-acceleration").collect();
    let text = own[0]["text"].as_str().expect("a text");
    let words: Vec<&str> = text.split("per m/s2: ").nth(1).expect("values").split(' ').collect();
    let [value, sigma] = [words[0], words[2]].map(|number| number.parse::<f64>().expect("a number"));
    assert!((value - 12.0).abs() < 4.0 * sigma && sigma < 1.0 && text.contains("along Z: subtracted"), "{text}");
    assert!(own.len() == 1 && own[0]["place"] == "X", "{found:#}");
}

#[test]
fn a_calibration_of_trials_states_the_drift_of_each() {
    let folder = tempfile::tempdir().expect("a folder");
    let (link, reference) = trials(|_, _, [x, _, _]| [1e-3 * x, 0.0, 0.0]);
    let texts = [&description("group = \"trial\"\n"), &link[..], &reference[..]];
    let (code, found, message) = run(folder.path(), "calibrate", texts);
    assert_eq!(code, Some(0), "{message}");
    let within = |found: &Value, truth: f64| {
        let [value, sigma] = ["value", "sigma"].map(|key| found[key].as_f64().expect("a number"));
        assert!((value - truth).abs() < 4.0 * sigma, "{value} ± {sigma}, expected {truth}");
        sigma
    };
    assert!(within(&found["gyros"]["X"]["scale_factor"], 1.0 / 1.001) < 1e-4);
    // arcsec in half a second per deg/h.
    let unit = 3600.0 / 7200.0;
    for (axis, head) in ["X", "Y", "Z"].into_iter().enumerate() {
        within(&found["gyros"][head]["drift_arcsec_per_half_s"], unit * DRIFTS_DEG_H[0][axis]);
        for (further, drifts) in DRIFTS_DEG_H.iter().enumerate().skip(1) {
            let own = &found["further_trials"][further - 1];
            assert_eq!(own["trial"], format!("run {further}"));
            let sigma = within(&own["drift_arcsec_per_half_s"][head], unit * (drifts[axis] - DRIFTS_DEG_H[0][axis]));
            assert!(sigma < unit * 12.0, "{sigma}");
        }
    }
}

#[test]
fn known_turns_calibrate_a_unit_and_do_not_diagnose_it() {
    let (mut link, mut rows, mut t_s, mut number) = ("t,X,Y,Z\n".to_owned(), String::new(), 0.0, 0);
    // The rate rises and falls in a second each.
    let mut last = |deg: f64, axis: usize, length_s: f64| {
        let samples = (length_s * RATE_HZ as f64) as usize;
        let shape = |own: usize| (own.min(samples - 1 - own) as f64 / RATE_HZ as f64).min(1.0);
        let sum: f64 = (0..samples).map(shape).sum();
        for own in 0..samples {
            number += 1;
            let mut rates: [f64; 3] = std::array::from_fn(|axis| noise_deg_s(3 * number + axis));
            rates[axis] += if deg == 0.0 { 0.0 } else { 1.001 * deg * shape(own) / sum * RATE_HZ as f64 };
            rates[2] -= 30.0 / 3600.0;
            let [x, y, z] = rates;
            link.push_str(&format!("{:.2},{x:.6},{y:.6},{z:.6}\n", t_s + (own + 1) as f64 / RATE_HZ as f64));
        }
        let mut turned = [0.0; 3];
        turned[axis] = deg;
        let [x, y, z] = turned;
        // Not all turns are stated.
        if number % 7 != 0 {
            rows.push_str(&format!("{t_s:.2},{:.2},{x},{y},{z},0.001\n", t_s + length_s));
        }
        t_s += length_s;
    };
    for turn in 0..24 {
        last(0.0, 0, 15.0);
        last([90.0, -180.0, 360.0, -270.0, 135.0][turn % 5], turn % 3, 12.0);
    }
    last(0.0, 0, 15.0);
    let reference = format!("start_s,end_s,angle_x_deg,angle_y_deg,angle_z_deg,sigma_deg\n{rows}");
    assert!(rows.lines().count() < 48, "a gap");
    let folder = tempfile::tempdir().expect("a folder");
    let texts = [&description(""), &link[..], &reference[..]];
    let (code, found, message) = run(folder.path(), "calibrate", texts);
    assert_eq!(code, Some(0), "{message}");
    for (head, drift_deg_h) in [("X", 0.0), ("Y", 0.0), ("Z", 30.0)] {
        let own = &found["gyros"][head];
        for (value, truth, most) in
            [(&own["scale_factor"], 1.0 / 1.001, 3e-4), (&own["drift_arcsec_per_half_s"], drift_deg_h * 0.5, 3.0)]
        {
            let [value, sigma] = ["value", "sigma"].map(|key| value[key].as_f64().expect("a number"));
            assert!((value - truth).abs() < 4.0 * sigma && sigma < most, "{head}: {value} ± {sigma}, expected {truth}");
        }
    }
    let (code, _, message) = run(folder.path(), "diagnose", texts);
    assert_eq!(code, Some(2));
    assert!(message.contains("expected rows of rates or turns of at most 2 s, which show the motion"), "{message}");
}
