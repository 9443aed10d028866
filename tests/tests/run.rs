//! The emulator as its users meet it: the built program, real ptys and sockets, on the loopback only.

use std::fs::{self, File};
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::{MetadataExt, symlink};
use std::path::Path;
use std::process::{Child, Command};
use std::thread::sleep;
use std::time::{Duration, Instant};

use geu_protocol::CommandResult;
use geu_protocol::command::{COMMANDS, payload};
use geu_protocol::serial::{FrameType, frame};
use geu_tests::emulator::{Client, Emulator};
use geu_tests::{geu, skipped};
use nix::sys::signal::{Signal, kill};
use nix::unistd::{Group, Pid, getegid};

/// The limit of the interface control document.
const REPLY_WITHIN: Duration = Duration::from_millis(20);
/// Timeout of a test.
const PATIENCE: Duration = Duration::from_secs(8);

fn directory() -> tempfile::TempDir {
    tempfile::tempdir().expect("a directory")
}

#[test]
fn a_pty_gives_every_sample_and_a_client_that_comes_late_or_again_gets_the_present() {
    let directory = directory();
    let path = directory.path().join("geu0");
    let start = Instant::now();
    let _emulator = Emulator::start(1, &["--pty", path.to_str().unwrap()]);
    let on_board = || start.elapsed().as_secs_f64() * 2.0;

    sleep(Duration::from_millis(1200));
    let mut late = Client::open(&path);
    assert!(late.read_until(|client| client.samples.len() >= 3));
    assert!(late.is_without_gap());
    let first = f64::from(late.samples[0].sequence);
    assert!(first >= 1.0, "sample {first} is history");
    assert!((on_board() - f64::from(late.samples[2].sequence)) < 3.0, "half a second old at most, and a busy host");
    drop(late);

    sleep(Duration::from_millis(1200));
    let mut again = Client::open(&path);
    assert!(again.read_until(|client| client.samples.len() >= 2));
    assert!(again.is_without_gap());
    assert!(f64::from(again.samples[0].sequence) >= first + 4.0, "unread samples are not kept");
    assert_eq!(again.ask(&frame(FrameType::Command, &[1])).0.values(), [1, 0]);
}

#[test]
fn a_group_may_open_the_pty_and_an_unknown_one_is_refused() {
    let directory = directory();
    let path = directory.path().join("geu0");
    let own = Group::from_gid(getegid()).expect("groups are readable").expect("the own group has a name");
    let arguments = ["--pty", path.to_str().unwrap(), "--pty-group", &own.name];
    let emulator = Emulator::start(1, &arguments);
    let slave = fs::metadata(&path).expect("a pty");
    assert_eq!((slave.gid(), slave.mode() & 0o777), (own.gid.as_raw(), 0o660));
    drop(emulator);
    let output = geu().args(["run", "--pty-group", "no-such-group"]).output().expect("geu starts");
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && message.contains("expected a group of this machine"), "{message}");
}

#[test]
fn a_pty_opened_and_closed_over_and_over_still_serves() {
    let directory = directory();
    let path = directory.path().join("geu0");
    let _emulator = Emulator::start(1, &["--pty", path.to_str().unwrap()]);
    for round in 0..200 {
        let mut client = Client::open(&path);
        if round % 10 == 0 {
            assert_eq!(client.ask(&frame(FrameType::Command, &[1])).0.outcome(), CommandResult::Done, "round {round}");
        }
    }
    let (mut one, other) = (Client::open(&path), Client::open(&path));
    drop(other);
    assert!(one.read_until(|client| client.samples.len() >= 2), "a second client that leaves takes nothing away");
}

#[test]
fn two_tcp_clients_get_the_same_bytes_and_one_that_never_reads_costs_nothing() {
    let emulator = Emulator::start(1, &["--tcp", "127.0.0.1:0", "--wait", "--speed", "20", "--duration", "60"]);
    let (mut one, mut other) = (emulator.tcp(), emulator.tcp());
    let _never_reads = emulator.tcp();
    assert!(!one.read_until(|client| client.samples.len() > 120), "120 samples are all");
    other.read_until(|_| false);
    assert!(one.is_without_gap() && other.is_without_gap());
    let (one, other) = (&one.bytes, &other.bytes);
    // Who connects first may be served a sample earlier.
    let shorter = one.len().min(other.len());
    assert!(shorter >= 110 * 28, "{shorter} bytes");
    assert_eq!(one[one.len() - shorter..], other[other.len() - shorter..]);
}

