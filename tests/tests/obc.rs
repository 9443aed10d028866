//! Closed loops of the small on-board computer and the emulator.

use std::io::{BufRead, BufReader};
use std::process::{Output, Stdio};

use geu_tests::{geu, geu_obc};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

fn run(arguments: &[&str]) -> Output {
    geu_obc().args(arguments).output().expect("geu-obc starts")
}

/// On-board time, true and estimated error of every second, s and arcsec.
fn lines(output: &Output) -> Vec<[f64; 3]> {
    let text = String::from_utf8_lossy(&output.stdout);
    let row = |line: &str| {
        let after = |word: &str| line.split(word).nth(1)?.trim_start().split('″').next()?.parse().ok();
        Some([line.split_whitespace().next()?.parse().ok()?, after("true")?, after("estimated")?])
    };
    text.lines().filter_map(row).collect()
}

#[test]
fn pointing_is_held_and_a_second_run_is_the_same() {
    let directory = tempfile::tempdir().expect("a directory");
    let (first_run, again) = (directory.path().join("run"), directory.path().join("again"));
    let record = first_run.to_str().expect("UTF-8");
    let first = run(&["--duration", "300", "--speed", "max", "--record", record]);
    let stderr = String::from_utf8_lossy(&first.stderr);
    assert_eq!(first.status.code(), Some(0), "{stderr}");
    assert!(stderr.contains("late intervals 0, missing 0, jumps 0, out of order 0, bad lines 0"), "{stderr}");
    let rows = lines(&first);
    assert_eq!(rows.len(), 300);
    // It starts with 12″/s, and returns.
    assert!(rows[4][1] > 30.0 && rows[40..].iter().all(|row| row[1] < 5.0), "{rows:?}");
    assert!(rows.iter().all(|[_, truth, estimated]| (truth - estimated).abs() < 2.0), "{rows:?}");
    assert_eq!(run(&["--duration", "300", "--speed", "max"]).stdout, first.stdout);
    let mut simulate = geu();
    simulate.arg("simulate").arg(first_run.join("run.toml")).arg("--out").arg(&again);
    assert!(simulate.status().expect("geu starts").success());
    let link = |directory: &std::path::Path| std::fs::read(directory.join("link.bin")).expect("a link");
    assert!(link(&first_run) == link(&again) && !link(&first_run).is_empty());
}

#[test]
fn unknown_drift_moves_the_true_pointing_and_is_not_detected_on_board() {
    let sets = ["--set", "gyro.GYRX.drift-step.arcsec_per_h=1800", "--set", "gyro.GYRX.drift-step.time_s=60"];
    let output = run(&[&["--duration", "180", "--speed", "max"], &sets[..]].concat());
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    let rows = lines(&output);
    let [t_s, truth, estimated] = rows[rows.len() - 1];
    // 1800″/h for 120 s is 60″; the loop adds its oscillation.
    assert!(t_s == 180.0 && (truth - 60.0).abs() < 4.0 && estimated < 5.0, "{truth} {estimated}");
    assert!(String::from_utf8_lossy(&output.stdout).contains("pointing not held"));
}

#[test]
fn expectations_of_the_computer_set_exit_code_and_file() {
    let directory = tempfile::tempdir().expect("a directory");
    let file = |name: &str| directory.path().join(name).display().to_string();
    let (plan, verdicts) = (file("plan.toml"), file("verdicts.xml"));
    let text = "[[fault]]\nid = \"late\"\nfault = \"dead\"\ngyro = \"GYRZB\"\nat_s = 9e9\n\n[[expect]]\ncondition = \"command(PING)\"\nwithin_s = 20\n";
    std::fs::write(&plan, text).expect("written");
    let output = run(&["--duration", "60", "--speed", "max", "--faults", &plan, "--junit", &verdicts]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("late: never started (t_s >= 9000000000.0)"), "{stderr}");
    assert!(stderr.contains("1 of 1 expectations were not met"), "{stderr}");
    let stdout = String::from_utf8_lossy(&output.stdout);
    assert!(stdout.contains("pointing held") && stdout.contains("geu run ended with exit code 1"), "{stdout}");
    assert!(std::fs::read_to_string(&verdicts).expect("verdicts").contains("failures=\"1\""));
}

#[test]
fn interrupted_run_reports_it_and_its_recording_is_complete() {
    let directory = tempfile::tempdir().expect("a directory");
    let recording = directory.path().join("run");
    let mut child = geu_obc();
    child.args(["--duration", "3600", "--record"]).arg(&recording).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = child.spawn().expect("geu-obc starts");
    let mut line = String::new();
    BufReader::new(child.stdout.take().expect("a pipe")).read_line(&mut line).expect("a line a second");
    kill(Pid::from_raw(child.id() as i32), Signal::SIGTERM).expect("it runs");
    let ended = child.wait_with_output().expect("it ends");
    let stderr = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("interrupted before 3600 s") && stderr.contains("the pointing is not judged"), "{stderr}");
    let run_toml = std::fs::read_to_string(recording.join("run.toml")).expect("a file");
    assert!(!run_toml.contains("unfinished"), "{run_toml}");
}

#[test]
fn run_that_cannot_start_reports_the_reason() {
    for (arguments, code, part) in [
        (&["--geu", "/nowhere/geu"][..], 2, "--geu: expected the program geu, got /nowhere/geu"),
        (&["--set", "gyro.GYRQ.drift=1"], 2, "geu ended before its link was ready"),
        (&["--duration", "3"], 2, "expected a duration of 41 to 604800 seconds"),
        (&["--link", "127.0.0.1:1", "--truth", "127.0.0.1:1"], 2, "--link 127.0.0.1:1: cannot be opened"),
    ] {
        let output = run(arguments);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(code) && stderr.contains(part), "{part} not in {stderr}");
    }
}
