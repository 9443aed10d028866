//! A recording played back, as its users meet it: the built program, on the loopback only.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, ChildStdin, Stdio};
use std::time::{Duration, Instant};

use geu_protocol::Sample;
use geu_protocol::serial::{Deframer, DeframerEvent, FrameType, MAX_FRAME, frame, read_data};
use geu_tests::geu;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

/// Timeout of a test.
const PATIENCE: Duration = Duration::from_secs(20);

/// Records the reference unit in a link format; returns the bytes of the link.
fn record(directory: &Path, wire: &str, duration_s: u32) -> (String, Vec<u8>) {
    let out = directory.join(wire);
    let mut command = geu();
    command.args(["simulate", "--wire", wire, "--duration", &duration_s.to_string(), "--out"]).arg(&out);
    assert!(command.stderr(Stdio::null()).status().expect("geu starts").success());
    let path = out.join(if wire == "can" { "link.log" } else { "link.bin" });
    (path.to_str().expect("text").to_owned(), fs::read(path).expect("a recording"))
}

/// A running `geu replay` on TCP and its client; ended when it goes.
struct Replay {
    child: Child,
    input: Option<ChildStdin>,
    stream: TcpStream,
}

impl Replay {
    fn start(arguments: &[&str]) -> Replay {
        let mut command = geu();
        command.args(["replay", "--wait", "--tcp", "127.0.0.1:0"]).args(arguments);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().expect("geu starts");
        let mut line = String::new();
        BufReader::new(child.stdout.take().expect("a pipe")).read_line(&mut line).expect("text");
        let address = line.trim().strip_prefix("ready tcp ").unwrap_or_else(|| panic!("unexpected {line:?}"));
        let stream = TcpStream::connect(address).expect("it listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
        Replay { input: child.stdin.take(), child, stream }
    }

    fn read_exactly(&mut self, length: usize) -> Vec<u8> {
        let mut bytes = vec![0; length];
        self.stream.read_exact(&mut bytes).expect("the bytes");
        bytes
    }

    /// Reads to the end: bytes, and what it said on standard error.
    fn end(mut self) -> (Vec<u8>, String) {
        let (mut bytes, mut said) = (Vec::new(), String::new());
        self.stream.read_to_end(&mut bytes).expect("an end");
        self.child.stderr.take().expect("a pipe").read_to_string(&mut said).expect("text");
        assert_eq!(self.child.wait().expect("its end").code(), Some(0), "{said}");
        (bytes, said)
    }
}

impl Drop for Replay {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn samples(bytes: &[u8]) -> Vec<Sample> {
    let mut found = Vec::new();
    Deframer::default().finish(bytes, &mut |one| {
        if let DeframerEvent::Frame { kind: FrameType::Data, payload, .. } = one {
            found.push(read_data(payload));
        }
    });
    found
}

#[test]
fn serial_bytes_come_as_they_were_with_all_that_is_wrong_in_them() {
    let directory = tempfile::tempdir().expect("a directory");
    let (path, mut bytes) = record(directory.path(), "serial", 30);
    let (received, said) = Replay::start(&[&path, "--speed", "max"]).end();
    assert_eq!(received, bytes);
    assert!(said.contains("samples 60 of the recording"), "{said}");

    bytes[40] ^= 1;
    bytes.drain(100..105);
    bytes.splice(300..300, frame(FrameType::Reply, &[1, 0, 1, 0]).into_iter().chain([0xEB; 9000]));
    bytes.extend([0xEB, 0x90, 1]);
    fs::write(&path, &bytes).expect("written");
    let (received, _) = Replay::start(&[&path, "--speed", "max"]).end();
    assert_eq!(received, bytes);
    let (twice, said) = Replay::start(&[&path, &path, "--speed", "1000"]).end();
    assert_eq!(twice, [&bytes[..], &bytes].concat(), "{said}");

    bytes.splice(0..0, vec![0; 3_000_000]);
    fs::write(&path, &bytes).expect("written");
    let (received, _) = Replay::start(&[&path, "--speed", "max"]).end();
    assert!(received == bytes, "noise before the first frame");
}

#[test]
fn a_can_recording_gives_the_serial_bytes_of_its_samples() {
    let directory = tempfile::tempdir().expect("a directory");
    let ((can, log), (_, bytes)) = (record(directory.path(), "can", 30), record(directory.path(), "serial", 30));
    let (received, _) = Replay::start(&[&can, "--speed", "max"]).end();
    assert_eq!(received, bytes);
    let (received, _) = Replay::start(&[&can, "--speed", "max", "--from", "5", "--to", "10"]).end();
    assert_eq!(received, bytes[10 * MAX_FRAME..20 * MAX_FRAME]);

    // A sample without CLOCK, a sample with a wrong CRC, other traffic and another interface between.
    let text = String::from_utf8(log).expect("text");
    let lines: Vec<&str> = text.lines().collect();
    let mut changed: Vec<String> = lines.iter().map(|line| (*line).to_owned()).collect();
    changed[10] = changed[10].replace("1A1#", "1A1#FF").replacen("FF00", "FF", 1);
    changed[5] = changed[4].replace("can0 1A1", "can1 1A0");
    changed.insert(4, changed[4].split_once(' ').expect("a time").0.to_owned() + " can0 123#00");
    fs::write(&can, changed.join("\n")).expect("written");
    let (received, said) = Replay::start(&[&can, "--speed", "max"]).end();
    let left: Vec<u16> = samples(&received).iter().map(|sample| sample.sequence).collect();
    assert_eq!(left, (0..60).filter(|sequence| ![1, 3].contains(sequence)).collect::<Vec<u16>>(), "{said}");
    assert!(said.contains("5 frames and 0 bytes outside of complete samples, 1 of commands"), "{said}");
    assert!(said.contains("1 frames of other interfaces"), "{said}");
}

#[test]
fn it_goes_at_its_own_pace_answers_nothing_and_ends_when_asked() {
    let directory = tempfile::tempdir().expect("a directory");
    let (path, bytes) = record(directory.path(), "serial", 10);
    let mut replay = Replay::start(&[&path, "--loop"]);
    replay.stream.write_all(&frame(FrameType::Command, &[1])).expect("written");
    let first = replay.read_exactly(MAX_FRAME);
    let start = Instant::now();
    let next = replay.read_exactly(4 * MAX_FRAME);
    let took = start.elapsed();
    assert!((1.8..3.0).contains(&took.as_secs_f64()), "{took:?}");
    assert_eq!([first, next].concat(), bytes[..5 * MAX_FRAME]);
    let asked = Instant::now();
    kill(Pid::from_raw(replay.child.id() as i32), Signal::SIGTERM).expect("it runs");
    let (rest, said) = replay.end();
    assert!(asked.elapsed() < Duration::from_secs(2) && rest.len() <= 2 * MAX_FRAME, "{:?}", asked.elapsed());
    assert!(said.contains("replay sends no replies") && said.contains("1 without a reply"), "{said}");
    assert!(said.contains("0 replies"), "{said}");
}

#[test]
fn over_and_over_the_sequence_is_the_recorded_one() {
    let directory = tempfile::tempdir().expect("a directory");
    let (path, bytes) = record(directory.path(), "can", 10);
    drop(bytes);
    let mut replay = Replay::start(&[&path, "--loop", "--speed", "100"]);
    let received = samples(&replay.read_exactly(50 * MAX_FRAME));
    let sequences: Vec<u16> = received.iter().map(|sample| sample.sequence).collect();
    assert_eq!(sequences, (0..50).map(|index| index % 20).collect::<Vec<u16>>());
}

#[test]
fn a_step_is_a_sample() {
    let directory = tempfile::tempdir().expect("a directory");
    let (path, bytes) = record(directory.path(), "serial", 10);
    let mut replay = Replay::start(&[&path, "--step"]);
    let mut input = replay.input.take().expect("a pipe");
    writeln!(input).expect("written");
    assert_eq!(replay.read_exactly(MAX_FRAME), bytes[..MAX_FRAME]);
    replay.stream.set_read_timeout(Some(Duration::from_millis(400))).expect("a socket");
    assert!(replay.stream.read(&mut [0]).is_err(), "nothing without a step");
    replay.stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
    writeln!(input, "nonsense\n3").expect("written");
    assert_eq!(replay.read_exactly(3 * MAX_FRAME), bytes[MAX_FRAME..4 * MAX_FRAME]);
    drop(input);
    let (rest, said) = replay.end();
    assert!(rest.is_empty() && said.contains("got \"nonsense\""), "{said}");
}

#[test]
fn faults_of_links_act_as_they_do_on_the_unit() {
    let directory = tempfile::tempdir().expect("a directory");
    let ((can, _), (serial, bytes)) = (record(directory.path(), "can", 30), record(directory.path(), "serial", 30));
    let plan = directory.path().join("plan.toml");
    fs::write(
        &plan,
        "[[fault]]\nfault = \"drop\"\nat_s = 5.0\nfor_s = 2.0\n\
         [[fault]]\nfault = \"duplicate\"\nlink = \"tcp\"\nat_s = 10.0\nfor_s = 1.0\n\
         [[fault]]\nfault = \"reorder\"\nat_s = 15.0\nfor_s = 2.0\n\
         [[fault]]\nfault = \"drop\"\nlink = \"can\"\nat_s = 20.0\nfor_s = 2.0\n",
    )
    .expect("written");
    let mut expected: Vec<u16> = (0..60).filter(|sequence| !(10..14).contains(sequence)).collect();
    expected.splice(16..18, [20, 20, 21, 21]);
    let swap = expected.iter().position(|&sequence| sequence == 30).expect("there");
    expected[swap..swap + 4].copy_from_slice(&[31, 30, 33, 32]);
    for path in [&can, &serial] {
        let (received, said) = Replay::start(&[path, "--speed", "max", "--faults", plan.to_str().expect("text")]).end();
        let sequences: Vec<u16> = samples(&received).iter().map(|sample| sample.sequence).collect();
        assert_eq!(sequences, expected, "{said}");
        assert!(received.starts_with(&bytes[..10 * MAX_FRAME]) && said.contains("10 with faults"), "{said}");
    }
}

#[test]
fn gaps_are_shortened_and_jumps_back_bridged() {
    let directory = tempfile::tempdir().expect("a directory");
    let (path, log) = record(directory.path(), "can", 4);
    let text = String::from_utf8(log).expect("text");
    // Four hours of nothing after a second, and back to 1970 after another.
    let shifted = text.lines().enumerate().map(|(index, line)| {
        let (time, rest) = line[1..].split_once(") ").expect("a time");
        let time: f64 = time.parse().expect("seconds");
        let time = match index / 6 {
            0 => time,
            1 => time + 14_400.0,
            _ => time - time.trunc() + index as f64 / 6.0,
        };
        format!("({time:.6}) {rest}\n")
    });
    fs::write(&path, shifted.collect::<String>()).expect("written");
    let start = Instant::now();
    let (received, said) = Replay::start(&[&path, "--longest-gap", "0.75"]).end();
    assert!(start.elapsed() < PATIENCE);
    assert_eq!(samples(&received).len(), 8, "{said}");
    assert!(said.contains("is shortened to 0.75 s") && said.contains("jump back by"), "{said}");
    assert!(said.contains("1 gaps shortened, the longest of 14400.") && said.contains("1 jumps back"), "{said}");
}

#[test]
fn what_cannot_be_played_is_refused_with_one_message() {
    let directory = tempfile::tempdir().expect("a directory");
    let (path, _) = record(directory.path(), "can", 4);
    let file = |name: &str, text: &str| {
        let file = directory.path().join(name);
        fs::write(&file, text).expect("written");
        file.to_str().expect("text").to_owned()
    };
    let (empty, nonsense) = (file("empty.log", ""), file("nonsense.bin", "\0\u{1}\u{2}\0"));
    let parameter =
        file("a.toml", "[[fault]]\nparameter = \"drift.arcsec_per_h\"\ngyro = \"GYRX\"\ncourse = { step = 9.0 }\n");
    let (gyro, unit) = (
        file("b.toml", "[[fault]]\nfault = \"dead\"\ngyro = \"GYRX\"\n"),
        file("c.toml", "[[fault]]\nfault = \"reset\"\n"),
    );
    let reply = file("d.toml", "[[fault]]\nfault = \"reply-missing\"\n");
    let rate = file("e.toml", "[[fault]]\nfault = \"drop\"\nwhen = \"abs(rate_y) > 700\"\n");
    let command = file("f.toml", "[[expect]]\ncondition = \"command(PING)\"\nwithin_s = 2\n");
    for (arguments, expected) in [
        (&["/no/such.log"][..], "/no/such.log: no such file"),
        (&[&path, "/no/such.log"], "/no/such.log: no such file"),
        (&["/"], "is a directory"),
        (&[&empty], "is empty"),
        (&[&nonsense], "expected"),
        (&[&path, "--faults", &rate], "fault-1, when: rate_y is not available from a recording"),
        (&[&path, "--faults", &command], "expect-1, condition: command is not available from a recording"),
        (
            &[&path, "--junit", "/no/such/verdicts.xml"],
            "--junit /no/such/verdicts.xml: expected a file that may be written",
        ),
        (&[&path, "--faults", &parameter], "expected only faults of links"),
        (&[&path, "--faults", &gyro], "expected only faults of links"),
        (&[&path, "--faults", &unit], "expected only faults of links"),
        (&[&path, "--faults", &reply], "a recording sends none"),
        (&[&path, "--from", "100"], "expected an earlier --from"),
        (&[&path, "--from", "3", "--to", "2"], "expected more than the 3 of --from"),
        (&["-", "--loop"], "cannot be read twice"),
        (&["-", "--step"], "gives the steps"),
        (&[&path, "--speed", "0"], "expected a factor"),
    ] {
        let output = geu().args(["replay", "--tcp", "127.0.0.1:0"]).args(arguments).stdin(Stdio::null()).output();
        let output = output.expect("geu starts");
        let said = String::from_utf8_lossy(&output.stderr);
        // An output that cannot be written is 1 for every command, a wrong input 2.
        let code = if arguments.contains(&"--junit") { 1 } else { 2 };
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        assert!(said.contains(expected) && output.stdout.is_empty(), "{arguments:?}: {said}");
    }
}

#[test]
fn a_recording_without_a_sample_for_its_links_is_refused_with_the_reason() {
    let directory = tempfile::tempdir().expect("a directory");
    // Of the longer one batches go out before its end is read.
    let recordings = [60, 3600].map(|duration_s| {
        let path = record(directory.path(), "can", duration_s).0;
        let kept = format!("{}/{duration_s}.log", directory.path().display());
        fs::rename(path, &kept).and_then(|()| fs::remove_dir_all(directory.path().join("can"))).expect("moved");
        kept
    });
    let pty = directory.path().join("pty").to_str().expect("text").to_owned();
    for (duration_s, path) in [60, 3600].into_iter().zip(&recordings) {
        for links in [&["--tcp", "127.0.0.1:0", "--only"][..], &["--tcp", "127.0.0.1:0"], &["--pty", &pty]] {
            let mut command = geu();
            command.args(["replay", path, "--base", "300", "--speed", "max"]).args(links).stdin(Stdio::null());
            let output = command.output().expect("geu starts");
            let said = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(2), "{duration_s} {links:?}: {said}");
            let found = "(base 300), got 1A0, 1A1, 1A2; 1A0 to 1A2 are as the unit sends them: --base 1A0";
            assert!(said.contains(found) && !said.contains("--from"), "{said}");
        }
    }
    let output = geu().args(["replay", &recordings[0], "--interface", "vcan7", "--tcp", "127.0.0.1:0"]).output();
    let output = output.expect("geu starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && said.contains("another --interface, with 360 frames"), "{said}");
}

#[test]
fn bytes_of_a_described_unit_come_as_they_were_at_its_pace() {
    let directory = tempfile::tempdir().expect("a directory");
    let out = directory.path().join("tetrad");
    let mut command = geu();
    command.args(["simulate", "--device", "tetrad", "--duration", "2", "--out"]).arg(&out);
    assert!(command.stderr(Stdio::null()).status().expect("geu starts").success());
    let path = out.join("link.bin").to_str().expect("text").to_owned();
    let mut bytes = fs::read(&path).expect("a recording");
    let length = bytes.len() / 200;
    // A second of samples is missing, and the line has noise.
    bytes.drain(50 * length..150 * length);
    bytes.splice(10 * length..10 * length, [0xA5, 0x5A, 0, 1]);
    fs::write(&path, &bytes).expect("written");
    let start = Instant::now();
    let (received, said) = Replay::start(&[&path, "--device", "tetrad"]).end();
    assert_eq!(received, bytes, "{said}");
    assert!(said.contains("samples 100 of the recording"), "{said}");
    assert!((1.9..6.0).contains(&start.elapsed().as_secs_f64()), "two seconds, got {:?}", start.elapsed());
    // The description in the recording's configuration is one, too.
    let unit = out.join("run.toml").to_str().expect("text").to_owned();
    let options = ["--device", &unit, "--speed", "max", "--from", "0.1", "--to", "0.3"];
    let (part, _) = Replay::start(&[&[path.as_str()][..], &options].concat()).end();
    assert_eq!(part, bytes[10 * length..30 * length + 4]);

    let mut replay = Replay::start(&[&path, "--device", "tetrad", "--step"]);
    let mut input = replay.input.take().expect("a pipe");
    writeln!(input, "3").expect("written");
    assert_eq!(replay.read_exactly(3 * length), bytes[..3 * length]);
    replay.stream.set_read_timeout(Some(Duration::from_millis(400))).expect("a socket");
    assert!(replay.stream.read(&mut [0]).is_err(), "nothing without a step");

    let plan = directory.path().join("plan.toml");
    fs::write(&plan, "[[fault]]\nfault = \"drop\"\n").expect("written");
    let plan = plan.to_str().expect("text");
    for (arguments, expected) in [
        (&["--tcp", "127.0.0.1:0", "--device", "kvh-1750"][..], "expected frames of KVH"),
        (&["--tcp", "127.0.0.1:0", "--device", "tetrad", "--faults", plan], "--faults: expected the default unit"),
        (&["--tcp", "127.0.0.1:0", "--device", "suchai3"], "expected a unit with a link"),
        (&["--tcp", "127.0.0.1:0", "--device", "tetrat"], "did you mean `tetrad`"),
        (&["--can", "vcan0", "--device", "tetrad"], "expected a link that it has, --pty, --serial or --tcp"),
        (&["--tcp", "127.0.0.1:0", "--device", "tetrad", "--from", "9"], "expected an earlier --from"),
    ] {
        let output = geu().args(["replay", &path]).args(arguments).stdin(Stdio::null()).output().expect("geu starts");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(expected) && output.stdout.is_empty(), "{arguments:?}: {said}");
    }
}
