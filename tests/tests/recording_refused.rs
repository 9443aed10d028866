//! Errors while recording leave foreign files and the previous recording unchanged.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Command, Output};

use geu_tests::geu;

fn directory() -> tempfile::TempDir {
    tempfile::tempdir().expect("a directory")
}

/// `geu simulate` of 5 s into a directory, with more arguments.
fn simulation(place: &Path, arguments: &[&str]) -> Command {
    let mut command = geu();
    command.args(["simulate", "--duration", "5", "--wire", "serial", "--out"]).arg(place).args(arguments);
    command
}

fn end_of(mut command: Command) -> Output {
    command.output().expect("it starts")
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Every file of a directory with its bytes.
fn contents(directory: &Path) -> Vec<(String, Vec<u8>)> {
    let entries = fs::read_dir(directory).expect("a directory").map(|entry| entry.expect("an entry"));
    let mut all: Vec<_> = entries
        .map(|entry| (entry.file_name().to_string_lossy().into_owned(), fs::read(entry.path()).expect("bytes")))
        .collect();
    all.sort();
    all
}

#[test]
fn force_writes_through_no_link() {
    let directory = directory();
    let (place, notes) = (directory.path().join("run"), directory.path().join("notes"));
    fs::create_dir(&place).expect("made");
    fs::write(&notes, "mine").expect("written");
    for linked in [|from: &Path, to: &Path| symlink(from, to), |from: &Path, to: &Path| fs::hard_link(from, to)] {
        for name in ["run.toml", "run.toml.new", "truth.csv", "truth.csv.wider", "link.bin"] {
            let _ = fs::remove_file(place.join(name));
            linked(&notes, &place.join(name)).expect("linked");
            let forced = end_of(simulation(&place, &["--force"]));
            assert!(forced.status.success(), "{name}: {}", said(&forced));
            assert_eq!(fs::read(&notes).expect("it stays"), b"mine", "{name}");
        }
    }
    assert!(!place.join("run.toml.new").exists());
}

#[test]
fn force_removes_nothing_where_no_byte_can_be_written() {
    let directory = directory();
    let place = directory.path().join("run");
    assert!(end_of(simulation(&place, &[])).status.success());
    let before = contents(&place);
    // The signal is ignored, so that writing fails as on a full disk.
    let mut shell = Command::new("sh");
    let forced = simulation(&place, &["--force"]);
    shell.args(["-c", "trap '' XFSZ; ulimit -f 0; exec \"$0\" \"$@\""]).arg(forced.get_program());
    shell.args(forced.get_args());
    let refused = end_of(shell);
    assert_eq!(refused.status.code(), Some(1), "{}", said(&refused));
    assert!(said(&refused).contains("run.toml.new: File too large"), "{}", said(&refused));
    assert_eq!(contents(&place), before);
}

#[test]
fn no_thread_to_record_or_to_read_with_is_an_error() {
    let directory = directory();
    let place = directory.path().join("run");
    let run = ["run", "--tcp", "127.0.0.1:0", "--control", "off", "--duration", "1", "--record"];
    for (arguments, path) in
        [(&run[..], &place), (&["replay", "--tcp", "127.0.0.1:0"], &directory.path().join("x.log"))]
    {
        fs::write(directory.path().join("x.log"), "(1.0) can0 1A0#00\n").expect("written");
        let mut command = geu();
        // A stack larger than any address space: as if no further thread were allowed.
        command.args(arguments).arg(path).env("RUST_MIN_STACK", (1u64 << 47).to_string());
        let refused = end_of(command);
        assert!(matches!(refused.status.code(), Some(1 | 2)), "{arguments:?}: {}", said(&refused));
        assert!(said(&refused).contains("expected another thread"), "{arguments:?}: {}", said(&refused));
    }
}

#[test]
fn files_that_complete_an_unfinished_run_are_inputs() {
    let directory = directory();
    let (killed, again) = (directory.path().join("killed"), directory.path().join("again"));
    assert!(end_of(simulation(&killed, &[])).status.success());
    let run = killed.join("run.toml");
    let text = fs::read_to_string(&run).expect("a run");
    // As a killed run leaves it.
    assert!(text.contains("[run]\n"), "{text}");
    fs::write(&run, text.replacen("[run]\n", "[run]\nunfinished = true\n", 1)).expect("written");
    let before = contents(&killed);
    for name in ["truth.csv", "commands.jsonl"] {
        let mut simulation = geu();
        simulation.arg("simulate").arg(&run).arg("--out").arg(&again).arg("--junit").arg(killed.join(name));
        let refused = end_of(simulation);
        assert_eq!(refused.status.code(), Some(2), "{name}: {}", said(&refused));
        assert!(said(&refused).contains("same file as the input"), "{name}: {}", said(&refused));
        assert_eq!(contents(&killed), before, "{name}");
    }
    // A command that was cut within a character was not acknowledged.
    fs::write(killed.join("commands.jsonl"), b"{\"link\": \"\xC3").expect("written");
    let mut simulation = geu();
    simulation.arg("simulate").arg(&run).arg("--out").arg(&again);
    let made = end_of(simulation);
    assert!(made.status.success(), "{}", said(&made));
    assert_eq!(fs::read(again.join("link.bin")).ok(), fs::read(killed.join("link.bin")).ok());
}