#[test]
fn a_reader_that_stops_loses_whole_samples_and_nobody_else_any() {
    let emulator = Emulator::start(1, &["--tcp", "127.0.0.1:0", "--wait", "--speed", "max", "--duration", "5000"]);
    let (mut reads, mut stops) = (emulator.tcp(), emulator.tcp());
    reads.read_until(|_| false);
    assert!(reads.is_without_gap());
    assert_eq!(reads.samples.last().map(|last| last.clock_count), Some(10_000 * 500_000));
    stops.read_until(|_| false);
    assert_eq!(stops.defects, 0, "what comes is whole");
    let (_, said) = emulator.end();
    assert!(said.contains("samples 10000"), "{said}");
}

#[test]
fn a_path_that_is_not_an_old_link_is_refused() {
    let directory = directory();
    let path = directory.path().join("geu0");
    let refused = |expected: &str| {
        let output = geu().args(["run", "--duration", "1", "--pty"]).arg(&path).output().expect("geu starts");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(expected) && said.lines().count() == 1, "{said}");
    };
    fs::write(&path, "mine").unwrap();
    refused("a file");
    assert_eq!(fs::read(&path).unwrap(), b"mine");
    fs::remove_file(&path).unwrap();
    symlink("/dev/null", &path).unwrap();
    refused("/dev/null");
    fs::remove_file(&path).unwrap();
    let _other = Emulator::start(1, &["--pty", path.to_str().unwrap()]);
    refused("in use");
}

#[test]
fn it_ends_within_a_second_of_sigterm_and_takes_its_link_away_but_not_somebody_elses() {
    let directory = directory();
    let path = directory.path().join("geu0");
    symlink("/dev/pts/none", &path).unwrap();
    let emulator = Emulator::start(2, &["--pty", path.to_str().unwrap(), "--tcp", "127.0.0.1:0"]);
    let (_client, _never_reads) = (Client::open(&path), emulator.tcp());
    sleep(Duration::from_millis(600));
    let start = Instant::now();
    emulator.ask_to_end();
    let (code, said) = emulator.end();
    assert!(start.elapsed() < Duration::from_secs(1), "{:?}", start.elapsed());
    assert_eq!(code, Some(0), "{said}");
    assert!(path.symlink_metadata().is_err(), "the link is removed");
    assert!(said.contains("samples 1") && said.contains("lateness") && said.contains("link"), "{said}");

    let emulator = Emulator::start(1, &["--pty", path.to_str().unwrap()]);
    fs::remove_file(&path).unwrap();
    symlink("/dev/null", &path).unwrap();
    emulator.ask_to_end();
    assert_eq!(emulator.end().0, Some(0));
    assert_eq!(fs::read_link(&path).unwrap(), Path::new("/dev/null"));
}

