//! `geu track`: its attitude against the simulated one, the redundant pair with an injected drift, lost samples, and refused
//! input.

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Output, Stdio};

use geu_tests::geu;
use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

fn run(arguments: &[&str]) -> Output {
    geu().args(arguments).output().expect("geu starts")
}

fn simulate(arguments: &[&str], out: &Path) {
    let output = geu().arg("simulate").args(arguments).arg("--out").arg(out).output().expect("geu starts");
    assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
}

fn path(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The columns of that name, a row per line.
fn columns<const N: usize>(text: &str, names: [&str; N]) -> Vec<[String; N]> {
    let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = lines.next().expect("a header");
    let at = names.map(|name| header.iter().position(|column| *column == name).expect(name));
    lines.map(|row| at.map(|column| row[column].to_owned())).collect()
}

fn numbers<const N: usize>(fields: &[String; N]) -> [f64; N] {
    std::array::from_fn(|index| fields[index].parse().unwrap_or_else(|error| panic!("{}: {error}", fields[index])))
}

/// Control frame to the sun-referenced frame of t = 0, from θ and ψ: the sun and
/// the pole in the control frame and in inertial space.
fn attitude(t_s: f64, theta_deg: f64, psi_deg: f64) -> UnitQuaternion<f64> {
    let triad = |sun: Vector3<f64>, pole: Vector3<f64>| Matrix3::from_columns(&[sun, pole, sun.cross(&pole)]);
    let ((sin_theta, cos_theta), (sin_psi, cos_psi)) =
        (theta_deg.to_radians().sin_cos(), psi_deg.to_radians().sin_cos());
    let sun = Vector3::new(cos_theta, 0.0, sin_theta);
    let pole = Vector3::new(cos_psi * sin_theta, -sin_psi, -cos_psi * cos_theta);
    let passed_rad = t_s * std::f64::consts::TAU / (365.25 * 86_400.0);
    let inertial = triad(Vector3::new(passed_rad.cos(), passed_rad.sin(), 0.0), Vector3::z());
    let matrix = inertial * triad(sun, pole).transpose();
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix))
}

#[test]
fn the_attitude_after_slews_equals_the_simulated_one() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    // A pointing, 150° of scans about Y, and a part of a scan about Z: no limit cycle, which θ and ψ do not contain.
    simulate(&["--duration", "2400", "--set", "scenario.limit_cycle.rate_arcsec_s=0"], temp_dir.path());
    let reference = fs::read_to_string(temp_dir.path().join("reference.csv")).expect("a file");
    let truth = columns(&reference, ["t_s", "theta_deg", "psi_deg"]);
    let start = attitude(0.0, 90.0, 0.0);
    let link = temp_dir.path().join("link.log");
    let start_attitude = format!("{},{},{},{}", start.w, start.i, start.j, start.k);
    for gyros in ["za", "zb", "all"] {
        let output = run(&["track", path(&link), "--gyros", gyros, "--attitude", &start_attitude, "--strict"]);
        assert!(output.status.success(), "{}", stderr(&output));
        let rows = columns(&String::from_utf8_lossy(&output.stdout), ["t_s", "q_w", "q_x", "q_y", "q_z"]);
        assert_eq!((rows.len(), truth.len()), (4800, 4800));
        let mut worst_arcsec: f64 = 0.0;
        for (row, truth) in rows.iter().zip(&truth) {
            let ([t_s, w, x, y, z], [truth_s, theta_deg, psi_deg]) = (numbers(row), numbers(truth));
            assert_eq!(t_s, truth_s);
            let tracked = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
            let error_rad = tracked.angle_to(&attitude(t_s, theta_deg, psi_deg));
            worst_arcsec = worst_arcsec.max(error_rad.to_degrees() * 3600.0);
        }
        // Rounding of three angles, at most 0.9″, and walks of three gyros, 0.9″ of one sigma after 40 min.
        assert!(worst_arcsec < 4.0, "{gyros}: {worst_arcsec}");
    }
}

