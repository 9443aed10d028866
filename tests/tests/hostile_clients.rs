//! Misbehaving clients, and processes that compete for a link, do not disturb other clients.

use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::{OpenOptionsExt, symlink};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use geu_protocol::CommandResult;
use geu_protocol::serial::{FrameType, frame};
use geu_tests::emulator::{Client, Emulator};
use geu_tests::geu;
use geu_tests::pty::open_pty;
use nix::libc::O_NOCTTY;
use nix::sys::signal::{Signal, kill};
use nix::sys::stat::Mode;
use nix::unistd::{Pid, mkfifo};

/// Timeout of a test.
const PATIENCE: Duration = Duration::from_secs(8);

fn directory() -> tempfile::TempDir {
    tempfile::tempdir().expect("a directory")
}

fn ping() -> Vec<u8> {
    frame(FrameType::Command, &[1])
}

/// Asks it to end, and expects that within a second; what it said.
fn end_within_a_second(emulator: Emulator) -> String {
    let start = Instant::now();
    emulator.ask_to_end();
    let (code, said) = emulator.end();
    assert!(start.elapsed() < Duration::from_secs(1), "{:?}: {said}", start.elapsed());
    assert_eq!(code, Some(0), "{said}");
    said
}

/// Writes commands to a pty, reads nothing, and closes it.
fn command_and_leave(path: &Path, commands: usize, pause: Duration) {
    let mut client = OpenOptions::new().write(true).custom_flags(O_NOCTTY).open(path).expect("a pty");
    for _ in 0..commands {
        client.write_all(&ping()).expect("the unit reads");
        sleep(pause);
    }
}

/// Reads until no reply comes for longer than a command of any client before can be waiting.
fn read_all_replies(client: &mut Client) {
    let mut before = usize::MAX;
    while std::mem::replace(&mut before, client.replies.len()) != client.replies.len() {
        client.read_for(Duration::from_millis(700), |_| false);
    }
}

#[test]
fn a_pty_client_that_reads_no_reply_and_closes_wedges_nothing() {
    let directory = directory();
    let path = directory.path().join("geu0");
    let emulator = Emulator::start(2, &["--pty", path.to_str().unwrap(), "--tcp", "127.0.0.1:0"]);
    let mut other = emulator.tcp();
    // Replies of a byte less than four thousand fill the pty; two thousand commands fill it four times.
    for (commands, pause) in [(2500, Duration::from_micros(500)), (2500, Duration::ZERO), (1, Duration::ZERO)] {
        command_and_leave(&path, commands, pause);
        assert_eq!(other.ask(&ping()).0.outcome(), CommandResult::Done);
    }
    // As `printf … > /tmp/geu0` does: a client that came and went is heard.
    for _ in 0..20 {
        command_and_leave(&path, 1, Duration::ZERO);
    }
    let mut again = Client::open(&path);
    read_all_replies(&mut again);
    assert_eq!(again.ask(&ping()).0.outcome(), CommandResult::Done);
    assert!(other.read_until(|client| client.samples.len() >= 2) && other.is_without_gap());
    let said = end_within_a_second(emulator);
    assert!(said.contains("commands     5025 received, 0 frames dropped"), "each is carried out: {said}");
    assert!(said.contains("replies dropped"), "unread replies are counted: {said}");
    assert!(path.symlink_metadata().is_err(), "the link is removed");
    assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 0, "nothing else is left");
}

#[test]
fn commands_of_a_tcp_client_that_leaves_at_once_are_carried_out() {
    let (emulator, mut other) = Emulator::on_tcp(&[]);
    let address = emulator.ready[0].strip_prefix("tcp ").unwrap();
    // It leaves with unread samples and replies, so that writes to it fail before all its commands are read.
    for _ in 0..5 {
        let mut client = TcpStream::connect(address).expect("the unit listens");
        client.write_all(&ping().repeat(70)).expect("the unit reads");
    }
    sleep(Duration::from_secs(3));
    assert_eq!(other.ask(&ping()).0.outcome(), CommandResult::Done);
    let said = end_within_a_second(emulator);
    assert!(said.contains("commands     351 received, 0 frames dropped"), "each is carried out: {said}");
}

