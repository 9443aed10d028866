//! `geu calibrate` of more than a day: the recording is read in parts.

use std::fs;
use std::path::Path;

use geu_tests::geu;

fn calibrated(directory: &Path, link: &str, name: &str, further: &[&str]) -> serde_json::Value {
    let (link, json) = (directory.join(link), directory.join(name));
    let mut command = geu();
    command.arg("calibrate").arg("--link").arg(link).arg("--reference").arg(directory.join("reference.csv"));
    let output = command.arg("--json").arg(&json).args(further).output().expect("geu starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&fs::read(&json).expect("a result")).expect("JSON")
}

/// Values and sigmas of the parameters.
fn parameters(result: &serde_json::Value) -> Vec<[f64; 2]> {
    let mut found = Vec::new();
    for own in result["gyros"].as_object().expect("gyros").values() {
        let misalignments = own["misalignment_arcsec"].as_object().expect("misalignments").values();
        for parameter in [&own["scale_factor"], &own["drift_arcsec_per_half_s"]].into_iter().chain(misalignments) {
            found.push(["value", "sigma"].map(|key| parameter[key].as_f64().expect("a number")));
        }
    }
    assert_eq!(found.len(), 16);
    found
}

#[test]
fn parts_of_a_day_give_the_calibration_of_the_whole() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    for (wire, link, start) in [("can", "link.log", "1800000000"), ("serial", "link.bin", "0")] {
        let directory = temp_dir.path().join(wire);
        let simulate = ["simulate", "--wire", wire, "--start", start, "--duration", "93600", "--out"];
        let output = geu().args(simulate).arg(&directory).output().expect("geu starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let list = directory.join("manoeuvres.csv").to_str().expect("UTF-8").to_owned();
        let list = ["--manoeuvres", &list];
        // An effect, however small, keeps the recording whole.
        let whole = [&list[..], &["--set", "gyro.GYRX.scale-factor-asymmetry.ppm=1e-9"]].concat();
        let (parts, whole) =
            (calibrated(&directory, link, "parts", &list), calibrated(&directory, link, "whole", &whole));
        let (of_parts, of_whole) = (parameters(&parts), parameters(&whole));
        for ([value, sigma], [of_whole, sigma_of_whole]) in of_parts.iter().zip(&of_whole) {
            assert!((value - of_whole).abs() < 1e-4 * sigma, "{wire}: {value} in place of {of_whole}");
            assert!((sigma / sigma_of_whole - 1.0).abs() < 1e-6, "{wire}: {sigma} in place of {sigma_of_whole}");
        }
        // Without a list the windows end with the parts.
        let alone = calibrated(&directory, link, "alone", &[]);
        assert!(alone["chi2"]["probability"].as_f64().is_some_and(|probability| probability > 1e-3), "{wire}: {alone}");
        for ([value, sigma], [of_list, sigma_of_list]) in parameters(&alone).iter().zip(&of_whole) {
            assert!(
                (value - of_list).abs() < 4.0 * sigma.hypot(*sigma_of_list),
                "{wire}: {value}, by the list {of_list}"
            );
        }
        // The reference is read to its end, a line behind the recording included.
        let reference = directory.join("reference.csv");
        let mut text = fs::read_to_string(&reference).expect("a reference");
        text.push_str("x,0,0,0,90,0\n");
        fs::write(&reference, text).expect("writable");
        let arguments = [directory.join(link), reference].map(|path| path.to_str().expect("UTF-8").to_owned());
        let output = geu().args(["calibrate", "--link", &arguments[0], "--reference", &arguments[1]]).output();
        let output = output.expect("geu starts");
        assert_eq!(output.status.code(), Some(2));
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(
            message.contains("reference.csv") && message.contains("line 187202: t_s: expected a number"),
            "{message}"
        );
    }
}
