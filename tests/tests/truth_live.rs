//! Truth from outside: the emulator follows simulators over real sockets, on the loopback only, and its recording makes the
//! same run again.

use std::f64::consts::PI;
use std::fmt::Write as _;
use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::path::Path;
use std::thread::{self, sleep};
use std::time::{Duration, Instant};

use geu_process::EmulatorProcess;
use geu_tests::geu;

/// Timeout of a test.
const PATIENCE: Duration = Duration::from_secs(20);

/// A running `geu run` on TCP.
struct Emulator {
    process: EmulatorProcess,
    /// Address of its datagrams.
    truth: Option<String>,
}

impl Emulator {
    fn start(truth: &str, record: &Path, arguments: &[&str]) -> Emulator {
        let mut command = geu();
        command.args(["run", "--tcp", "127.0.0.1:0", "--start", "0", "--truth", truth]).args(arguments);
        command.arg("--record").arg(record);
        let mut process = EmulatorProcess::start(command).expect("geu starts");
        let ready = process.next_ready().expect("a line");
        let truth = ready.strip_prefix("truth udp://").map(str::to_owned);
        if truth.is_some() {
            process.next_ready().expect("a line for the link");
        }
        Emulator { process, truth }
    }

    /// A socket that sends to it.
    fn source(&self) -> UdpSocket {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a port");
        socket.connect(self.truth.as_ref().expect("it listens")).expect("an address");
        socket
    }

    /// Waits for its end and gives what it said on standard error.
    fn end(self) -> String {
        self.end_with(0)
    }

    /// Ends it, with the expected exit code.
    fn end_with(self, code: i32) -> String {
        let (status, text) = self.process.wait().expect("its end");
        assert_eq!(status.code(), Some(code), "{text}");
        text
    }
}

