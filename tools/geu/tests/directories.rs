//! Directories that a command writes into: one that holds anything is left alone, unless `--force` is given.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn geu(arguments: &[&str], directory: &Path, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_geu")).args(arguments).arg(directory).args(more).output().expect("geu runs")
}

/// What writes into a directory, and a file that it writes there.
const COMMANDS: [(&[&str], &str); 5] = [
    (&["run", "--control", "off", "--speed", "max", "--duration", "5", "--tcp", "127.0.0.1:0", "--record"], "run.toml"),
    (&["simulate", "--duration", "5", "--out"], "run.toml"),
    (&["checkout", "--out"], "run.toml"),
    (&["blind", "hide", "--seed", "4", "--duration", "900", "--out"], "key/key.toml"),
    (&["simulate", "--svg"], "limit-cycle.svg"),
];

#[test]
fn a_recording_and_the_figures_of_its_unit_may_go_into_one_new_directory() {
    let room = tempfile::tempdir().expect("a directory");
    let both = room.path().join("both");
    let simulated = geu(&["simulate", "--duration", "5", "--out"], &both, &["--svg", both.to_str().expect("text")]);
    assert!(simulated.status.success(), "{simulated:?}");
    assert!(both.join("run.toml").exists() && both.join("limit-cycle.svg").exists());
}

#[test]
fn a_directory_that_holds_anything_is_written_into_only_with_force() {
    let room = tempfile::tempdir().expect("a directory");
    for (index, (command, file)) in COMMANDS.into_iter().enumerate() {
        let directory = room.path().join(index.to_string());
        fs::create_dir(&directory).expect("room");
        let foreign = directory.join("notes.txt");
        fs::write(&foreign, "mine").expect("written");
        let refused = geu(command, &directory, &[]);
        let message = String::from_utf8_lossy(&refused.stderr);
        assert_eq!(refused.status.code(), Some(2), "{command:?}: {message}");
        assert!(message.lines().count() == 1 && message.contains("--force"), "{message}");
        assert_eq!(fs::read_dir(&directory).expect("still there").count(), 1, "{command:?}");

        let forced = geu(command, &directory, &["--force"]);
        assert!(forced.status.success() && directory.join(file).exists(), "{command:?}: {forced:?}");
        assert_eq!(fs::read_to_string(&foreign).expect("still there"), "mine");

        // What would be written over is read.
        let input = directory.join(file);
        fs::write(&input, "seed = 4\n").expect("written");
        let config = match command[0] {
            "run" | "simulate" => vec!["--force"],
            _ => vec!["--force", "--config"],
        };
        let refused = geu(command, &directory, &[&config[..], &[input.to_str().expect("text")]].concat());
        let message = String::from_utf8_lossy(&refused.stderr);
        assert_eq!(refused.status.code(), Some(2), "{command:?}: {message}");
        assert!(message.contains("none of the inputs"), "{message}");
        assert_eq!(fs::read_to_string(&input).expect("still there"), "seed = 4\n");

        // No directory at all.
        let refused = geu(command, &foreign, &["--force"]);
        assert_eq!(refused.status.code(), Some(1), "{refused:?}");
    }
}