#[test]
fn a_pty_client_that_stalls_with_the_pty_open_is_served_again_when_it_reads() {
    let directory = directory();
    let path = directory.path().join("geu0");
    let emulator = Emulator::start(1, &["--pty", path.to_str().unwrap()]);
    let mut client = Client::open(&path);
    let (pings, mut sent, start) = (ping().repeat(2500), 0, Instant::now());
    // Commands are read though their replies are not, so that all of them are accepted. A full pty may accept a part of one.
    while sent < pings.len() && start.elapsed() < PATIENCE {
        match client.stream.write(&pings[sent..]) {
            Ok(length) if length > 0 => sent += length,
            Err(error) if error.kind() != ErrorKind::WouldBlock => panic!("{error}"),
            _ => sleep(Duration::from_millis(1)),
        }
    }
    assert_eq!(sent, pings.len());
    // The line takes 0.7 ms for a reply.
    sleep(Duration::from_millis(2500));
    read_all_replies(&mut client);
    assert!(client.replies.len() < 2500, "the pty cannot hold all replies");
    assert_eq!(client.defects, 0, "what comes is whole");
    assert_eq!(client.ask(&ping()).0.outcome(), CommandResult::Done);
    drop(client);
    let said = end_within_a_second(emulator);
    assert!(said.contains("commands     2501 received") && said.contains("replies dropped"), "{said}");
}

#[test]
fn a_replay_outlives_the_same_client() {
    let directory = directory();
    let (path, recording) = (directory.path().join("geu0"), directory.path().join("day"));
    let mut simulate = geu();
    simulate.args(["simulate", "--duration", "60", "--wire", "serial", "--out"]).arg(&recording);
    assert!(simulate.output().expect("geu starts").status.success());
    let mut replay = geu();
    replay.arg("replay").arg(recording.join("link.bin")).arg("--pty").arg(&path);
    let mut replay = replay.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().expect("geu starts");
    let mut ready = [0; 6];
    replay.stdout.take().expect("a pipe").read_exact(&mut ready).expect("a line");
    for _ in 0..2 {
        command_and_leave(&path, 2500, Duration::ZERO);
    }
    assert!(Client::open(&path).read_until(|client| client.samples.len() >= 2));
    kill(Pid::from_raw(replay.id() as i32), Signal::SIGTERM).expect("it runs");
    assert!(ends_within(&mut replay, Duration::from_secs(1)), "it ends when asked");
}

fn ends_within(child: &mut Child, limit: Duration) -> bool {
    let start = Instant::now();
    while start.elapsed() < limit {
        if child.try_wait().expect("a child").is_some() {
            return true;
        }
        sleep(Duration::from_millis(2));
    }
    child.kill().expect("it runs");
    child.wait().expect("its end");
    false
}

#[test]
fn readers_that_a_faster_run_waits_for_do_not_delay_its_end() {
    for speed in ["50", "max"] {
        let emulator = Emulator::start(1, &["--tcp", "127.0.0.1:0", "--speed", speed, "--wait"]);
        let never_read: Vec<_> = (0..20).map(|_| emulator.tcp()).collect();
        sleep(Duration::from_millis(700));
        end_within_a_second(emulator);
        drop(never_read);
    }
}

#[test]
fn a_client_that_speaks_http_is_closed_and_none_of_its_bytes_are_a_command() {
    let (emulator, mut good) = Emulator::on_tcp(&[]);
    let address = emulator.ready[0].strip_prefix("tcp ").unwrap();
    let power_off = frame(FrameType::Command, &[6, 0]);
    let post = [
        format!("POST / HTTP/1.1\r\nHost: {address}\r\nContent-Length: {}\r\n\r\n", power_off.len()).as_bytes(),
        &power_off,
    ]
    .concat();
    for chunk_bytes in [1, 3, post.len()] {
        let mut page = TcpStream::connect(address).expect("the unit listens");
        page.set_nodelay(true).expect("a socket");
        page.set_read_timeout(Some(PATIENCE)).expect("a socket");
        // It may be closed before all is sent.
        let _ = post.chunks(chunk_bytes).try_for_each(|chunk| page.write_all(chunk));
        let mut received = Vec::new();
        let end = page.read_to_end(&mut received);
        let is_closed = end.as_ref().map_or_else(|error| error.kind() == ErrorKind::ConnectionReset, |_| true);
        assert!(is_closed, "{end:?}");
    }
    assert_eq!(good.ask(&ping()).0.outcome(), CommandResult::Done);
    let said = end_within_a_second(emulator);
    assert!(said.contains("commands     1 received") && said.contains("3 connections refused"), "{said}");
    assert!(said.contains("speaks HTTP"), "{said}");
}