#[test]
fn a_drift_of_gyrzb_on_a_live_link_is_reported_and_an_interrupt_prints_the_summary() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    let pty = temp_dir.path().join("pty");
    let mut unit = geu()
        .args(["run", "--pty", path(&pty), "--wait", "--speed", "50", "--duration", "100000"])
        .args(["--set", "gyro.GYRZB.drift-step.arcsec_per_h=720", "--set", "gyro.GYRZB.drift-step.time_s=60"])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("geu starts");
    let mut ready = String::new();
    BufReader::new(unit.stdout.take().expect("its output")).read_line(&mut ready).expect("text");
    assert!(ready.starts_with("ready"), "{ready}");
    let mut tracker = geu()
        .args(["track", path(&pty), "--format", "csv"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("geu starts");
    let mut lines = BufReader::new(tracker.stdout.take().expect("its output")).lines().map(|line| line.expect("text"));
    let mut text = lines.by_ref().take(300).collect::<Vec<_>>().join("\n");
    kill(Pid::from_raw(tracker.id() as i32), Signal::SIGINT).expect("a signal");
    text.extend(lines.map(|line| format!("\n{line}")));
    let mut messages = String::new();
    tracker.stderr.take().expect("its errors").read_to_string(&mut messages).expect("text");
    assert!(tracker.wait().expect("its end").success(), "{messages}");
    kill(Pid::from_raw(unit.id() as i32), Signal::SIGINT).expect("a signal");
    unit.wait().expect("its end");
    // 0.1″ every sample from the 120th on.
    let rows = columns(&text, ["valid", "notes"]);
    let first = rows.iter().position(|[_, notes]| notes.contains("GYRZA and GYRZB differ")).expect("an alarm");
    assert!((130..180).contains(&first), "{first}");
    assert!(rows.iter().all(|[valid, _]| valid == "1"), "{messages}");
    for expected in ["GYRZA and GYRZB differ by +", "more than 5 sigma", "samples   ", "alarm"] {
        assert!(messages.contains(expected), "{expected} not in {messages}");
    }
}

#[test]
fn lost_samples_are_reported_with_their_time() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    simulate(&["--duration", "20"], temp_dir.path());
    let log = fs::read_to_string(temp_dir.path().join("link.log")).expect("a file");
    let lines: Vec<&str> = log.lines().collect();
    let cut = temp_dir.path().join("cut.log");
    fs::write(&cut, [&lines[..30], &lines[36..]].concat().join("\n") + "\n").expect("written");
    let output = run(&["track", path(&cut), "--strict"]);
    assert_eq!(output.status.code(), Some(1));
    let messages = stderr(&output);
    let expected = "6.500000 s: 2 samples are missing; the attitude lacks what the unit turned meanwhile";
    for expected in [expected, "samples   38, 2 lost", "--strict: attitude not complete"] {
        assert!(messages.contains(expected), "{expected} not in {messages}");
    }
    let rows = columns(&String::from_utf8_lossy(&output.stdout), ["t_s", "valid", "lost_half_seconds"]);
    assert_eq!(rows[9..11], [["5.000000", "1", "0"], ["6.500000", "0", "2"]]);
}

