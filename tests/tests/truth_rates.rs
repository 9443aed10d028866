//! Rates beyond the range of a gyro, from a simulator and from a file: clipped and flagged; and the limit beyond which a turn
//! is none.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::Output;

use geu_tests::geu;
use geu_tests::simulator::{Simulated, about_x};

/// GYRX and the gyros' flags of every sample that a recording has.
fn decoded(link: &Path) -> Vec<(i32, u32)> {
    let output: Output = geu().arg("decode").arg(link).output().expect("geu starts");
    let text = String::from_utf8(output.stdout).expect("text");
    let row = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        (fields[3].parse().expect("GYRX"), fields[7].parse().expect("flags"))
    };
    text.lines().skip(1).map(row).collect()
}

/// 30°/s about X: 54 000″ in half a second, while a count ends at 32 767.
const ARCSEC_S: f64 = 108_000.0;
const GYRX_VALID: u32 = 0x01;
const GYRX_SATURATED: u32 = 0x10;

fn link_of(run: &Path) -> std::path::PathBuf {
    ["link.log", "link.bin"].map(|name| run.join(name)).into_iter().find(|path| path.exists()).expect("a link")
}

#[test]
fn a_simulator_that_turns_faster_than_the_range_saturates_the_gyro() {
    let directory = tempfile::tempdir().expect("a directory");
    let run = directory.path().join("run");
    let record = run.to_str().expect("UTF-8");
    let simulated = Simulated::start(&["--speed", "max", "--duration", "10", "--record", record]);
    (0..=20).for_each(|half| simulated.send(&about_x(f64::from(half) * 0.5, ARCSEC_S * 0.5 * f64::from(half))));
    let (code, said, _) = simulated.end();
    assert!(code == Some(0) && said.contains("jumps 0,"), "{said}");
    let rows = decoded(&link_of(&run));
    assert_eq!(rows.len(), 20);
    let is_clipped = |&(counts, flags): &(i32, u32)| {
        counts == 32_767 && flags & (GYRX_VALID | GYRX_SATURATED) == GYRX_VALID | GYRX_SATURATED
    };
    assert!(rows.iter().all(is_clipped), "{rows:?}");
}

#[test]
fn a_limit_that_is_configured_holds_and_the_run_says_that_it_jumped() {
    let simulated = Simulated::start(&["--speed", "max", "--duration", "2", "--set", "truth.max_rate_deg_s=20"]);
    (0..=4).for_each(|half| simulated.send(&about_x(f64::from(half) * 0.5, ARCSEC_S * 0.5 * f64::from(half))));
    let (code, said, _) = simulated.end();
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("by 30.0°/s for 0.500 s; expected 20°/s at most (truth.max_rate_deg_s)"), "{said}");
    assert!(said.contains("jumps 4,"), "{said}");
}

#[test]
fn a_reference_that_turns_faster_than_the_range_saturates_the_gyro_too() {
    let directory = tempfile::tempdir().expect("a directory");
    let (file, run) = (directory.path().join("reference.csv"), directory.path().join("run"));
    let mut text = "t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s\n".to_owned();
    (1..=20).for_each(|half| writeln!(text, "{},{ARCSEC_S},0,0", f64::from(half) * 0.5).expect("a string"));
    fs::write(&file, text).expect("written");
    let output = geu().arg("simulate").arg("--truth").arg(&file).arg("--out").arg(&run).output().expect("geu starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let rows = decoded(&link_of(&run));
    assert!(rows.len() >= 19 && rows.iter().all(|row| row.0 == 32_767 && row.1 & GYRX_SATURATED != 0), "{rows:?}");
}