#[test]
fn a_tcp_link_that_other_machines_reach_asks_whom_to_let_in() {
    let run = |arguments: &[&str]| {
        let mut run = geu();
        run.args(["run", "--duration", "0.5", "--speed", "max", "--control", "off"]).args(arguments);
        let output = run.output().expect("geu starts");
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, said) = run(&["--tcp", "0.0.0.0:0"]);
    assert!(code == Some(2) && said.contains("--tcp-allow"), "{said}");
    let (code, said) = run(&["--tcp", "0.0.0.0:0", "--tcp-allow", "192.168.7.0/33"]);
    assert!(code == Some(2) && said.contains("192.168.7.0/24"), "an example is shown: {said}");
    let (code, said) = run(&["--tcp", "0.0.0.0:0", "--tcp-allow", "192.168.7.0/24", "--tcp-allow", "10.0.0.1"]);
    assert_eq!(code, Some(0), "{said}");
}

#[test]
fn of_emulators_that_start_together_on_one_path_one_has_it() {
    let directory = directory();
    for round in 0..6 {
        let path = directory.path().join(format!("geu{round}"));
        let start = || {
            let mut run = geu();
            run.args(["run", "--control", "off", "--pty"]).arg(&path);
            run.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("geu starts")
        };
        let mut started: Vec<Child> = (0..4).map(|_| start()).collect();
        let begun = Instant::now();
        let mut refused = Vec::new();
        while refused.len() < 3 {
            assert!(begun.elapsed() < PATIENCE, "{} of 3 are refused", refused.len());
            let is_over = |child: &mut Child| child.try_wait().expect("a child").is_some();
            refused.extend(started.extract_if(.., is_over));
            sleep(Duration::from_millis(5));
        }
        for child in refused {
            let end = child.wait_with_output().expect("its end");
            let said = String::from_utf8_lossy(&end.stderr);
            assert!(end.status.code() == Some(2) && said.contains("in use"), "{said}");
        }
        let mut has_it = started.pop().expect("the fourth");
        kill(Pid::from_raw(has_it.id() as i32), Signal::SIGTERM).expect("it runs");
        assert!(has_it.wait().expect("its end").success());
    }
    assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 0, "links and locks are removed");
}

#[test]
fn a_link_that_a_killed_emulator_left_is_taken_over_even_where_its_pty_is_somebody_elses_by_now() {
    let directory = directory();
    let path = directory.path().join("geu0");
    let mut killed = Emulator::start(1, &["--pty", path.to_str().unwrap()]);
    killed.child.kill().unwrap();
    killed.child.wait().unwrap();
    drop(killed);
    assert!(path.symlink_metadata().is_ok(), "it could not remove it");
    // The number of its pty is in use again, as after some hours on a bench.
    let (_master, _slave, name) = open_pty();
    fs::remove_file(&path).unwrap();
    symlink(&name, &path).unwrap();
    fs::write(directory.path().join("geu0.lock"), format!("geu pty {name}\n")).unwrap();
    end_within_a_second(Emulator::start(1, &["--pty", path.to_str().unwrap()]));

    // A symlink without the lock file of an emulator belongs to another program.
    symlink(&name, &path).unwrap();
    let refused = geu().args(["run", "--duration", "1", "--pty"]).arg(&path).output().expect("geu starts");
    assert_eq!(refused.status.code(), Some(2));
    assert_eq!(fs::read_link(&path).unwrap(), Path::new(&name));
}