#[test]
fn bad_input_is_refused_with_one_message() {
    let temp_dir = tempfile::tempdir().expect("a directory");
    simulate(&["--duration", "2"], temp_dir.path());
    let link = temp_dir.path().join("link.log");
    let (json, short) = (temp_dir.path().join("solved.json"), temp_dir.path().join("short.json"));
    fs::write(&json, solved("1.001")).expect("written");
    fs::write(&short, solved("3.0")).expect("written");
    let output = run(&["track", path(&link), "--calibration", path(&json)]);
    assert!(output.status.success(), "{}", stderr(&output));
    let field = "gyros.GYRX.scale_factor.value: expected a number within 0.5…2, got 3.0";
    for (arguments, expected) in [
        (&["--config", path(&short)][..], field),
        (&["--config", path(&json), "--set", "seed=2"], "--set"),
        (&["--config", path(&link)], "expected TOML"),
        (&["--config", "nowhere.toml"], "nowhere.toml: cannot be read"),
        (&["--attitude", "1,1,0,0"], "expected a quaternion of length 1"),
        (&["--out", path(&link)], "expected a file that is not an input"),
    ] {
        let output = run(&[&["track", path(&link)][..], arguments].concat());
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(stderr(&output).contains(expected), "{arguments:?}: {}", stderr(&output));
        assert!(output.stdout.is_empty(), "{arguments:?}");
    }
    assert_eq!(run(&["track", "nowhere0"]).status.code(), Some(2));
}

/// JSON of `geu calibrate --json`.
fn solved(scale_factor: &str) -> String {
    let number = |value: &str| format!(r#"{{"value": {value}, "sigma": 1e-6}}"#);
    let gyro = |(name, [a, b]): (&str, [&str; 2])| {
        let (factor, zero) = (number(scale_factor), number("0.0"));
        format!(
            r#""{name}": {{"scale_factor": {factor}, "drift_arcsec_per_half_s": {zero},
            "misalignment_arcsec": {{"{a}": {zero}, "{b}": {zero}}}}}"#
        )
    };
    let gyros = [("GYRX", ["y", "z"]), ("GYRY", ["x", "z"]), ("GYRZA", ["x", "y"]), ("GYRZB", ["x", "y"])].map(gyro);
    format!(r#"{{"gyros": {{{}}}, "chi2": {{"value": 8.0, "dof": 8}}}}"#, gyros.join(", "))
}