/// All commands, right and wrong, with garbage and truncated commands between.
fn command_in_both_modes(client: &mut Client) {
    let mut took = Vec::new();
    let mut ask = |client: &mut Client, bytes: &[u8], outcome: CommandResult| {
        let (reply, time) = client.ask(bytes);
        assert_eq!(reply.outcome(), outcome, "{bytes:02X?}");
        took.push(time);
    };
    let command = |bytes: &[u8]| frame(FrameType::Command, bytes);
    for polled in [0, 1] {
        ask(client, &command(&[2, polled]), CommandResult::Done);
        for spec in COMMANDS.iter().filter(|spec| !["SET_MODE", "POLL", "SELF_TEST"].contains(&spec.name)) {
            let values: Vec<i64> = spec.arguments.iter().map(|argument| argument.range.1).collect();
            ask(client, &command(&payload(spec, &values)), CommandResult::Done);
        }
        let self_test = if polled == 0 { CommandResult::Done } else { CommandResult::NotPossibleNow };
        ask(client, &command(&[4, 15, 0, 5, 255]), self_test);
        sleep(Duration::from_millis(600));
        if polled == 0 {
            ask(client, &command(&[3]), CommandResult::NotPossibleNow);
        } else {
            let before = client.samples.len();
            ask(client, &command(&[3]), CommandResult::Done);
            ask(client, &command(&[3]), CommandResult::Done);
            assert!(client.read_until(|client| client.samples.len() >= before + 2));
            sleep(Duration::from_millis(700));
            client.read_for(Duration::from_millis(100), |_| false);
            assert_eq!(client.samples.len(), before + 2, "in polled mode data come when polled, and only then");
        }
        for wrong in [&[0xFF][..], &[0], &[8, 8, 8, 8, 8, 8, 8, 8]] {
            ask(client, &command(wrong), CommandResult::UnknownOpcode);
        }
        for wrong in [&[1, 1][..], &[2], &[2, 2], &[4, 1], &[6, 16], &[7, 2, 2]] {
            ask(client, &command(wrong), CommandResult::BadArgument);
        }
        let ping = command(&[1]);
        let mut wrong_crc = ping.clone();
        wrong_crc[6] ^= 0x40;
        let truncated = &command(&[4, 1, 0, 1, 1])[..6];
        for noise in [&b"garbage"[..], &[0xEB], &[0xEB, 0x90, 1, 22], &[0xEB, 0x90, 0x10, 0], &wrong_crc, truncated] {
            ask(client, &[noise, &ping].concat(), CommandResult::Done);
        }
        client.stream.write_all(truncated).unwrap();
        sleep(Duration::from_millis(50));
        ask(client, &ping, CommandResult::Done);
    }
    took.sort();
    let usual = took[took.len() * 9 / 10];
    assert!(usual < REPLY_WITHIN, "nine in ten take up to {usual:?}; a busy host may hold up the tenth");
}

#[test]
fn every_command_right_or_wrong_is_answered_over_tcp() {
    let (_emulator, mut client) = Emulator::on_tcp(&[]);
    command_in_both_modes(&mut client);
}

#[test]
fn every_command_right_or_wrong_is_answered_on_a_pty_and_only_there() {
    let directory = directory();
    let path = directory.path().join("geu0");
    let emulator = Emulator::start(2, &["--pty", path.to_str().unwrap(), "--tcp", "127.0.0.1:0"]);
    let mut other = emulator.tcp();
    command_in_both_modes(&mut Client::open(&path));
    other.read_for(Duration::from_millis(100), |_| false);
    assert_eq!(other.replies.len(), 0, "a reply goes only to who asked");
    assert_eq!(other.defects, 0);
}

#[test]
fn nothing_a_client_sends_stops_the_unit() {
    let (_emulator, mut client) = Emulator::on_tcp(&["--speed", "10"]);
    let mut state = 1u32;
    let noise: Vec<u8> = (0..200_000)
        .map(|index| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            if index % 7 == 0 {
                0xEB
            } else if index % 7 == 1 {
                0x90
            } else {
                (state >> 24) as u8 & 0x13
            }
        })
        .collect();
    for chunk in noise.chunks(1000) {
        client.stream.write_all(chunk).expect("it reads all the time");
        sleep(Duration::from_millis(2));
    }
    let before = client.samples.len();
    assert_eq!(client.ask(&frame(FrameType::Command, &[1])).0.outcome(), CommandResult::Done);
    assert!(client.read_until(|client| client.samples.len() > before + 3));
}

#[test]
fn every_command_has_its_reply_however_many_come_at_once() {
    const COUNT: usize = 5000;
    let (_emulator, mut client) = Emulator::on_tcp(&[]);
    let pings = frame(FrameType::Command, &[1]).repeat(COUNT);
    let (mut sent, start) = (0, Instant::now());
    while sent < pings.len() {
        match client.stream.write(&pings[sent..]) {
            Ok(length) => sent += length,
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                client.read_for(Duration::from_millis(1), |_| false);
            }
            Err(error) => panic!("{error}"),
        }
        assert!(start.elapsed() < PATIENCE);
    }
    assert!(client.read_until(|client| client.replies.len() >= COUNT), "{} replies", client.replies.len());
    client.read_for(Duration::from_millis(600), |_| false);
    assert_eq!((client.replies.len(), client.defects), (COUNT, 0));
    assert!(client.is_without_gap());
}

