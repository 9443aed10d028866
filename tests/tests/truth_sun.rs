//! The direction to the sun in a truth from a simulator: sun sensor, thermal misalignment and conditions on θ follow it, live
//! and in the run that is made again.

use std::fs;
use std::path::Path;

use geu_tests::geu;
use geu_tests::simulator::Simulated;

/// A body that turns about +Y from where the sun stands on +Z, a line each sample.
fn scan(simulated: &Simulated, sun: &str) {
    for half in 0..=40 {
        let t_s = f64::from(half) * 0.5;
        let half_rad = (0.5 * t_s).to_radians() / 2.0;
        let (sin, cos) = half_rad.sin_cos();
        simulated.send(&format!("{{\"t_s\": {t_s}, \"q\": [{cos}, 0, {sin}, 0]{sun}}}\n"));
    }
}

fn rows(file: &Path) -> Vec<Vec<f64>> {
    let text = fs::read_to_string(file).expect("a file");
    let number = |field: &str| field.parse().unwrap_or(f64::NAN);
    text.lines().skip(1).map(|line| line.split(',').map(number).collect()).collect()
}

#[test]
fn the_sun_is_seen_turns_the_package_and_meets_conditions_live_and_again() {
    let directory = tempfile::tempdir().expect("a directory");
    let (plan, run, again) =
        (directory.path().join("plan.toml"), directory.path().join("run"), directory.path().join("again"));
    let text = "[[fault]]\nid = \"hot\"\nfault = \"stuck-count\"\ngyro = \"GYRZB\"\ncounts = 7\nwhen = \"theta_deg > 95\"\nfor_s = 1.0\n";
    fs::write(&plan, text).expect("written");
    let thermal = "unit.misalignment-thermal.arcsec_per_deg=60";
    let arguments = ["--speed", "max", "--duration", "20", "--set", thermal, "--faults", plan.to_str().expect("UTF-8")];
    let record = ["--record", run.to_str().expect("UTF-8")];
    let simulated = Simulated::start(&[&arguments[..], &record].concat());
    scan(&simulated, ", \"sun\": [0, 0, 1]");
    let (code, said, _) = simulated.end();
    assert_eq!(code, Some(0), "{said}");
    // 0.5°/s about Y from θ = 90°: 95° is passed after 10 s.
    let faults = fs::read_to_string(run.join("faults.jsonl")).expect("a file");
    assert!(faults.contains("\"hot\"") && !said.contains("never started"), "the condition held: {said}");

    let header = fs::read_to_string(run.join("reference.csv")).expect("a file");
    assert!(header.starts_with("t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s,theta_deg,psi_deg\n"), "{header}");
    for row in rows(&run.join("reference.csv")) {
        assert!((row[4] - (90.0 + 0.5 * row[0])).abs() < 1e-6, "{row:?}");
    }
    let seen = rows(&run.join("fss.csv"));
    assert!(seen.len() >= 39, "{}", seen.len());
    for row in &seen {
        // Steps of 4″.
        assert!((row[1] - (90.0 + 0.5 * row[0]) * 3600.0).abs() <= 2.01 && row[2] == 0.0, "{row:?}");
    }
    let received = fs::read_to_string(run.join("received.csv")).expect("a file");
    assert!(
        received
            .lines()
            .next()
            .is_some_and(|line| line.ends_with(",basis,theta_rad,psi_rad,turn_x_arcsec,turn_y_arcsec"))
    );
    let truth = fs::read_to_string(run.join("truth.csv")).expect("a file");
    let place =
        truth.lines().next().expect("a header").split(',').position(|name| name == "misalignment-thermal_counts");
    let turned = |line: &str| line.split(',').nth(place.expect("a column")).and_then(|field| field.parse::<f64>().ok());
    let of_y = truth.lines().filter(|line| line.contains(",GYRY,")).filter_map(turned);
    // 60″ a degree over 10° with a lag of 300 s: some arcseconds by the end.
    assert!(of_y.sum::<f64>().abs() > 5.0);

    let output = geu().arg("simulate").arg(run.join("run.toml")).arg("--out").arg(&again).output().expect("geu starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    for name in ["received.csv", "truth.csv", "reference.csv", "fss.csv", "faults.jsonl", "run.toml"] {
        assert!(fs::read(run.join(name)).expect(name) == fs::read(again.join(name)).expect(name), "{name} differs");
    }
}

#[test]
fn a_condition_on_an_unavailable_sun_is_refused_and_bad_sun_vectors_are_counted() {
    let directory = tempfile::tempdir().expect("a directory");
    let plan = directory.path().join("plan.toml");
    fs::write(&plan, "[[fault]]\nfault = \"dead\"\ngyro = \"GYRX\"\nwhen = \"theta_deg > 95\"\n").expect("written");
    let simulated = Simulated::start(&["--speed", "max", "--duration", "5", "--faults", plan.to_str().expect("UTF-8")]);
    scan(&simulated, "");
    let (code, said, _) = simulated.end();
    assert_eq!(code, Some(2), "{said}");
    assert!(
        said.contains("theta_deg is not available from the truth of this run") && said.contains("\"sun\": [x, y, z]"),
        "{said}"
    );

    let simulated = Simulated::start(&["--speed", "max", "--truth-wait", "1", "--duration", "5"]);
    scan(&simulated, ", \"sun\": [0, 0, 2]");
    let (code, said, _) = simulated.end();
    assert!(code == Some(1) && said.contains("bad lines 41"), "{said}");
    assert!(said.contains("sun: expected [x, y, z] of length 1, got [0,0,2]"), "{said}");
}
