//! Lock-step with a simulator: how long it is waited for, what ends a sample, and what the run's end says of the truth.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::path::Path;
use std::thread::sleep;
use std::time::Duration;

use geu_tests::emulator::Client;
use geu_tests::geu;
use geu_tests::simulator::{PATIENCE, Simulated, about_x};
use serde_json::Value;

const LOCK_STEP: [&str; 2] = ["--speed", "max"];

fn start(arguments: &[&str]) -> Simulated {
    Simulated::start(&[&LOCK_STEP[..], arguments].concat())
}

fn path(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

/// Ten seconds of an oscillating body, with a pause before one of the samples.
fn swing(simulated: &Simulated, pause: Duration) {
    for half in 0..=20 {
        if half == 9 {
            sleep(pause);
        }
        let t_s = f64::from(half) * 0.5;
        simulated.send(&about_x(t_s, 300.0 * (t_s * 0.7).sin()));
    }
}

#[test]
fn a_simulator_that_stands_still_is_waited_for_and_the_bytes_are_those_of_one_that_does_not() {
    let directory = tempfile::tempdir().expect("a directory");
    // Longer than the 2 s after which such a run once went on without its source.
    let [quick, slow] = [("quick", 0), ("slow", 3)].map(|(name, pause_s)| {
        let run = directory.path().join(name);
        let simulated = start(&["--duration", "10", "--record", path(&run)]);
        swing(&simulated, Duration::from_secs(pause_s));
        let (code, said, _) = simulated.end();
        assert_eq!(code, Some(0), "{said}");
        assert!(said.contains("late intervals 0, missing 0, jumps 0"), "{said}");
        assert_eq!(said.contains("waits for a sample at or after its time"), pause_s > 0, "{said}");
        run
    });
    for name in ["received.csv", "truth.csv", "reference.csv"] {
        assert!(fs::read(quick.join(name)).expect(name) == fs::read(slow.join(name)).expect(name), "{name} differs");
    }
}

#[test]
fn a_simulator_that_does_not_come_in_the_time_it_is_given_ends_the_run_with_its_recording_whole() {
    let directory = tempfile::tempdir().expect("a directory");
    let run = directory.path().join("run");
    let simulated = start(&["--duration", "60", "--truth-wait", "0.5", "--record", path(&run)]);
    (0..=10).for_each(|half| simulated.send(&about_x(f64::from(half) * 0.5, 10.0 * f64::from(half))));
    let (code, said, _) = simulated.end();
    assert_eq!(code, Some(1), "{said}");
    assert!(
        said.contains("expected a sample at or after its time 5.5 s within 0.5 s (--truth-wait), got none"),
        "{said}"
    );
    assert!(said.contains("samples 10,") && said.contains("late intervals 0, missing 0"), "{said}");
    assert_eq!(said.matches("--truth-wait)").count(), 1, "one message: {said}");
    let again = directory.path().join("again");
    let output = geu().arg("simulate").arg(run.join("run.toml")).arg("--out").arg(&again).output().expect("geu starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let read = |directory: &Path| fs::read(directory.join("truth.csv")).expect("a truth");
    assert!(read(&run) == read(&again));

    let simulated = Simulated::start(&["--truth-wait", "0.3", "--duration", "5"]);
    let (code, said, _) = simulated.end();
    assert!(code == Some(1) && said.contains("expected the first sample within 0.3 s"), "{said}");
}

#[test]
fn a_run_that_waits_for_ever_ends_at_once_when_it_is_asked_to() {
    for lines in [0, 3] {
        let simulated = start(&["--truth-wait", "forever"]);
        (0..lines).for_each(|half| simulated.send(&about_x(f64::from(half) * 0.5, 0.0)));
        sleep(Duration::from_millis(300));
        simulated.ask_to_end();
        let (code, said, took) = simulated.end();
        assert_eq!(code, Some(0), "{said}");
        // It looks each 50 ms, and waits 0.3 s for readers at most; the rest is for a loaded machine.
        assert!(took < Duration::from_secs(3), "{took:?}");
    }
}

#[test]
fn a_wait_that_is_none_or_for_nobody_is_refused() {
    for (arguments, part) in [
        (
            &["--truth", "udp://127.0.0.1:0", "--truth-wait", "0"][..],
            "expected forever, or a duration of 0.001 to 1000000 seconds",
        ),
        (
            &["--truth", "udp://127.0.0.1:0", "--truth-wait", "never"],
            "expected forever, or a duration of 0.001 to 1000000 seconds (90, 90s, 10m, 2h, 1d), got never",
        ),
        (&["--truth-wait", "5"], "--truth-wait: expected a simulator as the truth"),
    ] {
        let output = geu().args(["run", "--tcp", "127.0.0.1:0"]).args(arguments).output().expect("geu starts");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && said.contains(part), "{part} not in {said}");
    }
}

#[test]
fn a_run_in_real_time_whose_truth_came_late_says_so_and_fails_at_its_end() {
    let simulated = Simulated::start(&["--duration", "2"]);
    simulated.send(&about_x(0.0, 0.0));
    let (code, said, _) = simulated.end();
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("got 4 late intervals, 0 missing, 0 jumps: the unit moved otherwise"), "{said}");
    assert!(said.contains("truth        received 1, late intervals 4, missing 0"), "the statistics: {said}");
}

