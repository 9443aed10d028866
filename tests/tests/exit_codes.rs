//! Exit codes: the same for the same failure of every command, and listed in the help of every command.

use std::fs;
use std::path::Path;
use std::process::{Output, Stdio};

use geu_tests::geu;

const BAD: Option<i32> = Some(2);
const FAILED: Option<i32> = Some(1);

/// Runs a command line; `{}` in it is the directory.
fn run(directory: &Path, line: &str) -> Output {
    let line = line.replace("{}", &directory.display().to_string());
    let mut command = geu();
    command.args(line.split_whitespace()).current_dir(directory).stdin(Stdio::null());
    command.output().expect("geu starts")
}

/// Asserts that every line ends with this code and a message, without a panic.
fn assert_code(directory: &Path, code: Option<i32>, lines: &[&str]) {
    for line in lines {
        let output = run(directory, line);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), code, "geu {line}: {message}");
        assert!(!message.trim().is_empty() && !message.contains("panicked"), "geu {line}: {message}");
    }
}

/// A directory with a short recording, a plain file, and a configuration with an unknown gyro.
fn test_directory() -> tempfile::TempDir {
    let directory = tempfile::tempdir().expect("a directory");
    fs::write(directory.path().join("bad.toml"), "[gyro.GYRQ]\ndrift = 1\n").expect("written");
    fs::write(directory.path().join("plain"), "").expect("written");
    fs::write(directory.path().join("escape"), "a\u{1b}[31m = 1\n").expect("written");
    fs::write(directory.path().join("comment"), "# none yet\n").expect("written");
    let made = run(directory.path(), "simulate --duration 600 --out rec");
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    directory
}

/// The commands that this help lists.
fn commands(help: &str) -> Vec<String> {
    let listed = help.split("\nCommands:\n").nth(1).map_or("", |rest| rest.split("\n\n").next().unwrap_or(""));
    let names = listed.lines().filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    names.filter_map(|line| line.split_whitespace().next()).filter(|name| *name != "help").map(str::to_owned).collect()
}

/// Asserts that the help of a command and of its subcommands lists the codes; returns their number.
fn assert_helps(directory: &Path, command: &str) -> usize {
    let output = run(directory, &format!("{command} --help"));
    let help = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(0), "geu {command} --help");
    for part in ["Exit codes:\n", "  0  done\n", "  1  failed", "  2  bad usage or bad input", "  3  a diagnosis"] {
        assert!(help.contains(part), "{part:?} is not in geu {command} --help:\n{help}");
    }
    // `geu send --help` lists commands of the unit.
    let below = if command == "send" { Vec::new() } else { commands(&help) };
    1 + below.iter().map(|name| assert_helps(directory, format!("{command} {name}").trim())).sum::<usize>()
}

#[test]
fn the_help_of_every_command_lists_the_exit_codes() {
    let directory = tempfile::tempdir().expect("a directory");
    let count = assert_helps(directory.path(), "");
    // `geu`, 17 commands, and the subcommands of blind, faults and config.
    assert!(count >= 25, "{count} helps");
}