/// The fields of a CSV file behind its header.
fn rows(file: &Path) -> Vec<Vec<String>> {
    let text = fs::read_to_string(file).expect("a file");
    text.lines().skip(1).map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

/// True rotation about the input axis of one gyro over the run.
fn turned_arcsec(directory: &Path, gyro: &str) -> f64 {
    let rows = rows(&directory.join("truth.csv"));
    rows.iter().filter(|row| row[2] == gyro).map(|row| row[3].parse::<f64>().expect("a number")).sum()
}

fn assert_made_again(run: &Path, directory: &Path) {
    let again = directory.join("again");
    let mut command = geu();
    command.arg("simulate").arg(run.join("run.toml")).arg("--out").arg(&again);
    let output = command.output().expect("geu starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    for name in ["link.bin", "truth.csv", "reference.csv", "received.csv", "commands.jsonl", "run.toml"] {
        let read = |directory: &Path| fs::read(directory.join(name)).expect(name);
        assert!(read(run) == read(&again), "{name} differs");
        assert!(!read(run).is_empty() || name == "commands.jsonl");
    }
}

/// Half of an angle about X as a quaternion's two parts, real part first.
fn about_x(arcsec: f64) -> [f64; 2] {
    let half_rad = arcsec / 3600.0 * PI / 180.0 / 2.0;
    [half_rad.cos(), half_rad.sin()]
}

/// Angle of the simulated body about X: an oscillation on a constant rate, arcsec.
fn angle_arcsec(t_s: f64) -> f64 {
    200.0 * t_s + 500.0 * (t_s * 0.7).sin()
}

#[test]
fn a_run_that_waits_for_its_source_follows_it_exactly_and_is_made_again() {
    let directory = tempfile::tempdir().expect("a directory");
    let run = directory.path().join("run");
    // A slow clock and a time offset: the truth is needed beyond samples of the source, and read from the past.
    let sets = ["--set", "unit.clock-frequency.ppm=-100", "--set", "unit.time-offset.seconds=0.2"];
    let arguments = [&["--speed", "max", "--duration", "60"], &sets[..]].concat();
    let emulator = Emulator::start("udp://127.0.0.1:0", &run, &arguments);
    let socket = emulator.source();
    for tenth in 0..=601 {
        let t_s = f64::from(tenth) * 0.1;
        let [w, x] = about_x(angle_arcsec(t_s));
        let line = format!(r#"{{"t_s": {}, "q": [{w}, {x}, 0, 0], "else": null}}"#, 1e5 + t_s);
        socket.send(line.as_bytes()).expect("sent");
        // The kernel keeps some hundred datagrams for a reader that waits.
        if tenth % 50 == 0 {
            sleep(Duration::from_millis(20));
        }
    }
    let said = emulator.end();
    assert!(said.contains("truth        received 602, late intervals 0, missing 0, jumps 0"), "{said}");
    let turned = turned_arcsec(&run, "GYRX");
    // In the unit's time: truth.csv has the shift as a change of the count. Linear interpolation over 0.1 s errs by 0.3″.
    let end_s = 60.0 / (1.0 - 100e-6);
    assert!((turned - angle_arcsec(end_s)).abs() < 0.4, "{turned} {}", angle_arcsec(end_s));
    assert_eq!(
        fs::read_to_string(run.join("run.toml")).expect("a file").matches("truth = \"received.csv\"").count(),
        1
    );
    assert_made_again(&run, directory.path());
}

#[test]
fn whatever_the_network_does_no_angle_is_lost_and_the_run_is_made_again() {
    let directory = tempfile::tempdir().expect("a directory");
    let run = directory.path().join("run");
    // Ten times as fast, so that a held-up sample is late by several samples.
    let emulator = Emulator::start("udp://127.0.0.1:0", &run, &["--speed", "10", "--duration", "30"]);
    let socket = emulator.source();
    let mut held_up = String::new();
    let start = Instant::now();
    for step in 0..=152 {
        let t_s = f64::from(step) * 0.2;
        sleep((start + Duration::from_secs_f64(t_s / 10.0)).saturating_duration_since(Instant::now()));
        let [w, x] = about_x(angle_arcsec(t_s));
        writeln!(held_up, r#"{{"t_s": {t_s}, "q": [{w}, {x}, 0, 0]}}"#).expect("a string");
        if step % 25 == 10 {
            socket.send(b"{\"t_s\": 1\n\xFF\xFE\n\n{}").expect("sent");
        }
        // Between 4 s and 7 s of the source nothing gets through.
        if !(20..35).contains(&step) {
            // On a machine that is busy the run may be over by now.
            let _ = socket.send(held_up.as_bytes());
            held_up.clear();
        }
    }
    let said = emulator.end_with(1);
    let counted = said.lines().find(|line| line.starts_with("truth  ")).expect("a summary");
    assert!(counted.contains("missing 0, jumps 0") && !counted.contains("late intervals 0,"), "{said}");
    assert!(counted.contains("bad lines 18"), "{said}");
    assert_eq!(said.matches("from 127.0.0.1:").count(), 3, "the first few are reported: {said}");
    let turned = turned_arcsec(&run, "GYRX");
    assert!((turned - angle_arcsec(30.0)).abs() < 60.0, "{turned} {}", angle_arcsec(30.0));
    let bases = rows(&run.join("received.csv"));
    assert!(bases.iter().any(|row| row[4] == "held") && bases.iter().filter(|row| row[4] == "told").count() > 200);
    assert_made_again(&run, directory.path());
}

#[test]
fn a_server_that_restarts_is_found_again_and_its_rates_go_on() {
    let directory = tempfile::tempdir().expect("a directory");
    let run = directory.path().join("run");
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let truth = format!("tcp://{}", listener.local_addr().expect("an address"));
    let emulator = Emulator::start(&truth, &run, &["--speed", "max", "--duration", "20"]);
    // The second server's clock begins anew.
    for (from, to) in [(0, 20), (0, 30)] {
        let (mut stream, _) = listener.accept().expect("it connects");
        for step in from..=to {
            let line = format!("{{\"t_s\": {}, \"rate_arcsec_s\": [0, 0, 150]}}\n", f64::from(step) * 0.5);
            stream.write_all(line.as_bytes()).expect("it reads");
        }
        sleep(Duration::from_millis(300));
    }
    let said = emulator.end_with(1);
    assert!(said.contains("0 missing, 1 jumps: the unit moved otherwise than was reported"), "{said}");
    assert!(said.contains("its time jumped by -10.000 s") && said.contains("it closed the connection"), "{said}");
    assert!(said.contains("jumps 1,"), "{said}");
    let turned = turned_arcsec(&run, "GYRZA");
    assert!((turned - 20.0 * 150.0).abs() < 80.0, "{turned}");
    assert_made_again(&run, directory.path());
}

/// Message of 42 for one instant, in one of its layouts: with brackets, or without and with the main body's attitude.
fn message(t_s: f64, is_bracketed: bool) -> String {
    let [w, x] = about_x(angle_arcsec(t_s));
    let (minute, second) = ((t_s / 60.0).floor(), t_s % 60.0);
    let time = format!("TIME 2026-130-23:{:02}:{second:012.9}\n", 59.0_f64.min(minute + 30.0));
    let attitude = match is_bracketed {
        true => format!("SC[0].qn = [{x:18.12e} 0.0e+00 0.0e+00 {w:18.12e}]\nSC[0].wn = [9.0e+00 0 0]\n"),
        false => format!("SC[0].B[0].wn = 9.0e+00 0 0\nSC[0].B[0].qn = {x:18.15e} 0.0e+00 0.0e+00 {w:18.15e}\n"),
    };
    format!("{time}Orb[0].PosN = 6.8e+06 0.0e+00 0.0e+00\n{attitude}SC[1].B[0].qn = 0 0 0 1\n[ENDMSG]\n")
}

/// Sends a message in parts, and reads the four bytes that 42 expects.
fn exchange(stream: &mut TcpStream, message: &str) -> bool {
    let (first, second) = message.split_at(message.len() / 3);
    let mut answer = [0; 4];
    let sent = stream.write_all(first.as_bytes()).and_then(|()| stream.write_all(second.as_bytes()));
    match sent.and_then(|()| stream.read_exact(&mut answer)) {
        Ok(()) => {
            assert_eq!(&answer, b"Ack\n");
            true
        }
        // The run is over.
        Err(_) => false,
    }
}

#[test]
fn a_stand_in_for_42_is_followed_in_lockstep_in_both_layouts_and_over_a_reconnection() {
    let directory = tempfile::tempdir().expect("a directory");
    let run = directory.path().join("run");
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let truth = format!("42://{}", listener.local_addr().expect("an address"));
    let emulator = Emulator::start(&truth, &run, &["--speed", "max", "--duration", "40"]);
    let server = thread::spawn(move || {
        let (mut step, mut answered) = (0, 0);
        for is_bracketed in [true, false] {
            let (mut stream, _) = listener.accept().expect("it connects");
            stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
            stream.set_nodelay(true).expect("a socket");
            while !is_bracketed || step < 80 {
                if !exchange(&mut stream, &message(f64::from(step) * 0.25, is_bracketed)) {
                    return answered;
                }
                (step, answered) = (step + 1, answered + 1);
            }
        }
        answered
    });
    let said = emulator.end();
    let answered = server.join().expect("the server ends");
    // Four messages a sample pair, one for time 0; the answer to the last may not be given before the end.
    assert!((160..=163).contains(&answered), "{answered}: {said}");
    assert!(said.contains("late intervals 0, missing 0, jumps 0, out of order 0, bad lines 0"), "{said}");
    let turned = turned_arcsec(&run, "GYRX");
    assert!((turned - angle_arcsec(40.0)).abs() < 1e-3, "{turned} {}", angle_arcsec(40.0));
    assert_made_again(&run, directory.path());
}

#[test]
fn a_truth_from_outside_needs_a_run_and_an_address_that_is_one() {
    let directory = tempfile::tempdir().expect("a directory");
    let out = directory.path().join("out");
    for (arguments, part) in [
        (["simulate", "--out"], "--truth udp://127.0.0.1:4701: expected a file or scenario"),
        (["run", "--record"], "--truth: expected udp://HOST:PORT, tcp://HOST:PORT or 42://HOST:PORT, got http://a:1"),
        (["run", "--record"], "--truth udp://203.0.113.1:4701: cannot be listened at"),
    ] {
        let truth = part.split_whitespace().find(|word| word.contains("://") && !word.contains("HOST")).expect("one");
        let mut command = geu();
        command.args(arguments).arg(&out).args(["--truth", truth.trim_end_matches(':'), "--duration", "5"]);
        let output = command.output().expect("geu starts");
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && message.contains(part), "{part} not in {message}");
    }
}