#[test]
fn a_run_whose_truth_had_a_line_that_could_not_be_read_fails_and_names_the_port_that_was_taken() {
    let simulated = start(&["--duration", "2"]);
    for half in 0..=4 {
        simulated.send(&about_x(f64::from(half) * 0.5, 0.0));
        if half == 2 {
            simulated.send("{\"t_s\": 1.2, \"q\": [1, 0, 0]}\n");
        }
    }
    let (code, said, _) = simulated.end();
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("expected lines that can be read, got 1 that cannot"), "{said}");
    assert!(said.contains("truth udp://127.0.0.1:") && !said.contains("udp://127.0.0.1:0"), "{said}");
}

#[test]
fn a_silent_sample_ends_too_and_the_loop_goes_on() {
    let directory = tempfile::tempdir().expect("a directory");
    let plan = directory.path().join("plan.toml");
    let faults = "[[fault]]\nfault = \"silence\"\nlink = \"tcp\"\nat_s = 2.0\nfor_s = 1.0\n\n[[fault]]\nfault = \"duplicate\"\nlink = \"tcp\"\nat_s = 4.0\nfor_s = 0.5\n";
    fs::write(&plan, faults).expect("written");
    let simulated = start(&["--wait", "--duration", "6", "--faults", path(&plan)]);
    let stream = std::net::TcpStream::connect(&simulated.link).expect("a link");
    stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
    let mut client = Client::new(stream);
    simulated.send("{\"subscribe\": \"samples\"}\n");
    simulated.send(&about_x(100.0, 0.0));
    for half in 0..12_u32 {
        // Each sample depends on the report of the sample before: neither side is ahead.
        simulated.send(&about_x(100.0 + f64::from(half + 1) * 0.5, 10.0 * f64::from(half)));
        let report: Value = serde_json::from_str(&simulated.report()).expect("JSON");
        assert_eq!(report["half_second"], half, "{report}");
        assert_eq!(report["sequence"], half, "{report}");
        assert_eq!(report["t_s"], 100.0 + f64::from(half + 1) * 0.5, "{report}");
        let link = &report["sent"][format!("tcp {}", simulated.link)];
        let expected = match half {
            4 | 5 => 0,
            8 => 56,
            _ => 28,
        };
        assert_eq!((&link["bytes"], &link["dropped"]), (&expected.into(), &0.into()), "{report}");
        let so_far = client.bytes.len();
        // What was reported has been handed over: it can be waited for.
        assert!(client.read_until(|client| client.bytes.len() >= so_far + expected), "{report}");
    }
    let (code, said, _) = simulated.end();
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("bad lines 0, reports 12 sent, 0 dropped"), "{said}");
    assert_eq!(client.samples.len(), 11);
}

#[test]
fn reports_over_tcp_are_sent_to_subscribers_only() {
    for asks in [true, false] {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let truth = format!("tcp://{}", listener.local_addr().expect("an address"));
        let mut command = geu();
        command.args(["run", "--tcp", "127.0.0.1:0", "--control", "off", "--truth", &truth, "--duration", "5"]);
        let mut child = command.args(LOCK_STEP).stderr(std::process::Stdio::null()).spawn().expect("geu starts");
        let (mut stream, _) = listener.accept().expect("it connects");
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
        let asked = if asks { "\"subscribe\": \"samples\", " } else { "" };
        for half in 0..=10 {
            let line = about_x(f64::from(half) * 0.5, 0.0).replacen('{', &format!("{{{asked}"), 1);
            stream.write_all(line.as_bytes()).expect("it reads");
        }
        let lines: Vec<String> = BufReader::new(stream).lines().map_while(Result::ok).collect();
        assert_eq!(lines.len(), if asks { 10 } else { 0 }, "{lines:?}");
        assert_eq!(child.wait().expect("its end").code(), Some(0));
    }
}

#[test]
fn a_peer_that_asks_and_never_reads_holds_nothing_up() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let truth = format!("tcp://{}", listener.local_addr().expect("an address"));
    let mut command = geu();
    // Reports of some megabytes exceed the kernel's buffer of an unread socket.
    let arguments = ["--tcp", "127.0.0.1:0", "--control", "off", "--duration", "60000", "--truth", &truth];
    let mut child = command
        .arg("run")
        .args(arguments)
        .args(LOCK_STEP)
        .stderr(std::process::Stdio::piped())
        .spawn()
        .expect("geu starts");
    let (mut stream, _) = listener.accept().expect("it connects");
    stream.write_all(b"{\"subscribe\": \"samples\"}\n").expect("it reads");
    for step in 0..=30_000 {
        let line = format!("{{\"t_s\": {}, \"rate_arcsec_s\": [0, 0, 9]}}\n", step * 2);
        if stream.write_all(line.as_bytes()).is_err() {
            break;
        }
    }
    let mut said = String::new();
    std::io::Read::read_to_string(&mut child.stderr.take().expect("a pipe"), &mut said).expect("text");
    assert_eq!(child.wait().expect("its end").code(), Some(0), "{said}");
    let counted = said.lines().find(|line| line.starts_with("truth  ")).expect("a summary");
    assert!(counted.ends_with(" dropped") && !counted.ends_with(" 0 dropped"), "{said}");
}
