//! A signal while an output is written, in another process.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use geu_files::Output;
use geu_files::interruption::stop_flag;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

/// Environment variable with the output of the interrupted process.
const OUT: &str = "GEU_FILES_OUT";
/// Environment variable of a process that ignores the stop flag.
const IS_DEAF: &str = "GEU_FILES_DEAF";

/// Not a test: starts an output, prints `begun`, and waits for a signal.
#[test]
fn interrupted_process() {
    let Some(path) = std::env::var_os(OUT) else { return };
    if std::env::var_os(IS_DEAF).is_some() {
        stop_flag().expect("signals");
    }
    let mut output = Output::create(Path::new(&path)).expect("written");
    output.write_all(b"received rows").expect("written");
    // The test harness captures println!.
    std::io::stdout().write_all(b"\nbegun\n").expect("a reader");
    loop {
        std::thread::park();
    }
}

/// Starts that process.
fn interrupted(path: &Path, is_deaf: bool) -> Child {
    let mut command = Command::new(std::env::current_exe().expect("this program"));
    command.args(["--exact", "interruption::interrupted_process", "--nocapture"]).env(OUT, path).stdout(Stdio::piped());
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
fn signal_removes_incomplete_files_and_keeps_the_previous_file() {
    // Not SIGHUP: under nohup it is ignored.
    for (signal, code) in [(Signal::SIGINT, 130), (Signal::SIGTERM, 143)] {
        let directory = tempfile::tempdir().expect("a directory");
        let path = directory.path().join("rows.csv");
        fs::write(&path, "before").expect("written");
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
fn incomplete_file_stays_when_the_process_is_killed() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("rows.csv");
    fs::write(&path, "before").expect("written");
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
    assert_eq!(rows(&path), "received rows");
    // A process that ignores the stop flag.
    let mut deaf = interrupted(&path, true);
    // Two pending signals may be merged into one.
    let code = loop {
        send(&deaf, Signal::SIGINT);
        std::thread::sleep(std::time::Duration::from_millis(50));
        if let Some(status) = deaf.try_wait().expect("its end") {
            break status.code();
        }
    };
    assert_eq!((code, rows(&path)), (Some(130), "received rows".to_owned()));
    assert_eq!(fs::read_to_string(&path).expect("there"), "before");
}