#[test]
fn a_client_that_floods_holds_nobody_else_up() {
    let (emulator, mut client) = Emulator::on_tcp(&[]);
    let mut floods = emulator.tcp();
    let (stop, stopped) = std::sync::mpsc::channel::<()>();
    let address = emulator.ready[0].strip_prefix("tcp ").unwrap().to_owned();
    let flood = std::thread::spawn(move || {
        let mut stream = TcpStream::connect(address).expect("the unit listens");
        let mut reads = stream.try_clone().expect("a socket");
        let reader = std::thread::spawn(move || while reads.read(&mut [0; 65536]).is_ok_and(|length| length > 0) {});
        let pings = frame(FrameType::Command, &[1]).repeat(1000);
        while stopped.try_recv().is_err() && stream.write_all(&pings).is_ok() {}
        drop(stream.shutdown(std::net::Shutdown::Both));
        reader.join().expect("no panic");
    });
    // A second one, that never reads its replies.
    let _ = floods.stream.write(&frame(FrameType::Command, &[1]).repeat(100_000));
    sleep(Duration::from_millis(200));
    let mut took: Vec<_> = (0..50).map(|_| client.ask(&frame(FrameType::Command, &[1])).1).collect();
    took.sort();
    assert!(took[25] < REPLY_WITHIN, "{:?}", took[25]);
    let start = Instant::now();
    emulator.ask_to_end();
    assert_eq!(emulator.end().0, Some(0));
    assert!(start.elapsed() < Duration::from_secs(1), "{:?}", start.elapsed());
    let _ = stop.send(());
    flood.join().expect("no panic");
}

#[test]
fn clients_that_come_ask_and_go_in_polled_mode_leave_no_place_taken() {
    let (emulator, mut first) = Emulator::on_tcp(&[]);
    first.ask(&frame(FrameType::Command, &[2, 1]));
    for round in 0..200 {
        let (reply, _) = emulator.tcp().ask(&frame(FrameType::Command, &[1]));
        assert_eq!(reply.outcome(), CommandResult::Done, "round {round}");
    }
    assert_eq!(emulator.tcp().ask(&frame(FrameType::Command, &[1])).0.outcome(), CommandResult::Done);
    assert_eq!(first.ask(&frame(FrameType::Command, &[1])).0.outcome(), CommandResult::Done);
}

#[test]
fn a_stopped_process_sends_no_burst_and_reports_once() {
    let (emulator, mut client) = Emulator::on_tcp(&[]);
    assert!(client.read_until(|client| !client.samples.is_empty()));
    let pid = Pid::from_raw(emulator.child.id() as i32);
    kill(pid, Signal::SIGSTOP).expect("it runs");
    sleep(Duration::from_millis(2300));
    kill(pid, Signal::SIGCONT).expect("it stands");
    let before = client.samples.len();
    client.read_for(Duration::from_millis(300), |_| false);
    let after = client.samples.len();
    assert!(after <= before + 2, "at most a late and a due sample, not {}", after - before);
    assert!(client.read_until(|client| client.samples.len() >= after + 2));
    let missed = client.samples[before].sequence - client.samples[before - 1].sequence - 1;
    assert!((3..=5).contains(&missed), "{missed} samples missing");
    assert!(client.samples[before..].windows(2).all(|pair| pair[1].sequence == pair[0].sequence + 1));
    emulator.ask_to_end();
    let (_, said) = emulator.end();
    assert_eq!(said.matches("not sent").count(), 1, "{said}");
    assert!(said.contains(&format!("missed {missed}")), "{said}");
}

#[test]
fn the_same_bytes_come_at_any_speed_and_are_those_of_simulate() {
    let at = |speed: &str| {
        let arguments = ["--wait", "--duration", "100", "--seed", "7", "--speed", speed];
        let (emulator, mut client) = Emulator::on_tcp(&arguments);
        client.read_until(|_| false);
        let (code, said) = emulator.end();
        assert_eq!(code, Some(0), "{said}");
        assert!(client.is_without_gap());
        client.bytes
    };
    let fast = at("max");
    assert_eq!(fast.len(), 200 * 28);
    assert_eq!(fast, at("50"));
    let directory = directory();
    let mut simulate = geu();
    simulate.args(["simulate", "--wire", "serial", "--duration", "100", "--seed", "7", "--out"]).arg(directory.path());
    assert!(simulate.output().expect("geu starts").status.success());
    assert_eq!(fast, fs::read(directory.path().join("link.bin")).unwrap());
}