#[test]
fn an_empty_configuration_or_plan_is_refused_and_no_message_commands_the_terminal() {
    let directory = test_directory();
    for (line, expected) in [
        ("simulate plain --duration 10 --out x", "plain: cannot be read: it is empty; expected a configuration"),
        ("simulate --faults plain --duration 10 --out x", "plain: cannot be read: it is empty; expected a plan"),
        ("simulate --faults comment --duration 10 --out x", "comment: expected a plan with [[fault]] or [[expect]]"),
        ("config show plain", "plain: cannot be read: it is empty; expected a configuration"),
    ] {
        assert_code(directory.path(), BAD, &[line]);
        let message = String::from_utf8_lossy(&run(directory.path(), line).stderr).into_owned();
        assert!(message.contains(expected), "geu {line}: {message}");
    }
    let output = run(directory.path(), "config check escape");
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(message.contains('\u{fffd}') && !message.contains('\u{1b}'), "{message:?}");
    // Nothing on purpose: a unit without errors.
    let output = run(directory.path(), "simulate /dev/null --duration 10 --out x");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn a_wrong_option_is_2_for_every_command() {
    let directory = tempfile::tempdir().expect("a directory");
    let help = run(directory.path(), "--help");
    let commands = commands(&String::from_utf8_lossy(&help.stdout));
    assert!(commands.len() >= 17, "{commands:?}");
    let lines: Vec<String> = commands.iter().map(|command| format!("{command} --no-such-option")).collect();
    assert_code(directory.path(), BAD, &lines.iter().map(String::as_str).collect::<Vec<_>>());
}

#[test]
fn a_missing_input_exits_2() {
    let directory = test_directory();
    assert_code(
        directory.path(),
        BAD,
        &[
            "run none.toml",
            "run --faults none.toml",
            "run --truth none.csv",
            "simulate none.toml --out new",
            "simulate --faults none.toml --out new",
            "simulate --faults plain --out new",
            "replay none.log --tcp 127.0.0.1:0",
            "replay rec/link.log --faults plain --tcp 127.0.0.1:0",
            "decode vcan0:300",
            "calibrate --link none.log --reference rec/reference.csv",
            "calibrate --link rec/link.log --reference none.csv",
            "calibrate --link rec/link.log --fss none.csv --sse none.csv",
            "reconstruct --link none.log --fss rec/fss.csv --sse rec/sse.csv",
            "diagnose --link none.log --reference rec/reference.csv",
            "diagnose --link rec/link.log --reference none.csv",
            "diagnose --device none.toml --link none.csv --reference none.csv",
            "blind score --key none.toml --json none.json",
            "blind hide --config none.toml --seed 1 --out new",
            "checkout --config none.toml",
            "config check none.toml",
            "config show none.toml",
            "decode none.log",
            "decode --gyro-csv none.toml rec/link.log",
            "track none.log",
            "track --config none.toml rec/link.log",
            "watch none.log",
            "watch --config none.toml rec/link.log",
            "watch --reference none.csv rec/link.log",
            "inject --plan none.toml",
            "send none0 PING",
        ],
    );
}

#[test]
fn a_wrong_configuration_exits_2() {
    let directory = test_directory();
    assert_code(
        directory.path(),
        BAD,
        &[
            "run bad.toml",
            "simulate bad.toml --out new",
            "calibrate --config bad.toml --link rec/link.log --reference rec/reference.csv",
            "reconstruct --config bad.toml",
            "diagnose --config bad.toml --link rec/link.log --reference rec/reference.csv",
            "blind hide --config bad.toml --seed 1 --out new",
            "blind campaign --config bad.toml",
            "checkout --config bad.toml",
            "config check bad.toml",
            "config show bad.toml",
            "track --config bad.toml rec/link.log",
            "run --set gyro.GYRQ.drift.arcsec_per_h=1",
            "simulate --set gyro.GYRQ.drift.arcsec_per_h=1 --out new",
        ],
    );
    assert!(!directory.path().join("new").exists());
}

#[test]
fn an_unwritable_output_exits_1() {
    let directory = test_directory();
    assert_code(
        directory.path(),
        FAILED,
        &[
            "run --duration 1 --speed max --tcp 127.0.0.1:0 --control off --record plain/new",
            "simulate --duration 5 --out plain/new",
            "simulate --svg plain/new",
            "simulate --duration 5 --out new --junit plain/new",
            "blind hide --seed 1 --duration 900 --out plain/new",
            "checkout --out plain/new",
            "decode rec/link.log --out plain/new",
            "decode rec/link.log --defects plain/new",
            "describe dbc --out plain/new",
            "diagnose --link rec/link.log --reference rec/reference.csv --json plain/new",
            "track rec/link.log --out plain/new",
        ],
    );
}

#[test]
fn the_usage_of_calibrate_names_both_ways_to_an_attitude() {
    let directory = tempfile::tempdir().expect("a directory");
    for line in ["calibrate --help", "calibrate --link x.log"] {
        let output = run(directory.path(), line);
        let message = String::from_utf8_lossy(if line.ends_with("help") { &output.stdout } else { &output.stderr });
        assert!(message.contains("(--reference <FILE> | --fss <FILE> --sse <FILE>)"), "{message}");
    }
}
