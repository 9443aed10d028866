//! A signal in the middle of an output, in a process of its own.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use geu_files::Output;
use geu_files::interruption::stop_flag;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

/// Names the output in the process that is interrupted.
const OUT: &str = "GEU_FILES_OUT";
/// There where that process was asked to end by itself, and does not.
const IS_DEAF: &str = "GEU_FILES_DEAF";

/// No test in itself: begins an output, says so, and waits to be ended.
#[test]
fn interrupted_process() {
    let Some(path) = std::env::var_os(OUT) else { return };
    if std::env::var_os(IS_DEAF).is_some() {
        stop_flag().expect("signals");
    }
    let mut output = Output::create(Path::new(&path)).expect("room");
    output.write_all(b"rows so far").expect("room");
    // Not println!, which the test harness keeps to itself.
    std::io::stdout().write_all(b"\nbegun\n").expect("a reader");
    loop {
        std::thread::park();
    }
}

/// That process, when it has begun.
fn interrupted(path: &Path, is_deaf: bool) -> Child {
    let mut command = Command::new(std::env::current_exe().expect("this program"));
    command.args(["--exact", "interrupted_process", "--nocapture"]).env(OUT, path).stdout(Stdio::piped());
    if is_deaf {
        command.env(IS_DEAF, "1");
    }
    let mut child = command.spawn().expect("it starts");
    let mut lines = BufReader::new(child.stdout.take().expect("a pipe")).lines();
    assert!(lines.any(|line| line.expect("text") == "begun"));
    child
}

fn send(child: &Child, signal: Signal) {
    kill(Pid::from_raw(child.id() as i32), signal).expect("it runs");
}

fn beside(path: &Path) -> Vec<std::path::PathBuf> {
    let entries = fs::read_dir(path.parent().expect("a directory")).expect("a directory");
    let mut paths: Vec<_> =
        entries.map(|entry| entry.expect("an entry").path()).filter(|other| other != path).collect();
    paths.sort();
    paths
}

#[test]
fn a_signal_removes_what_is_not_whole_and_leaves_what_was_there() {
    // Not SIGHUP: under nohup it is ignored.
    for (signal, code) in [(Signal::SIGINT, 130), (Signal::SIGTERM, 143)] {
        let room = tempfile::tempdir().expect("a directory");
        let path = room.path().join("rows.csv");
        fs::write(&path, "before").expect("room");
        let mut child = interrupted(&path, false);
        assert_eq!(beside(&path).len(), 1);
        send(&child, signal);
        assert_eq!(child.wait().expect("its end").code(), Some(code), "{signal}");
        assert_eq!(
            (fs::read_to_string(&path).expect("there"), beside(&path)),
            ("before".to_owned(), vec![]),
            "{signal}"
        );
    }
}

#[test]
fn what_was_received_stays_beside_its_place_when_the_process_is_killed() {
    let room = tempfile::tempdir().expect("a directory");
    let path = room.path().join("rows.csv");
    fs::write(&path, "before").expect("room");
    let rows = |path: &Path| {
        let [partial] = &beside(path)[..] else { panic!("{:?}", beside(path)) };
        let name = partial.file_name().and_then(|name| name.to_str()).expect("text");
        assert!(name.starts_with("rows.csv.") && name.ends_with(".partial"), "{name}");
        let rows = fs::read_to_string(partial).expect("there");
        fs::remove_file(partial).expect("there");
        rows
    };
    let mut killed = interrupted(&path, false);
    send(&killed, Signal::SIGKILL);
    killed.wait().expect("its end");
    assert_eq!(rows(&path), "rows so far");
    // One that was asked to end by itself and does not.
    let mut deaf = interrupted(&path, true);
    // Until both are taken they may be one.
    let code = loop {
        send(&deaf, Signal::SIGINT);
        std::thread::sleep(std::time::Duration::from_millis(50));
        if let Some(status) = deaf.try_wait().expect("its end") {
            break status.code();
        }
    };
    assert_eq!((code, rows(&path)), (Some(130), "rows so far".to_owned()));
    assert_eq!(fs::read_to_string(&path).expect("there"), "before");
}
