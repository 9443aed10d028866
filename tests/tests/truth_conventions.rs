//! The worked examples of docs/truth.md, evaluated: frames and signs of `q` and of an attitude ephemeris, equation 3.

use std::fs;
use std::path::Path;

use geu_model::Configuration;
use geu_model::units::ARCSEC_PER_RAD;
use geu_tests::simulator::Simulated;
use geu_tests::{geu, root};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

const LINE: &str = r#"{"t_s": 10.0, "q": [0.9999619230641713, 0.0, 0.0, 0.008726535498373935]}"#;
const EPHEMERIS_LINE: &str = "2026-01-01T00:00:10 0.0 0.0 0.008726535498373935 0.9999619230641713";

fn docs() -> String {
    fs::read_to_string(root().join("docs/truth.md")).expect("the page")
}

/// Half of the angle about +Z at `t_s`: 1° in ten seconds.
fn half_rad(t_s: f64) -> f64 {
    (0.1 * t_s).to_radians() / 2.0
}

/// A unit without drift and with scale factor 1.
fn neutral(directory: &Path) -> String {
    let file = directory.join("neutral.toml");
    fs::write(&file, "seed = 1\n").expect("written");
    file.display().to_string()
}

/// Accumulated counts of each gyro of a run.
fn counted(run: &Path) -> [i64; 4] {
    let text = fs::read_to_string(run.join("truth.csv")).expect("a truth");
    ["GYRX", "GYRY", "GYRZA", "GYRZB"].map(|gyro| {
        let rows = text.lines().filter(|line| line.contains(&format!(",{gyro},")));
        rows.map(|line| line.rsplit(',').next().and_then(|count| count.parse::<i64>().ok()).expect("a count")).sum()
    })
}

#[test]
fn the_line_of_the_docs_turns_the_unit_by_one_degree_about_plus_z() {
    assert!(docs().contains(LINE));
    let directory = tempfile::tempdir().expect("a directory");
    let run = directory.path().join("run");
    let record = run.to_str().expect("UTF-8");
    let simulated =
        Simulated::start(&["--speed", "max", "--duration", "10", "--record", record, &neutral(directory.path())]);
    for t_s in 0..10 {
        let (sin, cos) = half_rad(f64::from(t_s)).sin_cos();
        simulated.send(&format!("{{\"t_s\": {t_s}, \"q\": [{cos}, 0, 0, {sin}]}}\n"));
    }
    simulated.send(LINE);
    let (code, said, _) = simulated.end();
    assert_eq!(code, Some(0), "{said}");
    assert_eq!(counted(&run), [0, 0, 3600, 3600]);
    // And the boresight points where the page says: the line's own numbers.
    let attitude = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 2.0 * half_rad(10.0));
    let (sin, cos) = 1_f64.to_radians().sin_cos();
    assert!((attitude * Vector3::x() - Vector3::new(cos, sin, 0.0)).norm() < 1e-12);
    assert!((attitude.w - 0.999_961_923_064_171_3).abs() + (attitude.k - 0.008_726_535_498_373_935).abs() < 1e-12);
    // Modified Rodrigues parameters: σ = e tan(Φ/4).
    let sigma = (half_rad(10.0) / 2.0).tan();
    let square = 1.0 + sigma * sigma;
    assert!(((2.0 - square) / square - attitude.w).abs() + (2.0 * sigma / square - attitude.k).abs() < 1e-12);
}

#[test]
fn the_same_line_of_an_ephemeris_does_and_the_other_direction_is_the_conjugate() {
    assert!(docs().contains(EPHEMERIS_LINE));
    let directory = tempfile::tempdir().expect("a directory");
    for (direction, sign) in [("A2B", 1.0), ("B2A", -1.0)] {
        let (file, run) = (directory.path().join(direction), directory.path().join(format!("run-{direction}")));
        let mut text = format!(
            "CCSDS_AEM_VERS = 1.0\nCREATION_DATE = 2026-01-01T00:00:00\nORIGINATOR = TEST\nMETA_START\nOBJECT_NAME = GEU\nOBJECT_ID = 1983-004A\nREF_FRAME_A = EME2000\nREF_FRAME_B = SC_BODY_1\nATTITUDE_DIR = {direction}\nTIME_SYSTEM = UTC\nSTART_TIME = 2026-01-01T00:00:00\nSTOP_TIME = 2026-01-01T00:00:10\nATTITUDE_TYPE = QUATERNION\nQUATERNION_TYPE = LAST\nMETA_STOP\nDATA_START\n"
        );
        for t_s in 0..10 {
            let (sin, cos) = half_rad(f64::from(t_s)).sin_cos();
            text += &format!("2026-01-01T00:00:{t_s:02} 0.0 0.0 {} {cos}\n", sign * sin);
        }
        let last = EPHEMERIS_LINE.replace(" 0.0087", if sign < 0.0 { " -0.0087" } else { " 0.0087" });
        fs::write(&file, text + &last + "\nDATA_STOP\n").expect("written");
        let mut command = geu();
        command.arg("simulate").arg(neutral(directory.path())).arg("--truth").arg(&file).arg("--out").arg(&run);
        let output = command.output().expect("geu starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(counted(&run), [0, 0, 3600, 3600], "{direction}");
    }
}

#[test]
fn the_numbers_of_equation_3_are_those_of_the_page() {
    assert!(docs().contains("Δφ = 100.370, −50.140, 200.204") && docs().contains("a = 100.330, −50.070, 200.182"));
    let gyros = Configuration::reference().gyros;
    let of = |gyro: usize| &gyros[gyro].calibration;
    let counts = [100.0, -50.0, 200.0];
    let a = Vector3::from_fn(|gyro, _| counts[gyro] * of(gyro).scale_factor + of(gyro).drift_arcsec_per_half_s);
    let matrix = Matrix3::from_fn(|gyro, axis| {
        let own = of(gyro);
        if gyro == axis { 1.0 } else { [own.x_arcsec, own.y_arcsec, own.z_arcsec][axis] / ARCSEC_PER_RAD }
    });
    let angles = matrix.try_inverse().expect("regular") * a;
    assert!((a - Vector3::new(100.330, -50.070, 200.182)).abs().max() < 0.0005, "{a}");
    assert!((angles - Vector3::new(100.370, -50.140, 200.204)).abs().max() < 0.0005, "{angles}");
}
