//! The small on-board computer around the emulator: closed loops, as fast as both go.

use std::io::{BufRead, BufReader};
use std::process::{Output, Stdio};

use geu_tests::{geu, geu_obc};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

fn fly(arguments: &[&str]) -> Output {
    geu_obc().args(arguments).output().expect("geu-obc starts")
}

/// On-board time, true and believed error of every second of a flight, s and arcsec.
fn lines(output: &Output) -> Vec<[f64; 3]> {
    let text = String::from_utf8_lossy(&output.stdout);
    let row = |line: &str| {
        let after = |word: &str| line.split(word).nth(1)?.trim_start().split('″').next()?.parse().ok();
        Some([line.split_whitespace().next()?.parse().ok()?, after("true")?, after("believed")?])
    };
    text.lines().filter_map(row).collect()
}

#[test]
fn pointing_is_held_on_the_emulators_own_data_and_the_same_flight_is_flown_again() {
    let room = tempfile::tempdir().expect("a directory");
    let (run, again) = (room.path().join("run"), room.path().join("again"));
    let record = run.to_str().expect("UTF-8");
    let first = fly(&["--duration", "300", "--speed", "max", "--record", record]);
    let said = String::from_utf8_lossy(&first.stderr);
    assert_eq!(first.status.code(), Some(0), "{said}");
    assert!(said.contains("late samples 0, missing 0, jumps 0, out of order 0, bad lines 0"), "{said}");
    let rows = lines(&first);
    assert_eq!(rows.len(), 300);
    // It starts with 12″/s, and comes back.
    assert!(rows[4][1] > 30.0 && rows[40..].iter().all(|row| row[1] < 5.0), "{rows:?}");
    assert!(rows.iter().all(|[_, truth, believed]| (truth - believed).abs() < 2.0), "{rows:?}");
    assert_eq!(fly(&["--duration", "300", "--speed", "max"]).stdout, first.stdout);
    let mut simulate = geu();
    simulate.arg("simulate").arg(run.join("run.toml")).arg("--out").arg(&again);
    assert!(simulate.status().expect("geu starts").success());
    let link = |directory: &std::path::Path| std::fs::read(directory.join("link.bin")).expect("a link");
    assert!(link(&run) == link(&again) && !link(&run).is_empty());
}

#[test]
fn a_drift_that_is_not_known_on_board_takes_the_true_pointing_away_and_nobody_on_board_sees_it() {
    let sets = ["--set", "gyro.GYRX.drift-step.arcsec_per_h=1800", "--set", "gyro.GYRX.drift-step.time_s=60"];
    let flown = fly(&[&["--duration", "180", "--speed", "max"], &sets[..]].concat());
    assert_eq!(flown.status.code(), Some(1), "{}", String::from_utf8_lossy(&flown.stderr));
    let rows = lines(&flown);
    let [t_s, truth, believed] = rows[rows.len() - 1];
    // 1800″/h for 120 s is 60″; the loop follows it by what it swings.
    assert!(t_s == 180.0 && (truth - 60.0).abs() < 4.0 && believed < 5.0, "{truth} {believed}");
    assert!(String::from_utf8_lossy(&flown.stdout).contains("pointing not held"));
}

#[test]
fn what_a_plan_expects_of_the_computer_is_told_by_code_and_file() {
    let room = tempfile::tempdir().expect("a directory");
    let file = |name: &str| room.path().join(name).display().to_string();
    let (plan, verdicts) = (file("plan.toml"), file("verdicts.xml"));
    let text = "[[fault]]\nid = \"late\"\nfault = \"dead\"\ngyro = \"GYRZB\"\nat_s = 9e9\n\n[[expect]]\ncondition = \"command(PING)\"\nwithin_s = 20\n";
    std::fs::write(&plan, text).expect("written");
    let flown = fly(&["--duration", "60", "--speed", "max", "--faults", &plan, "--junit", &verdicts]);
    let said = String::from_utf8_lossy(&flown.stderr);
    assert_eq!(flown.status.code(), Some(1), "{said}");
    assert!(said.contains("late: never started (t_s >= 9000000000.0)"), "{said}");
    assert!(said.contains("1 of 1 expectations were not met"), "{said}");
    let told = String::from_utf8_lossy(&flown.stdout);
    assert!(told.contains("pointing held") && told.contains("the emulator is not content"), "{told}");
    assert!(std::fs::read_to_string(&verdicts).expect("verdicts").contains("failures=\"1\""));
}

#[test]
fn a_flight_that_is_interrupted_says_so_and_its_recording_is_whole() {
    let room = tempfile::tempdir().expect("a directory");
    let run = room.path().join("run");
    let mut flight = geu_obc();
    flight.args(["--duration", "3600", "--record"]).arg(&run).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut flight = flight.spawn().expect("geu-obc starts");
    let mut line = String::new();
    BufReader::new(flight.stdout.take().expect("a pipe")).read_line(&mut line).expect("a line a second");
    kill(Pid::from_raw(flight.id() as i32), Signal::SIGTERM).expect("it runs");
    let ended = flight.wait_with_output().expect("it ends");
    let said = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(1), "{said}");
    assert!(said.contains("interrupted before 3600 s") && said.contains("the pointing is not judged"), "{said}");
    let run = std::fs::read_to_string(run.join("run.toml")).expect("a file");
    assert!(!run.contains("unfinished"), "{run}");
}

#[test]
fn the_help_lists_the_exit_codes() {
    let said = fly(&["--help"]).stdout;
    let said = String::from_utf8_lossy(&said);
    for part in ["Exit codes:", "  0  pointing was held", "  1  it was not", "  2  it could not begin"] {
        assert!(said.contains(part), "{part} not in {said}");
    }
}

#[test]
fn what_cannot_be_flown_says_why() {
    for (arguments, code, part) in [
        (&["--geu", "/nowhere/geu"][..], 2, "--geu: expected the program geu, got /nowhere/geu"),
        (&["--set", "gyro.GYRQ.drift=1"], 2, "geu ended before its link was ready"),
        (&["--duration", "3"], 2, "expected a duration of 41 to 604800 seconds"),
        (&["--link", "127.0.0.1:1", "--truth", "127.0.0.1:1"], 2, "--link 127.0.0.1:1: cannot be opened"),
    ] {
        let output = fly(arguments);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(code) && said.contains(part), "{part} not in {said}");
    }
}
