//! Calibration of described units on recordings of the independent model, and on a table of one axis.

use std::fs;
use std::path::Path;
use std::process::Output;

use geu_plant::{Case, DeviceMotionKind, DevicePlant, DeviceUnit, HeadTruth, Mix};
use geu_tests::geu;
use serde_json::Value;

const ARCSEC_PER_RAD: f64 = 648_000.0 / std::f64::consts::PI;
/// Sigmas within which a parameter lies; more for a drift, since the sigmas do not contain its flicker.
const WITHIN: f64 = 4.0;
const DRIFT_WITHIN: f64 = 8.0;

fn calibrate(device: &str, link: &Path, reference: &Path, further: &[&str]) -> Output {
    let inputs = ["--link".as_ref(), link.as_os_str(), "--reference".as_ref(), reference.as_os_str()];
    geu().args(["calibrate", "--device", device]).args(inputs).args(further).output().expect("geu starts")
}

fn json(file: &Path, output: &Output) -> Value {
    let text = fs::read_to_string(file).unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&output.stderr)));
    serde_json::from_str(&text).expect("JSON")
}

/// Value less truth in sigmas.
fn sigmas(found: &Value, truth: f64) -> f64 {
    let of = |key: &str| found[key].as_f64().unwrap_or_else(|| panic!("{key} of {found}"));
    (of("value") - truth) / of("sigma")
}

/// Compares a head with its truth: the input axis of the result has the length 1 along the nominal axis.
fn compare(name: &str, found: &Value, nominal: [f64; 3], truth: &HeadTruth) {
    let length = nominal.iter().map(|part| part * part).sum::<f64>().sqrt();
    let nominal = nominal.map(|part| part / length);
    let along: f64 = nominal.iter().zip(truth.input).map(|(a, b)| a * b).sum();
    let scale_factor = sigmas(&found["scale_factor"], (1.0 + truth.scale_factor_ppm * 1e-6) / along);
    assert!(scale_factor.abs() < WITHIN, "{name}: scale factor off by {scale_factor} sigma");
    let drift = sigmas(&found["drift_arcsec_per_half_s"], truth.drift_arcsec_h / 7200.0 / along);
    assert!(drift.abs() < DRIFT_WITHIN, "{name}: drift off by {drift} sigma");
    for (axis, own) in found["misalignment_arcsec"].as_object().expect("misalignments") {
        let index = "xyz".find(axis.as_str()).expect("an axis");
        let off = sigmas(own, (truth.input[index] / along - nominal[index]) * ARCSEC_PER_RAD);
        assert!(off.abs() < WITHIN, "{name}: misalignment {axis} off by {off} sigma");
    }
}

#[test]
fn all_parameters_of_described_units_are_solved() {
    for (name, motion, angle) in [
        ("tetrad", DeviceMotionKind::Hand, "arcsec"),
        ("tetrad", DeviceMotionKind::Table, "arcsec"),
        ("stim300", DeviceMotionKind::Hand, "deg"),
        ("mm5.10", DeviceMotionKind::Table, "deg"),
    ] {
        let unit = DeviceUnit::all().into_iter().find(|own| own.name == name).expect("a unit");
        let Case { plant, .. } = Case::drawn(&unit, Mix::Effects, 2, 0, Some(motion), Some(600.0));
        let recording = DevicePlant { effects: Vec::new(), ..plant }.record(false);
        let folder = tempfile::tempdir().expect("a folder");
        let [link, reference, file, out] =
            ["link", "reference.csv", "out.json", "out.toml"].map(|name| folder.path().join(name));
        fs::write(&link, &recording.link).expect("written");
        fs::write(&reference, &recording.reference).expect("written");
        let results = ["--json", file.to_str().expect("a path"), "--out", out.to_str().expect("a path")];
        let output = calibrate(name, &link, &reference, &results);
        let found = json(&file, &output);
        assert_eq!(output.status.code(), Some(0), "{name}");
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(text.contains(&format!(" {angle}/h ")) && text.contains(&format!(" {angle}/√s")), "{text}");
        assert_eq!(found["undetermined"], Value::Array(Vec::new()), "{name}");
        for ((head, nominal), truth) in unit.heads.iter().zip(&recording.heads) {
            compare(&format!("{name} {head}"), &found["gyros"][*head], *nominal, truth);
        }
        let parity = found["parity"].as_array().expect("residuals");
        assert_eq!(parity.len(), unit.heads.len().saturating_sub(3), "{name}");
        for own in parity {
            let [rms, sigma] = ["rms_arcsec", "sigma_arcsec"].map(|key| own[key].as_f64().expect("a number"));
            assert!((0.4..1.2).contains(&(rms / sigma)), "{name}: {own}");
        }
        // The written configuration is valid for the unit and has the values.
        let checked = geu().args(["config", "check"]).arg(&out).output().expect("geu starts");
        assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stderr));
        let text = fs::read_to_string(&out).expect("written");
        assert!(text.contains("scale_factor"), "{text}");
    }
}