#[test]
fn a_recorded_run_with_commands_is_simulated_again_byte_for_byte() {
    let directory = directory();
    let (live, again) = (directory.path().join("live"), directory.path().join("again"));
    let arguments =
        ["--record", live.to_str().unwrap(), "--wire", "serial", "--speed", "10", "--duration", "20", "--wait"];
    let (emulator, mut client) = Emulator::on_tcp(&arguments);
    for command in [&[4, 1, 0, 50, 5][..], &[5], &[6, 7], &[2, 1], &[3], &[3], &[9], &[2, 0], &[7, 0]] {
        client.ask(&frame(FrameType::Command, command));
        sleep(Duration::from_millis(90));
    }
    client.read_until(|_| false);
    let (code, said) = emulator.end();
    assert_eq!(code, Some(0), "{said}");
    assert_simulated_again(&live, &again, "link.bin");
}

#[test]
fn a_recorded_run_with_commands_at_any_moment_is_simulated_again_byte_for_byte() {
    let directory = directory();
    let (live, again) = (directory.path().join("live"), directory.path().join("again"));
    let arguments =
        ["--record", live.to_str().unwrap(), "--wire", "serial", "--speed", "50", "--duration", "100", "--wait"];
    let (emulator, mut client) = Emulator::on_tcp(&arguments);
    let payloads: [&[u8]; 8] = [&[1], &[2, 1], &[3], &[5], &[4, 3, 0, 7, 2], &[3], &[6, 5], &[2, 0]];
    let mut state = 5u32;
    while !client.is_over {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let _ = client.stream.write_all(&frame(FrameType::Command, payloads[(state >> 29) as usize]));
        let count = client.replies.len();
        client.read_for(Duration::from_millis(100), |client| client.replies.len() > count);
        sleep(Duration::from_micros(u64::from(state >> 8) % 3000));
    }
    let (code, said) = emulator.end();
    assert_eq!(code, Some(0), "{said}");
    assert!(client.replies.len() > 200, "{} replies", client.replies.len());
    assert_simulated_again(&live, &again, "link.bin");
}

#[test]
fn commands_of_the_sample_that_never_ended_are_simulated_again_too() {
    let directory = directory();
    let (live, again) = (directory.path().join("live"), directory.path().join("again"));
    let (emulator, mut client) = Emulator::on_tcp(&["--record", live.to_str().unwrap()]);
    client.ask(&frame(FrameType::Command, &[2, 1]));
    sleep(Duration::from_millis(1200));
    for _ in 0..2 {
        assert_eq!(client.ask(&frame(FrameType::Command, &[3])).0.outcome(), CommandResult::Done);
    }
    emulator.ask_to_end();
    assert_eq!(emulator.end().0, Some(0));
    let commands = fs::read_to_string(live.join("commands.jsonl")).unwrap();
    assert_eq!(commands.lines().count(), 3);
    assert_simulated_again(&live, &again, "link.bin");
    assert!(fs::read(again.join("link.bin")).unwrap().len() >= 2 * 28);
}

fn assert_simulated_again(live: &Path, again: &Path, link: &str) {
    let mut simulate = geu();
    simulate.arg("simulate").arg(live.join("run.toml")).arg("--out").arg(again);
    let output = simulate.output().expect("geu starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    for name in [link, "truth.csv", "reference.csv", "commands.jsonl", "run.toml"] {
        let (live, again) = (fs::read(live.join(name)).unwrap(), fs::read(again.join(name)).unwrap());
        assert!(live == again, "{name} differs: {} and {} bytes", live.len(), again.len());
    }
}

/// A pair of linked ptys, as a cable between two serial ports.
struct Cable(Child);

