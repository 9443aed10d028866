//! Directory and link of a recording: files are overwritten only on request, and the open link is the recorded one.

use std::fs;
use std::path::Path;
use std::process::Output;

use geu_tests::emulator::Emulator;
use geu_tests::geu;

fn directory() -> tempfile::TempDir {
    tempfile::tempdir().expect("a directory")
}

fn geu_with(arguments: &[&str]) -> Output {
    geu().args(arguments).output().expect("geu starts")
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Every file of a directory with its bytes.
fn contents(directory: &Path) -> Vec<(String, Vec<u8>)> {
    let entries = fs::read_dir(directory).expect("a directory").map(|entry| entry.expect("an entry").path());
    let mut all: Vec<_> = entries
        .map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), fs::read(&path).unwrap()))
        .collect();
    all.sort();
    all
}

#[test]
fn a_directory_that_holds_anything_is_refused_without_force() {
    let directory = directory();
    let place = directory.path().join("run");
    let path = place.to_str().expect("text");
    let arguments = [
        &["simulate", "--duration", "5", "--out", path][..],
        &["run", "--duration", "1", "--control", "off", "--record", path],
    ];
    fs::create_dir(&place).expect("made");
    for name in ["link.bin", "notes.txt"] {
        fs::write(place.join(name), "mine").expect("written");
        for arguments in arguments {
            let refused = geu_with(arguments);
            assert_eq!(refused.status.code(), Some(2), "{arguments:?}: {}", said(&refused));
            assert!(said(&refused).contains("--force") && said(&refused).contains(name), "{}", said(&refused));
        }
        assert_eq!(contents(&place), [(name.to_owned(), b"mine".to_vec())]);
        fs::remove_file(place.join(name)).expect("removed");
    }
    assert!(geu_with(arguments[0]).status.success(), "an empty one is free");
}

#[test]
fn force_replaces_a_recording_and_nothing_else() {
    let directory = directory();
    let place = directory.path().join("run");
    let path = place.to_str().expect("text");
    assert!(geu_with(&["simulate", "--duration", "5", "--wire", "serial", "--out", path]).status.success());
    fs::write(place.join("notes.txt"), "mine").expect("written");
    let forced = geu_with(&["simulate", "--duration", "3", "--force", "--out", path]);
    assert!(forced.status.success(), "{}", said(&forced));
    assert!(said(&forced).contains("wrote 3 s into"), "{}", said(&forced));
    assert!(!place.join("link.bin").exists(), "a link in the other form would not belong to this recording");
    assert_eq!(fs::read(place.join("notes.txt")).expect("it stays"), b"mine");
    let fresh = directory.path().join("fresh");
    assert!(geu_with(&["simulate", "--duration", "3", "--out", fresh.to_str().unwrap()]).status.success());
    let own: Vec<_> = contents(&place).into_iter().filter(|(name, _)| name != "notes.txt").collect();
    assert_eq!(own, contents(&fresh));
    // What is read is never replaced.
    let before = contents(&place);
    let run = place.join("run.toml");
    for input in [
        &["simulate", run.to_str().unwrap()][..],
        &["simulate", "--truth", place.join("reference.csv").to_str().unwrap()],
    ] {
        let refused =
            geu().args(input).args(["--duration", "2", "--force", "--out", path]).output().expect("geu starts");
        assert_eq!(refused.status.code(), Some(2), "{}", said(&refused));
        assert!(said(&refused).contains("input"), "{}", said(&refused));
    }
    assert_eq!(contents(&place), before);
}

#[test]
fn a_run_that_cannot_start_touches_nothing() {
    let directory = directory();
    let place = directory.path().join("run");
    let path = place.to_str().expect("text");
    assert!(geu_with(&["simulate", "--duration", "5", "--out", path]).status.success());
    let before = contents(&place);
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let taken = taken.local_addr().expect("an address").to_string();
    for broken in [
        &["--can", "nosuch0"][..],
        &["--tcp", &taken],
        &["--tcp", "127.0.0.1:0", "--control", &taken],
        &["--tcp", "127.0.0.1:0", "--truth", "udp://203.0.113.1:4701"],
    ] {
        for record in [path, directory.path().join("new").to_str().expect("text")] {
            let arguments = [&["run", "--duration", "1", "--force", "--record", record][..], broken].concat();
            let refused = geu_with(&arguments);
            assert_eq!(refused.status.code(), Some(2), "{arguments:?}: {}", said(&refused));
        }
        assert_eq!(contents(&place), before, "{broken:?}");
        assert!(!directory.path().join("new").exists(), "{broken:?}");
    }
    // Two emulators do not record into one directory.
    let other = directory.path().join("other");
    let _running = Emulator::start(1, &["--tcp", "127.0.0.1:0", "--record", other.to_str().unwrap()]);
    let refused = geu_with(&["simulate", "--duration", "1", "--force", "--out", other.to_str().unwrap()]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        said(&refused).contains("another process records into it; expected a directory of its own"),
        "{}",
        said(&refused)
    );
}

#[test]
fn the_recording_has_the_form_of_the_link_given_first() {
    let directory = directory();
    let pty = directory.path().join("geu0");
    let plan = directory.path().join("plan.toml");
    fs::write(&plan, "[[fault]]\nid = \"quiet\"\nfault = \"silence\"\nlink = \"pty\"\nat_s = 2.0\nfor_s = 3.0")
        .expect("written");
    let place = directory.path().join("run");
    let arguments = ["--pty", pty.to_str().unwrap(), "--tcp", "127.0.0.1:0", "--speed", "20", "--duration", "10"];
    let files = ["--faults", plan.to_str().unwrap(), "--record", place.to_str().unwrap(), "--control", "off"];
    let emulator = Emulator::start(2, &[&arguments[..], &files].concat());
    let (code, said) = emulator.end();
    assert_eq!(code, Some(0), "{said}");
    assert!(!place.join("link.log").exists());
    let link = fs::read(place.join("link.bin")).expect("the bytes of the pty");
    assert_eq!(link.len(), (20 - 6) * 28, "samples outside of the silence");
    let again = directory.path().join("again");
    assert!(
        geu_with(&["simulate", place.join("run.toml").to_str().unwrap(), "--out", again.to_str().unwrap()])
            .status
            .success()
    );
    assert_eq!(contents(&again), contents(&place));
}

#[test]
fn the_base_of_can_is_recorded_and_comes_again() {
    let directory = directory();
    let config = directory.path().join("run.toml");
    fs::write(&config, "[run]\nduration_s = 4.0\nwire = \"can\"\ncan_base = 0x300").expect("written");
    let (place, again) = (directory.path().join("run"), directory.path().join("again"));
    for (config, out) in [(&config, &place), (&place.join("run.toml"), &again)] {
        let done = geu_with(&["simulate", config.to_str().unwrap(), "--out", out.to_str().unwrap()]);
        assert!(done.status.success(), "{}", said(&done));
    }
    assert_eq!(contents(&place), contents(&again));
    assert!(fs::read_to_string(place.join("run.toml")).expect("a run").contains("can_base = 0x300"));
    let log = fs::read_to_string(place.join("link.log")).expect("a log");
    let ids: Vec<&str> = log.lines().map(|line| line.rsplit(' ').next().unwrap().split('#').next().unwrap()).collect();
    assert_eq!(ids[..4], ["300", "301", "302", "300"]);
    let rows = geu_with(&["decode", "--base", "300", place.join("link.log").to_str().unwrap()]);
    assert_eq!(String::from_utf8_lossy(&rows.stdout).lines().count(), 1 + 8);
}
