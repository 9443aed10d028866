//! Output directories: one that is not empty is refused without `--force`. An archive grows: only a file that exists is refused.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn geu(arguments: &[&str], directory: &Path, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_geu")).args(arguments).arg(directory).args(more).output().expect("geu runs")
}

/// Commands that write into a directory, and a file of it.
const COMMANDS: [(&[&str], &str); 6] = [
    (&["run", "--control", "off", "--speed", "max", "--duration", "5", "--tcp", "127.0.0.1:0", "--record"], "run.toml"),
    (&["simulate", "--duration", "5", "--out"], "run.toml"),
    (&["checkout", "--out"], "run.toml"),
    (&["blind", "hide", "--seed", "4", "--duration", "900", "--out"], "key/key.toml"),
    (&["simulate", "--svg"], "limit-cycle.svg"),
    (&["man", "--out"], "geu.1"),
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
            "run" | "simulate" => Some(vec!["--force"]),
            "man" => None,
            _ => Some(vec!["--force", "--config"]),
        };
        if let Some(config) = config {
            let refused = geu(command, &directory, &[&config[..], &[input.to_str().expect("text")]].concat());
            let message = String::from_utf8_lossy(&refused.stderr);
            assert_eq!(refused.status.code(), Some(2), "{command:?}: {message}");
            assert!(message.contains("not an input"), "{message}");
            assert_eq!(fs::read_to_string(&input).expect("still there"), "seed = 4\n");
        }

        // A file in place of the directory.
        let refused = geu(command, &foreign, &["--force"]);
        assert_eq!(refused.status.code(), Some(1), "{refused:?}");
    }
}

/// Names of the files and directories within a directory, sorted.
fn names(directory: &Path) -> Vec<String> {
    let Ok(entries) = fs::read_dir(directory) else { return Vec::new() };
    let paths = entries.map(|entry| entry.expect("an entry").path());
    let within = paths.flat_map(|path| [vec![path.display().to_string()], names(&path)].concat());
    let mut all: Vec<String> = within.collect();
    all.sort_unstable();
    all
}

#[test]
fn an_archive_grows_and_a_file_in_it_needs_force() {
    let parent = tempfile::tempdir().expect("a directory");
    let path = |name: &str| parent.path().join(name);
    // Two days, from 40 s before midnight.
    for (name, start) in [("late", "1795132760"), ("later", "1795219200")] {
        let simulated = geu(&["simulate", "--duration", "60", "--start", start, "--out"], &path(name), &[]);
        assert!(simulated.status.success(), "{simulated:?}");
    }
    let decode = |input: &str, directory: &Path, more: &[&str]| {
        let input = path(input).display().to_string();
        let words = ["decode", &input, "--quiet", "--format", "parquet", "--partition"];
        geu(&words, directory, more)
    };
    let archive = path("archive");
    let written = decode("late/link.log", &archive, &[]);
    assert!(written.status.success() && written.stdout.is_empty(), "{written:?}");
    let before = names(&archive);
    let days = ["device=iras/day=2026-11-19", "device=iras/day=2026-11-20"].map(|day| archive.join(day));
    assert!(before.len() == 5 && days.iter().all(|day| names(day).len() == 1), "{before:?}");

    // The second file of a recording exists: the first is not written either.
    fs::remove_dir_all(&days[0]).expect("removed");
    let before = names(&archive);
    let refused = decode("late/link.log", &archive, &[]);
    let message = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && names(&archive) == before, "{message} {:?}", names(&archive));
    assert!(message.lines().count() == 1 && message.contains(".parquet: ") && message.contains("--force"), "{message}");
    assert!(decode("late/link.log", &archive, &["--force"]).status.success());
    assert!(decode("later/link.log", &archive, &[]).status.success());
    assert_eq!(names(&archive).len(), 7);

    // A file of the archive is its own input.
    let day = names(&days[0]).remove(0);
    let refused = decode(&day, &archive, &["--force"]);
    let message = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && message.contains("not an input"), "{message}");

    // A file in place of the directory; a recording that is refused; a full disk.
    let (foreign, new) = (path("notes.txt"), path("new/archive"));
    fs::write(&foreign, "mine").expect("written");
    let refused = decode("late/link.log", &foreign, &[]);
    let message = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(1) && message.contains("notes.txt: cannot be written"), "{message}");
    assert_eq!(decode("notes.txt", &new, &[]).status.code(), Some(2));
    let words = format!(
        "ulimit -f 0; exec \"$0\" decode {} --quiet --format parquet --partition {}",
        path("late/link.log").display(),
        new.display()
    );
    let full = Command::new("sh").args(["-c", &words, env!("CARGO_BIN_EXE_geu")]).output().expect("geu runs");
    let message = String::from_utf8_lossy(&full.stderr);
    assert!(full.status.code() == Some(1) && message.contains("archive: cannot be written"), "{message}");
    assert!(!path("new").exists(), "{:?}", names(&path("new")));
}
