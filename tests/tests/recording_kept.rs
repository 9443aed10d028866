//! Acknowledged commands are on disk, a cut recording reads to its last complete record and can be reproduced, and a stalled disk
//! delays neither cadence nor replies nor the end of the process.

use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use geu_protocol::CommandResult;
use geu_protocol::serial::{FrameType, frame};
use geu_tests::emulator::{Client, Emulator};
use geu_tests::stalled_disk::StalledDisk;
use geu_tests::{geu, skipped};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

/// Files of a serial recording that are equal in the reproduced run.
const FILES: [&str; 7] =
    ["link.bin", "truth.csv", "reference.csv", "manoeuvres.csv", "commands.jsonl", "fss.csv", "sse.csv"];

fn directory() -> tempfile::TempDir {
    tempfile::tempdir().expect("a directory")
}

/// `geu run` on TCP, recorded into a directory, with its control interface at an address.
fn recorded(live: &Path, control: &str, arguments: &[&str]) -> Command {
    let mut command = geu();
    command.args(["run", "--tcp", "127.0.0.1:0", "--control", control, "--record"]).arg(live).args(arguments);
    command
}

fn simulate(live: &Path, again: &Path) {
    let output = geu().arg("simulate").arg(live.join("run.toml")).arg("--out").arg(again).output().expect("geu starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Asserts that each file is a prefix of that of the reproduced run.
fn assert_made_again(live: &Path, again: &Path) {
    simulate(live, again);
    for name in FILES {
        let (live, again) = (fs::read(live.join(name)).expect(name), fs::read(again.join(name)).expect(name));
        let same = live.iter().zip(&again).take_while(|(live, again)| live == again).count();
        assert!(same == live.len(), "{name} differs at {same} of {} and {} bytes", live.len(), again.len());
    }
}

fn command(client: &mut Client, payload: &[u8]) -> Duration {
    let (reply, took) = client.ask(&frame(FrameType::Command, payload));
    assert_eq!(reply.outcome(), CommandResult::Done, "{payload:?}");
    took
}

/// The body of the status of the control interface.
fn status(control: &str) -> serde_json::Value {
    let mut stream = TcpStream::connect(control).expect("the control interface");
    write!(stream, "GET /api/status HTTP/1.1\r\nHost: {control}\r\nConnection: close\r\n\r\n").expect("sent");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("text");
    serde_json::from_str(answer.split_once("\r\n\r\n").expect("a body").1).expect("JSON")
}

fn inject(control: &str, arguments: &[&str]) {
    let output = geu().args(["inject", "--control", control]).args(arguments).output().expect("geu starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn a_killed_run_keeps_acknowledged_commands_and_can_be_reproduced() {
    let directory = directory();
    let (live, again) = (directory.path().join("live"), directory.path().join("again"));
    let mut emulator = Emulator::of(recorded(&live, "127.0.0.1:0", &["--speed", "4"]), 1);
    let control = emulator.control();
    let mut client = emulator.tcp();
    assert!(client.read_until(|client| client.samples.len() >= 4));
    command(&mut client, &[4, 1, 0, 5, 20]);
    inject(&control, &["stuck-count", "GYRY", "counts=-321"]);
    let seen = client.samples.len();
    assert!(client.read_until(|client| client.samples.len() > seen + 4));
    inject(&control, &["--clear", "fault-1"]);
    let seen = client.samples.len();
    assert!(client.read_until(|client| client.samples.len() > seen + 2));
    inject(&control, &["dead", "GYRX", "id=acknowledged"]);
    let took: Vec<Duration> = (0..50).map(|_| command(&mut client, &[1])).collect();
    // On a host that is too busy to write within 10 ms an answer comes before; else it is killed at once.
    if took.iter().any(|took| *took >= Duration::from_millis(10)) {
        sleep(Duration::from_secs(1));
    }
    emulator.child.kill().expect("it runs");
    emulator.child.wait().expect("its end");
    let commands = fs::read_to_string(live.join("commands.jsonl")).expect("commands");
    assert_eq!(commands.lines().count(), 51, "each was acknowledged");
    let run = fs::read_to_string(live.join("run.toml")).expect("a run");
    assert!(run.contains("unfinished = true") && run.contains("id = \"acknowledged\""), "{run}");
    assert!(run.contains("until_s"), "the first fault was cleared: {run}");
    assert!(fs::metadata(live.join("link.bin")).expect("a link").len() >= 8 * 28, "recorded samples are on disk");
    assert_made_again(&live, &again);
    assert!(fs::read_to_string(again.join("truth.csv")).expect("a truth").contains("fault_counts"));
    assert!(fs::read_to_string(again.join("commands.jsonl")).expect("commands").starts_with(&commands));
    // Cut anywhere in the last rows, as after a crash of the machine.
    for name in ["truth.csv", "commands.jsonl"] {
        let whole = fs::read(live.join(name)).expect(name);
        fs::write(live.join(name), &whole[..whole.len() - 7]).expect("written");
    }
    fs::write(live.join("link.bin"), &fs::read(live.join("link.bin")).expect("a link")[..5 * 28 + 9]).expect("written");
    for name in ["reference.csv", "fss.csv", "sse.csv", "manoeuvres.csv"] {
        let whole = fs::read(live.join(name)).expect(name);
        fs::write(live.join(name), &whole[..whole.len() / 2]).expect("written");
    }
    fs::remove_dir_all(&again).expect("removed");
    simulate(&live, &again);
    assert!(
        fs::read(again.join("link.bin")).expect("a link").starts_with(&fs::read(live.join("link.bin")).expect("one"))
    );
}

#[test]
fn a_stalled_disk_delays_neither_cadence_nor_replies_nor_the_end() {
    let directory = directory();
    let (live, again) = (directory.path().join("live"), directory.path().join("again"));
    let Some(disk) = StalledDisk::new(&live, directory.path()) else { return skipped("no C compiler") };
    let mut run = recorded(&live, "127.0.0.1:0", &[]);
    disk.under(&mut run);
    let mut emulator = Emulator::of(run, 1);
    let control = emulator.control();
    let mut client = emulator.tcp();
    assert!(client.read_until(|client| client.samples.len() >= 2));
    disk.stall();
    let (start, before) = (Instant::now(), client.samples.len());
    let mut took: Vec<Duration> = Vec::new();
    // More events than a queue of the recorder holds.
    while took.len() < 1500 || start.elapsed() < Duration::from_millis(2500) {
        took.push(command(&mut client, &[1]));
    }
    took.sort();
    let usual = took[took.len() * 9 / 10];
    assert!(usual < Duration::from_millis(20), "nine in ten take up to {usual:?}; a busy host may hold up the tenth");
    let due = (start.elapsed().as_secs_f64() * 2.0) as usize;
    assert!(client.is_without_gap());
    assert!(client.samples.len() - before + 1 >= due, "{} of {due}", client.samples.len() - before);
    assert_eq!(status(&control)["recording"]["state"], "running", "64 MB may wait");
    let start = Instant::now();
    emulator.ask_to_end();
    let (code, said) = emulator.end();
    // It gives the disk half a second; the rest is for a loaded machine.
    assert!(start.elapsed() < Duration::from_millis(1500), "{:?}", start.elapsed());
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("is cut") && said.contains("geu simulate") && said.contains("samples"), "{said}");
    assert_made_again(&live, &again);
}

#[test]
fn a_disk_that_stalls_for_a_while_loses_nothing() {
    let directory = directory();
    let (live, again) = (directory.path().join("live"), directory.path().join("again"));
    let Some(disk) = StalledDisk::new(&live, directory.path()) else { return skipped("no C compiler") };
    let mut run = recorded(&live, "127.0.0.1:0", &["--speed", "max", "--duration", "20000", "--wait"]);
    disk.under(&mut run);
    let emulator = Emulator::of(run, 1);
    disk.stall();
    let mut stream = TcpStream::connect(emulator.ready[0].strip_prefix("tcp ").expect("a TCP link")).expect("a client");
    let reads = std::thread::spawn(move || stream.read_to_end(&mut Vec::new()));
    sleep(Duration::from_millis(1500));
    disk.go_on();
    let (code, said) = emulator.end();
    assert_eq!(code, Some(0), "{said}");
    let received = reads.join().expect("no panic").expect("an end");
    assert_eq!(received, 40_000 * 28, "the unit waited for its disk");
    assert_made_again(&live, &again);
    assert_eq!(fs::read(live.join("run.toml")).expect("one"), fs::read(again.join("run.toml")).expect("one"));
}

#[test]
fn a_run_without_deadlines_that_waits_for_its_disk_ends_when_asked() {
    let directory = directory();
    let live = directory.path().join("live");
    let Some(disk) = StalledDisk::new(&live, directory.path()) else { return skipped("no C compiler") };
    let mut run = recorded(&live, "off", &["--speed", "max"]);
    disk.under(&mut run);
    let emulator = Emulator::of(run, 1);
    disk.stall();
    sleep(Duration::from_millis(1500));
    let start = Instant::now();
    emulator.ask_to_end();
    let (code, said) = emulator.end();
    // It gives the disk half a second; the rest is for a loaded machine.
    assert!(start.elapsed() < Duration::from_millis(1500), "{:?}", start.elapsed());
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("is cut"), "{said}");
}

#[test]
fn a_run_whose_disk_hangs_from_the_start_ends_when_asked() {
    let directory = directory();
    let live = directory.path().join("live");
    let Some(disk) = StalledDisk::new(&live, directory.path()) else { return skipped("no C compiler") };
    let mut run = recorded(&live, "off", &[]);
    disk.under(&mut run);
    disk.stall();
    let mut emulator = Emulator::of(run, 0);
    sleep(Duration::from_millis(700));
    assert!(emulator.child.try_wait().expect("its state").is_none(), "it waits");
    let start = Instant::now();
    emulator.ask_to_end();
    let (code, said) = emulator.end();
    // It gives the disk half a second; the rest is for a loaded machine.
    assert!(start.elapsed() < Duration::from_millis(1500), "{:?}", start.elapsed());
    assert_eq!(code, Some(1), "{said}");
}

#[test]
fn a_full_disk_ends_the_recording_and_not_the_unit() {
    let directory = directory();
    let (live, again) = (directory.path().join("live"), directory.path().join("again"));
    let run = recorded(&live, "127.0.0.1:0", &["--speed", "10"]);
    // Writing a file beyond 20 kB fails.
    let mut full = Command::new("sh");
    full.args(["-c", "trap '' XFSZ; ulimit -f 40; exec \"$0\" \"$@\""]).arg(run.get_program()).args(run.get_args());
    let mut emulator = Emulator::of(full, 1);
    let control = emulator.control();
    let mut client = emulator.tcp();
    let start = Instant::now();
    while status(&control)["recording"]["state"] == "running" {
        assert!(start.elapsed() < Duration::from_secs(30), "it ends");
        client.read_for(Duration::from_millis(100), |_| false);
    }
    let recording = status(&control)["recording"].clone();
    assert!(recording["reason"].as_str().expect("a reason").contains("truth.csv"), "{recording}");
    let before = client.samples.len();
    assert!(client.read_until(|client| client.samples.len() > before + 5), "the emulation continues");
    command(&mut client, &[1]);
    assert!(client.is_without_gap());
    emulator.ask_to_end();
    let (code, said) = emulator.end();
    assert_eq!(code, Some(1), "{said}");
    assert_eq!(said.matches("emulation continues without it").count(), 1, "{said}");
    let run = fs::read_to_string(live.join("run.toml")).expect("a run");
    assert!(run.contains("ended_early = { half_second = ") && run.contains("truth.csv"), "{run}");
    assert_made_again(&live, &again);
}

#[test]
fn an_interrupted_simulation_leaves_a_complete_shorter_recording() {
    let directory = directory();
    let (live, again) = (directory.path().join("live"), directory.path().join("again"));
    let mut simulate = geu();
    simulate.args(["simulate", "--duration", "100000000", "--wire", "serial", "--out"]).arg(&live);
    let child = simulate.stderr(Stdio::piped()).spawn().expect("geu starts");
    let start = Instant::now();
    while fs::metadata(live.join("link.bin")).map_or(0, |link| link.len()) < 100_000 {
        assert!(start.elapsed() < Duration::from_secs(30), "it writes");
        sleep(Duration::from_millis(20));
    }
    kill(Pid::from_raw(child.id() as i32), Signal::SIGINT).expect("it runs");
    let output = child.wait_with_output().expect("its end");
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("interrupted after") && said.contains("of 100000000 s"), "{said}");
    assert!(!fs::read_to_string(live.join("run.toml")).expect("a run").contains("unfinished"));
    assert_made_again(&live, &again);
    assert_eq!(fs::read(live.join("link.bin")).expect("one"), fs::read(again.join("link.bin")).expect("one"));
}