#[test]
fn no_file_beside_the_link_is_touched_that_is_somebody_elses() {
    let directory = directory();
    let path = directory.path().join("geu0");
    // The shell and the emulator that takes its place have one process identifier.
    let mut run = Command::new("sh");
    run.args(["-c", "echo mine > \"$1.$$\"; exec \"$0\" run --control off --speed max --duration 1 --pty \"$1\""]);
    let output = run.arg(geu().get_program()).arg(&path).output().expect("a shell");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let left: Vec<_> = fs::read_dir(directory.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(left.len(), 1, "{left:?}");
    assert_eq!(fs::read(&left[0]).unwrap(), b"mine\n");

    let lock = directory.path().join("geu0.lock");
    // A file that a person or `flock` made, with something in it or nothing.
    for content in ["my own notes", ""] {
        fs::write(&lock, content).unwrap();
        let refused = geu().args(["run", "--duration", "1", "--pty"]).arg(&path).output().expect("geu starts");
        assert_eq!(refused.status.code(), Some(2), "{}", String::from_utf8_lossy(&refused.stderr));
        assert_eq!(fs::read(&lock).unwrap(), content.as_bytes());
    }
    fs::remove_file(&lock).unwrap();
    mkfifo(&lock, Mode::S_IRWXU).unwrap();
    let refused = geu().args(["run", "--duration", "1", "--pty"]).arg(&path).output().expect("geu starts");
    assert_eq!(refused.status.code(), Some(2), "{}", String::from_utf8_lossy(&refused.stderr));
}

#[test]
fn a_process_out_of_descriptors_says_so_and_its_links_recover() {
    let directory = directory();
    let path = directory.path().join("geu0");
    let limited = |limit: u32, arguments: &[&str]| {
        let mut run = Command::new("sh");
        run.args(["-c", &format!("ulimit -n {limit}; exec \"$0\" \"$@\"")]).arg(geu().get_program()).arg("run");
        run.arg("--pty").arg(&path).args(["--tcp", "127.0.0.1:0"]).args(arguments);
        run.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        run
    };
    for limit in [10, 16, 18, 24, 32, 64] {
        let output = limited(limit, &["--duration", "1"]).output().expect("a shell");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(matches!(output.status.code(), Some(1 | 2)), "{limit}: {said}");
        assert!(said.lines().count() == 1 && !said.contains("panicked"), "{limit}: {said}");
    }

    let emulator = Emulator::of(limited(128, &["--control", "127.0.0.1:0"]), 2);
    let mut clients: Vec<_> = (0..120).map(|_| emulator.tcp()).collect();
    let mut first = Client::open(&path);
    assert_eq!(first.ask(&ping()).0.outcome(), CommandResult::Done, "a pty needs no descriptor of the clients");
    drop(first);
    assert_eq!(clients[0].ask(&ping()).0.outcome(), CommandResult::Done);
    clients.clear();
    assert_eq!(Client::open(&path).ask(&ping()).0.outcome(), CommandResult::Done);
    let start = Instant::now();
    while !emulator.tcp().read_for(Duration::from_secs(1), |client| !client.samples.is_empty()) {
        assert!(start.elapsed() < PATIENCE, "places are free again");
    }
    let said = end_within_a_second(emulator);
    assert!(
        said.contains("refused, further refusals are only counted") && said.contains("connections refused"),
        "{said}"
    );
}

#[test]
fn a_replay_whose_input_stands_still_ends_when_asked() {
    let directory = directory();
    let recording = directory.path().join("day");
    let mut simulate = geu();
    simulate.args(["simulate", "--duration", "60", "--out"]).arg(&recording);
    assert!(simulate.output().expect("geu starts").status.success());
    let packed = Command::new("gzip").arg("-c").arg(recording.join("link.log")).output().expect("gzip");
    let mut replay = geu();
    replay.args(["replay", "-", "--tcp", "127.0.0.1:0", "--speed", "max"]);
    let mut replay = replay.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().expect("geu");
    // All of it, and no end: another member may follow. Smaller than a pipe, so that nothing blocks here.
    assert!(packed.stdout.len() < 65_536, "{} bytes", packed.stdout.len());
    let mut input = replay.stdin.take().expect("a pipe");
    input.write_all(&packed.stdout).expect("written");
    let mut ready = [0; 6];
    replay.stdout.take().expect("a pipe").read_exact(&mut ready).expect("a line");
    sleep(Duration::from_millis(300));
    kill(Pid::from_raw(replay.id() as i32), Signal::SIGTERM).expect("it runs");
    // Clients and the reader of the recording have 0.3 s each.
    assert!(ends_within(&mut replay, Duration::from_millis(1500)), "it ends when asked");
    drop(input);
}
