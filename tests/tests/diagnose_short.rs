//! `geu diagnose` on a quarter of an hour, which does not tell all of the sixteen; and a result that cannot be written.

use geu_tests::geu;
use serde_json::Value;

#[test]
fn what_a_short_recording_does_not_tell_stays_as_believed() {
    let room = tempfile::tempdir().expect("a directory");
    let at = |name: &str| room.path().join(name).display().to_string();
    let hidden = "gyro.GYRX.pivot-clearance.clearance_arcsec=11.5";
    let simulated = geu().args(["simulate", "--duration", "900", "--set", hidden, "--out", &at("run")]).output();
    assert!(simulated.expect("geu starts").status.success());
    let [link, reference, json] = ["run/link.log", "run/reference.csv", "said.json"].map(at);
    // Opens, and then has no room.
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
    // What was found is told and written, though two files cannot be.
    let (report, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(1), "{report}{errors}");
    assert!(report.starts_with("explained: "), "{report}");
    assert_eq!(errors.matches("/dev/full: cannot be written").count(), 2, "{errors}");
    let said: Value = serde_json::from_str(&std::fs::read_to_string(&json).expect("written")).expect("JSON");
    let [found] = &said["effects"].as_array().expect("a list")[..] else { panic!("{report}") };
    assert_eq!((&found["code"], &found["gyros"][0]), (&"pivot-clearance".into(), &"GYRX".into()), "{report}");
    // One draw of the noise, always the same: three sigma; a sigma of 0.2 arcsec is a sixtieth of what is hidden.
    let number = |name: &str| found["parameters"]["clearance_arcsec"][name].as_f64().expect("a number");
    assert!((number("value") - 11.5).abs() < 3.0 * number("sigma") && number("sigma") < 0.2, "{report}");
    let left = said["gap"]["after"]["fitted"]["rms_arcsec"].as_f64().expect("a number");
    // 0.41 are rounding at both ends, 0.21 the angle's walk in a quarter of an hour; a third more for what was refitted.
    assert!(left < 0.6, "{report}");
}