/// A table of two heads, which turns about X alone.
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
[[device.head]]
name = "B"
input = [0.0, 1.0, 0.0]
[device.table]
time = { column = "t", unit = "s" }
fields = [{ column = "a", head = "A", unit = "deg/s" }, { column = "b", head = "B", unit = "deg/s" }]
"#;

#[test]
fn a_motion_about_one_axis_determines_what_it_can() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        let file = folder.path().join(name);
        fs::write(&file, text).expect("written");
        file
    };
    let (mut rows, mut turned) = ("t,a,b\n".to_owned(), "t_s,rate_x_deg_s,rate_y_deg_s,rate_z_deg_s\n".to_owned());
    let mut late = turned.clone();
    for row in 1..6000 {
        let (t_s, rate) = (f64::from(row) * 0.1, 5.0 * (f64::from(row) / 40.0).sin());
        // Scale factors of 1.01, B with a tenth of a degree of misalignment, noise as of a MEMS gyro.
        let noise = |factor: f64| 0.01 * ((f64::from(row) * factor).sin() * 43_758.545_3).fract();
        rows.push_str(&format!("{t_s:.1},{},{}\n", rate / 1.01 + noise(12.9898), rate * 0.1 / 57.3 + noise(78.233)));
        turned.push_str(&format!("{t_s:.1},{rate},0,0\n"));
        late.push_str(&format!("{:.1},{rate},0,0\n", t_s + 1e5));
    }
    let (device, link) = (write("unit.toml", TABLE), write("link.csv", &rows));
    let (device, file) = (device.to_str().expect("a path"), folder.path().join("out.json"));
    let results = ["--json", file.to_str().expect("a path")];
    let output = calibrate(device, &link, &write("reference.csv", &turned), &results);
    let found = json(&file, &output);
    let open = ["A misalignment y", "A misalignment z", "B scale factor", "B misalignment z"];
    assert_eq!(found["undetermined"], Value::from(open.to_vec()));
    assert!(sigmas(&found["gyros"]["A"]["scale_factor"], 1.01).abs() < WITHIN, "{found}");
    assert!(sigmas(&found["gyros"]["B"]["misalignment_arcsec"]["x"], 360.0).abs() < WITHIN, "{found}");
    assert_eq!(found["gyros"]["B"]["scale_factor"], serde_json::json!({ "value": null, "sigma": null }));
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(
        text.contains("the motion does not determine A misalignment y, A misalignment z, B scale factor"),
        "{text}"
    );

    let refused = |reference: &str, link: &Path, further: &[&str]| {
        let output = calibrate(device, link, &write("reference.csv", reference), further);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let text = refused(&late, &link, &[]);
    assert!(text.contains("link.csv: the recording (") && text.contains("in common"), "{text}");
    let text = refused(&turned, &write("empty.csv", ""), &[]);
    assert!(text.contains("empty.csv: is empty"), "{text}");
    let text = refused(&turned, &link, &["--compare", "earlier.json"]);
    assert!(text.contains("--compare: expected the default unit"), "{text}");
}