impl Cable {
    fn plug(one: &Path, other: &Path) -> Option<Cable> {
        let end = |path: &Path| format!("pty,raw,echo=0,link={}", path.display());
        let cable = Cable(Command::new("socat").arg(end(one)).arg(end(other)).spawn().ok()?);
        let start = Instant::now();
        while !(one.exists() && other.exists()) {
            assert!(start.elapsed() < PATIENCE, "socat makes its links");
            sleep(Duration::from_millis(10));
        }
        Some(cable)
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        // Asked to end, not killed: it takes its links away.
        let _ = kill(Pid::from_raw(self.0.id() as i32), Signal::SIGTERM);
        let _ = self.0.wait();
    }
}

#[test]
fn a_serial_adapter_unplugged_and_back_is_served_again() {
    let directory = directory();
    let (port, far) = (directory.path().join("port"), directory.path().join("far"));
    let Some(cable) = Cable::plug(&port, &far) else { return skipped("socat absent") };
    let emulator = Emulator::start(1, &["--serial", port.to_str().unwrap()]);
    assert_eq!(emulator.ready, [format!("serial {} 115200", port.display())]);
    let mut client = Client::open(&far);
    assert_eq!(client.ask(&frame(FrameType::Command, &[1])).0.outcome(), CommandResult::Done);
    assert!(client.read_until(|client| client.samples.len() >= 2));
    let before = client.samples[1].sequence;
    drop((client, cable));
    sleep(Duration::from_millis(800));
    let cable = Cable::plug(&port, &far);
    let mut client = Client::open(&far);
    assert!(client.read_until(|client| client.samples.len() >= 2), "it comes back by itself");
    assert!(client.samples[0].sequence > before, "the unit kept time");
    assert_eq!(client.ask(&frame(FrameType::Command, &[1])).0.outcome(), CommandResult::Done);
    emulator.ask_to_end();
    let (_, said) = emulator.end();
    assert_eq!((said.matches("gone").count(), said.matches("is back").count()), (1, 1), "reported once each: {said}");
    drop(cable);
}

#[test]
fn a_link_that_is_not_there_is_bad_input_with_one_message() {
    for (arguments, expected) in [
        (&["--serial", "/dev/no-such-port"][..], "/dev/no-such-port"),
        (&["--tcp", "127.0.0.1"], "127.0.0.1"),
        (&["--can", "nocan0"], "nocan0"),
        (&["--can", "vcan0:FFF"], "FFF"),
        (&["--control", "127.0.0.1"], "--control 127.0.0.1"),
        (&["--control", "0.0.0.0:0"], "--control-token"),
        (&["--speed", "0"], "max"),
        (&["--wait", "--can", "nocan0"], "--wait"),
        (&["--pty", "/no/such/directory/geu0"], "/no/such/directory/geu0"),
    ] {
        let output = geu().args(["run", "--duration", "1"]).args(arguments).output().expect("geu starts");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(expected), "{arguments:?}: {said}");
    }
}

#[test]
fn send_takes_names_and_reports_the_result() {
    let directory = directory();
    let path = directory.path().join("geu0");
    let emulator = Emulator::start(2, &["--pty", path.to_str().unwrap(), "--tcp", "127.0.0.1:0"]);
    let address = emulator.ready.iter().find_map(|ready| ready.strip_prefix("tcp ")).unwrap();
    let send = |arguments: &[&str]| {
        let output = geu().arg("send").args(arguments).output().expect("geu starts");
        (output.status.code(), String::from_utf8_lossy(&output.stdout).into_owned())
    };
    for link in [path.to_str().unwrap(), address, &format!("tcp:{address}")] {
        assert_eq!(send(&[link, "ping"]), (Some(0), "PING: done  major 1  minor 0\n".to_owned()), "{link}");
        assert_eq!(send(&[link, "poll"]).0, Some(1));
        assert_eq!(send(&[link, "set-mode", "1"]).0, Some(0));
        sleep(Duration::from_millis(600));
        let (code, said) = send(&[link, "POLL"]);
        assert!(code == Some(0) && said.contains("sequence"), "{said}");
        assert_eq!(send(&[link, "SET_MODE", "0"]).0, Some(0));
        assert_eq!(send(&[link, "--raw", "0909"]), (Some(1), "09: unknown opcode\n".to_owned()));
        assert_eq!(send(&[link, "no-such-command"]).0, Some(2));
    }
    assert_eq!(send(&["/no/such/pty", "PING"]).0, Some(2));
    assert!(File::open(&path).is_ok());
}
