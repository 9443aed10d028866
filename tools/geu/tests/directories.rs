//! Output directories: one that is not empty is refused without `--force`.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn geu(arguments: &[&str], directory: &Path, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_geu")).args(arguments).arg(directory).args(more).output().expect("geu runs")
}

/// Commands that write into a directory, and a file of it.
const COMMANDS: [(&[&str], &str); 5] = [
    (&["run", "--control", "off", "--speed", "max", "--duration", "5", "--tcp", "127.0.0.1:0", "--record"], "run.toml"),
    (&["simulate", "--duration", "5", "--out"], "run.toml"),
    (&["checkout", "--out"], "run.toml"),
    (&["blind", "hide", "--seed", "4", "--duration", "900", "--out"], "key/key.toml"),
    (&["simulate", "--svg"], "limit-cycle.svg"),
];

#[test]
fn a_recording_and_the_figures_of_its_unit_may_go_into_one_new_directory() {
    let parent = tempfile::tempdir().expect("a directory");
    let both = parent.path().join("both");
    let simulated = geu(&["simulate", "--duration", "5", "--out"], &both, &["--svg", both.to_str().expect("text")]);
    assert!(simulated.status.success(), "{simulated:?}");
    assert!(both.join("run.toml").exists() && both.join("limit-cycle.svg").exists());
}

#[test]
fn directory_that_is_not_empty_needs_force() {
    let parent = tempfile::tempdir().expect("a directory");
    for (index, (command, file)) in COMMANDS.into_iter().enumerate() {
        let directory = parent.path().join(index.to_string());
        fs::create_dir(&directory).expect("created");
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

        // A file that is also an input is refused.
        let input = directory.join(file);
        fs::write(&input, "seed = 4\n").expect("written");
        let config = match command[0] {
            "run" | "simulate" => vec!["--force"],
            _ => vec!["--force", "--config"],
        };
        let refused = geu(command, &directory, &[&config[..], &[input.to_str().expect("text")]].concat());
        let message = String::from_utf8_lossy(&refused.stderr);
        assert_eq!(refused.status.code(), Some(2), "{command:?}: {message}");
        assert!(message.contains("not an input"), "{message}");
        assert_eq!(fs::read_to_string(&input).expect("still there"), "seed = 4\n");

        // A file in place of the directory.
        let refused = geu(command, &foreign, &["--force"]);
        assert_eq!(refused.status.code(), Some(1), "{refused:?}");
    }
}