#[test]
fn heads_of_any_directions_turn_as_the_unit_does() {
    let folder = tempfile::tempdir().expect("a directory");
    let (rates_deg_s, duration_s) = (Vector3::<f64>::new(3.0, -2.0, 1.0), 10.0);
    let motion = "[[motion]]\nduration_s = 10.0\nx_deg_s = 3.0\ny_deg_s = -2.0\nz_deg_s = 1.0\n";
    let turned = UnitQuaternion::from_scaled_axis(rates_deg_s * duration_s * std::f64::consts::PI / 180.0);
    let simulated = |device: &str, more: &str, name: &str| {
        let (unit, out) = (folder.path().join(format!("{name}.toml")), folder.path().join(name));
        fs::write(&unit, format!("device = \"{device}\"\n{more}{motion}")).expect("a file");
        simulate(&[path(&unit), "--duration", "10"], &out);
        (path(&out.join("link.bin")).to_owned(), path(&unit).to_owned())
    };
    let track = |link: &str, unit: &str| {
        let output = run(&["track", link, "--config", unit]);
        assert!(output.status.success(), "{}", stderr(&output));
        String::from_utf8(output.stdout.clone()).expect("text")
    };
    let end = |text: &str| {
        let rows = columns(text, ["q_w", "q_x", "q_y", "q_z"]);
        let [w, x, y, z] = numbers(rows.last().expect("a row"));
        UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
    };
    let calibrated = |head: &str| {
        format!("[gyro.{head}]\ncalibration = {{ scale_factor = 1.001, drift_arcsec_per_half_s = 0.3 }}\n")
    };
    for (device, head) in [("stim300", "X"), ("kvh-1750", "Y"), ("tetrad", "C")] {
        let (link, unit) = simulated(device, &calibrated(head), device);
        let error_arcsec = end(&track(&link, &unit)).angle_to(&turned).to_degrees() * 3600.0;
        // Half a count of a rate, 0.11″/s, is up to 1.1″.
        assert!(error_arcsec < 1.2, "{device}: {error_arcsec}\"");
        // Without the calibration the scale factor of one head is missing.
        let output = run(&["track", &link, "--device", device]);
        let text = String::from_utf8(output.stdout.clone()).expect("text");
        let error_arcsec = end(&text).angle_to(&turned).to_degrees() * 3600.0;
        assert!((10.0..400.0).contains(&error_arcsec), "{device}: {error_arcsec}\"");
    }

    // A head is not valid for a second, and a head drifts: three heads determine the attitude, four show the drift.
    let fault = "[[fault]]\nfault = \"flip-flags\"\ngyro_flags = 8\nat_s = 2.0\nfor_s = 1.0\n";
    let (link, unit) = simulated("tetrad", fault, "invalid");
    let text = track(&link, &unit);
    assert!(end(&text).angle_to(&turned).to_degrees() * 3600.0 < 0.2);
    let rows = columns(&text, ["heads", "valid", "notes"]);
    assert_eq!(rows.iter().filter(|row| row[0] == "A B C").count(), 100);
    assert!(rows.iter().all(|row| row[1] == "1" && (row[0] == "A B C") == (row[2] == "D: the count is not valid")));
    let (drifts, _) = simulated("tetrad", "[gyro.B]\ndrift = { arcsec_per_h = 7200.0 }\n", "drifts");
    let output = run(&["track", &drifts, "--device", "tetrad"]);
    let text = String::from_utf8(output.stdout.clone()).expect("text");
    let [_, residual] = columns(&text, ["redundancy_head", "redundancy_arcsec"]).pop().expect("a row");
    // A fourth of the 20" is common to all four heads of a tetrad.
    assert!((residual.parse::<f64>().expect("a number").abs() - 5.0).abs() < 0.1, "{residual}");

    // Missing samples are no part of the attitude.
    let bytes = fs::read(&link).expect("a link");
    let length = bytes.len() / 1000;
    fs::write(&link, [&bytes[..100 * length], &bytes[110 * length..]].concat()).expect("written");
    let output = run(&["track", &link, "--config", &unit, "--strict"]);
    assert!(
        output.status.code() == Some(1) && stderr(&output).contains("10 samples are missing"),
        "{}",
        stderr(&output)
    );
    let text = String::from_utf8(output.stdout.clone()).expect("text");
    assert_eq!(columns(&text, ["valid", "lost_samples"])[100], ["0", "10"]);

    for (arguments, expected) in [
        (&["--device", "mm5.10"][..], "Bosch MM5.10: expected heads about three axes"),
        (&["--device", "kvh-1750"], "expected frames of KVH"),
        (&["--device", "tetrad", "--gyros", "all"], "--gyros: expected the default unit"),
        (&["--device", "tetrad", "--base", "1A0"], "--base: expected none"),
        (&["--device", "stim300", "--config", &unit], "expected a configuration of Safran Sensonor STIM300"),
    ] {
        let output = run(&[&["track", &link][..], arguments].concat());
        assert!(output.status.code() == Some(2), "{arguments:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{arguments:?}: {}", stderr(&output));
    }
}

#[test]
fn an_archive_of_several_files_is_tracked_as_its_recording() {
    let directory = tempfile::tempdir().expect("a directory");
    let (recording, archive) = (directory.path().join("recording"), directory.path().join("archive"));
    // Ten minutes before midnight.
    simulate(&["--duration", "1200", "--start", "1796341800"], &recording);
    let link = recording.join("link.log");
    let decoded = run(&["decode", path(&link), "--format", "parquet", "--partition", path(&archive), "--quiet"]);
    assert!(decoded.status.success(), "{}", stderr(&decoded));
    let tracked = |input: &Path| {
        let output = run(&["track", path(input), "--format", "csv", "--quiet"]);
        assert!(output.status.success(), "{}", stderr(&output));
        output.stdout
    };
    let of_recording = tracked(&link);
    assert_eq!(of_recording.iter().filter(|byte| **byte == b'\n').count(), 2401);
    assert_eq!(tracked(&archive), of_recording);
}
