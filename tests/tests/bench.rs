//! A running unit: faults injected, samples monitored, the recording reproduced.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::thread::sleep;
use std::time::Duration;

use geu_tests::emulator::{Client, Emulator};
use geu_tests::geu;

/// Starts an emulator on TCP; returns it with a client and the address of its control interface.
fn start(arguments: &[&str]) -> (Emulator, Client, String) {
    let arguments = [&["--tcp", "127.0.0.1:0", "--control", "127.0.0.1:0"], arguments].concat();
    let mut emulator = Emulator::start(1, &arguments);
    let client = emulator.tcp();
    let said = BufReader::new(emulator.child.stderr.take().expect("a pipe"));
    let address = emulator.control();
    // Drain standard error.
    std::thread::spawn(move || said.lines().for_each(drop));
    (emulator, client, address)
}

fn inject(address: &str, arguments: &[&str]) -> Output {
    geu().arg("inject").args(["--control", address]).args(arguments).output().expect("geu starts")
}

fn out(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn lines(path: &Path) -> Vec<serde_json::Value> {
    let text = fs::read_to_string(path).expect("a file");
    text.lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect()
}

#[test]
fn injected_faults_reach_the_client_are_recorded_and_reproduced() {
    let directory = tempfile::tempdir().expect("a directory");
    let (live, again) = (directory.path().join("live"), directory.path().join("again"));
    let recorded = live.to_str().expect("text");
    let (mut emulator, mut client, address) =
        start(&["--record", recorded, "--wire", "serial", "--speed", "10", "--start", "0"]);
    assert!(client.read_until(|client| client.samples.len() > 4));
    let said = out(&inject(&address, &["stuck-count", "GYRY", "counts=-321"]));
    assert!(said.starts_with("fault-1 from "), "{said}");
    assert!(client.read_until(|client| client.samples.last().is_some_and(|last| last.increments[1] == -321)));
    out(&inject(&address, &["drift.arcsec_per_h", "GYRX", "ramp=36000", "over_s=20", "id=drift", "release_s=5"]));
    out(&inject(&address, &["bit-flip", "tcp", "bits=2", "when=frame % 3 == 0", "for_s=0.5", "times=1000"]));
    assert!(client.read_until(|client| client.defects > 5), "frames with a wrong CRC");
    assert!(out(&inject(&address, &["--list"])).contains("active   fault-1"));
    assert_eq!(out(&inject(&address, &["--clear", "fault-1"])), "cleared fault-1\n");
    assert!(client.read_until(|client| client.samples.last().is_some_and(|last| last.increments[1] != -321)));
    out(&inject(&address, &["dead", "GYRX", "id=later", "at_s=1e6"]));
    // A fault that CAN cannot have: no CAN link is open or recorded.
    out(&inject(&address, &["wrong-length", "length=20", "for_s=2"]));
    out(&inject(&address, &["--clear", "all"]));
    let seen = client.samples.len();
    assert!(client.read_until(|client| client.samples.len() > seen + 30));
    emulator.ask_to_end();
    assert!(emulator.child.wait().expect("its end").success());

    let output =
        geu().arg("simulate").arg(live.join("run.toml")).arg("--out").arg(&again).output().expect("geu starts");
    out(&output);
    for name in ["link.bin", "truth.csv", "reference.csv", "run.toml"] {
        assert_eq!(fs::read(live.join(name)).expect(name), fs::read(again.join(name)).expect(name), "{name}");
    }
    let reported = |path: &Path| {
        let all = lines(&path.join("faults.jsonl")).into_iter();
        all.filter(|line| line["what"] != "injected" && line["what"] != "cleared").collect::<Vec<_>>()
    };
    assert_eq!(reported(&live), reported(&again));
    assert!(reported(&live).iter().any(|line| line["what"] == "bytes" && line["ids"][0] == "fault-1"));
}

#[test]
fn a_recording_killed_after_an_injection_has_the_fault_columns_in_its_truth() {
    let directory = tempfile::tempdir().expect("a directory");
    let recorded = directory.path().to_str().expect("text");
    let truth = || fs::read_to_string(directory.path().join("truth.csv")).expect("a truth");
    let (mut emulator, mut client, address) = start(&["--record", recorded, "--speed", "10"]);
    assert!(client.read_until(|client| client.samples.len() > 4));
    assert!(!truth().contains("fault_counts"), "a run without injected faults has the files of a simulation");
    out(&inject(&address, &["dead", "GYRY"]));
    let seen = client.samples.len();
    assert!(client.read_until(|client| client.samples.len() > seen + 8));
    emulator.child.kill().expect("killed");
    emulator.child.wait().expect("its end");
    let text = truth();
    assert!(text.lines().next().expect("a header").contains("fault_counts"), "{text}");
    let rows: Vec<usize> = text.lines().map(|row| row.split(',').count()).collect();
    assert!(rows.len() > 40 && rows[..rows.len() - 1].iter().all(|&count| count == rows[0]), "{rows:?}");
    assert!(!directory.path().join("truth.csv.wider").exists());
}

#[test]
fn rejected_injections_change_nothing_and_list_the_valid_names() {
    let directory = tempfile::tempdir().expect("a directory");
    let plan = directory.path().join("plan.toml");
    let (_emulator, _client, address) = start(&[]);
    let text = "[[fault]]\nfault = \"drop\"\n[[fault]]\nfault = \"stuck-count\"\ngyro = \"GYRQ\"\ncounts = 1";
    fs::write(&plan, text).expect("written");
    for (arguments, expected) in [
        (&["stuck-count", "GYRQ", "counts=1"][..], "GYRX, GYRY, GYRZA, GYRZB"),
        (&["stuck-count", "GYRX", "counts=1000000"], "-32768…32767"),
        (&["stuck-count", "GYRX", "counts=1", "counts=2"], "once"),
        (&["explode"], "stuck-count"),
        (&["parity-error", "tcp"], "disturbance box"),
        (&["drop", "can"], "a link that is open (tcp)"),
        (&["baud-mismatch", "baud=9600"], "a link that is open (tcp)"),
        (&["drift.arcsec_per_h", "GYRX", "step=1e9"], "36000"),
        (&["drift.arcsec_per_h", "GYRX", "step=nan"], "36000"),
        (&["drop", "when=rate_q > 1"], "rate_y"),
        (&["--clear", "unknown"], "there is none"),
        (&["--start", "unknown"], "by_hand"),
        (&["--plan", plan.to_str().expect("text")], "plan.toml:5"),
    ] {
        let output = inject(&address, arguments);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(expected), "{arguments:?}: {said}");
    }
    assert_eq!(out(&inject(&address, &["--list"])), "");
    let unreachable = inject("127.0.0.1:1", &["--list"]);
    assert_eq!(unreachable.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&unreachable.stderr).contains("a running emulator"));
}

#[test]
fn a_simulation_rejects_faults_its_links_cannot_have() {
    let directory = tempfile::tempdir().expect("a directory");
    let (plan, run) = (directory.path().join("plan.toml"), directory.path().join("run"));
    let simulate = |arguments: &[&str]| {
        let mut geu = geu();
        geu.args(["simulate", "--duration", "5", "--out"]).arg(&run).args(arguments).output().expect("geu starts")
    };
    let faults = ["--faults", plan.to_str().expect("text")];
    for (fault, wire, expected) in [
        ("fault = \"extra-bytes\"", "can", Some("a link that is open (can) for extra-bytes")),
        ("fault = \"extra-bytes\"", "serial", None),
        ("fault = \"extra-bytes\"\nlink = \"pty\"", "can", None),
        ("fault = \"baud-mismatch\"\nbaud = 9600.0", "can", Some("or record another --wire")),
        ("fault = \"drop\"", "can", None),
    ] {
        fs::write(&plan, format!("[[fault]]\n{fault}\n")).expect("written");
        let output = simulate(&[&faults[..], &["--wire", wire]].concat());
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(if expected.is_some() { 2 } else { 0 }), "{fault} {wire}: {said}");
        assert!(expected.is_none_or(|expected| said.contains(expected)), "{fault} {wire}: {said}");
        // Either no file was written, or the recording can be reproduced.
        assert_eq!(run.exists(), expected.is_none());
        if expected.is_none() {
            let again = directory.path().join("again");
            out(&geu().arg("simulate").arg(run.join("run.toml")).arg("--out").arg(&again).output().expect("starts"));
            let [first, second] = [&run, &again].map(|run| fs::read(run.join("faults.jsonl")).expect("faults"));
            assert_eq!(first, second, "{fault} {wire}");
            [run.clone(), again].iter().for_each(|made| fs::remove_dir_all(made).expect("removed"));
        }
    }
}

#[test]
fn a_plan_is_injected_whole_at_one_sample_or_rejected() {
    let directory = tempfile::tempdir().expect("a directory");
    let plan = directory.path().join("plan.toml");
    let (_emulator, mut client, address) = start(&["--speed", "20"]);
    assert!(client.read_until(|client| client.samples.len() > 4));
    out(&inject(&address, &["stuck-count", "GYRZA", "counts=1", "id=fault-1"]));
    // Identifiers that a later entry names, entries without one, and one in use.
    let many: String = (0..200).map(|_| "[[fault]]\nfault = \"drop\"\nat_s = 1e6\n").collect();
    let first = "[[fault]]\nfault = \"dead\"\ngyro = \"GYRX\"\nwhen = \"not active(last)\"\n";
    let last = "[[fault]]\nid = \"last\"\nfault = \"dead\"\ngyro = \"GYRY\"\n";
    fs::write(&plan, [first, &many, last].concat()).expect("written");
    let said = out(&inject(&address, &["--plan", plan.to_str().expect("text")]));
    assert_eq!(said.lines().count(), 202, "{said}");
    let at = |line: Option<&str>| line.and_then(|line| line.split(" from ").nth(1)).map(str::to_owned).expect("a time");
    assert_eq!(at(said.lines().next()), at(said.lines().last()), "{said}");
    assert!(said.starts_with("fault-2 from "), "{said}");
    let before = out(&inject(&address, &["--list"])).lines().count();
    for (wrong, expected) in [
        ("[[fault]]\nid = \"last\"\nfault = \"drop\"\n", "plan.toml:203:6"),
        ("[[fault]]\nfault = \"drop\"\nlink = \"can\"\n", "a link that is open (tcp)"),
        ("[[fault]]\nfault = \"drop\"\nuntil_s = 0.5\n", "a future time"),
        ("[[expect]]\nid = \"e\"\ncondition = \"t_s > 1\"\nwithin_s = 9.0\n", "expected faults alone"),
    ] {
        let many = many.replace("fault = \"drop\"\nat_s = 1e6\n", "fault = \"drop\"\n");
        fs::write(&plan, [&many[..many.len() / 200 * 100], "#\n", wrong].concat()).expect("written");
        let output = inject(&address, &["--plan", plan.to_str().expect("text")]);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && said.contains(expected), "{expected}: {said}");
        assert_eq!(out(&inject(&address, &["--list"])).lines().count(), before, "no fault of it is planned");
    }
}

#[test]
fn an_operator_triggered_fault_starts_on_request() {
    let directory = tempfile::tempdir().expect("a directory");
    let plan = directory.path().join("plan.toml");
    fs::write(&plan, "[[fault]]\nid = \"hold\"\nby_hand = true\nfault = \"dead\"\ngyro = \"GYRZB\"").expect("written");
    let live = directory.path().join("live");
    let arguments =
        ["--faults", plan.to_str().expect("text"), "--record", live.to_str().expect("text"), "--speed", "10"];
    let (mut emulator, mut client, address) = start(&arguments);
    assert!(client.read_until(|client| client.samples.len() > 10));
    assert!(client.samples.iter().all(|row| row.gyro_flags & 8 != 0));
    out(&inject(&address, &["--start", "hold"]));
    assert!(client.read_until(|client| client.samples.last().is_some_and(|last| last.gyro_flags & 8 == 0)));
    emulator.ask_to_end();
    assert!(emulator.child.wait().expect("its end").success());
    let events = lines(&live.join("faults.jsonl"));
    let event = |what: &str| events.iter().find(|event| event["what"] == what).expect("an event");
    let (by_hand, start) = (event("started-by-hand"), event("start"));
    assert_eq!((&by_hand["id"], &by_hand["t_s"]), (&start["id"], &start["t_s"]));
}

#[test]
fn a_monitor_prints_samples_and_events_a_line_each() {
    let (_emulator, mut client, address) = start(&[]);
    let mut monitor = geu();
    let monitor = monitor.args(["monitor", "--control", &address, "--count", "4"]);
    let monitor = monitor.stdout(Stdio::piped()).spawn().expect("geu starts");
    assert!(client.read_until(|client| client.samples.len() > 1));
    out(&inject(&address, &["stuck-count", "GYRX", "counts=99"]));
    let said = out(&monitor.wait_with_output().expect("its end"));
    assert!(said.lines().filter(|line| line.contains("seq ")).count() == 4, "{said}");
    assert!(said.contains("fault-start  fault-1 active: stuck-count") && said.contains("GYRX    +99"), "{said}");
}

/// A control interface that closes the event stream after each sample, `times` in all.
fn closes_after_each(times: usize) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address").to_string();
    std::thread::spawn(move || {
        let mut reported = 0;
        while reported < times {
            let (stream, _) = listener.accept().expect("a client");
            let mut lines = BufReader::new(&stream).lines();
            let asked = lines.next().expect("a request").expect("text");
            lines.find(|line| line.as_ref().is_ok_and(String::is_empty)).expect("the end of the head").expect("text");
            let is_events = asked.contains("/api/events");
            reported += usize::from(is_events);
            let (kind, body) = match is_events {
                true => ("text/event-stream", format!("event: half-second\ndata: {{\"sequence\": {reported}}}\n\n")),
                false => ("application/json", "{}".to_owned()),
            };
            let head = format!("HTTP/1.1 200 OK\r\ncontent-type: {kind}\r\nconnection: close\r\n\r\n");
            (&stream).write_all((head + &body).as_bytes()).expect("sent");
        }
    });
    address
}

#[test]
fn a_monitor_reconnects_and_reports_an_emulator_that_ended() {
    let monitor = |address: &str, count: &str| {
        geu().args(["monitor", "--control", address, "--count", count]).output().expect("geu starts")
    };
    let said = out(&monitor(&closes_after_each(3), "3"));
    assert!((1..=3).all(|sequence| said.contains(&format!("seq     {sequence}"))), "{said}");
    let ended = monitor(&closes_after_each(1), "2");
    let said = String::from_utf8_lossy(&ended.stderr);
    assert!(ended.status.code() == Some(1) && said.contains("the emulator has ended"), "{said}");
    let none = monitor("127.0.0.1:1", "0");
    assert_eq!(none.status.code(), Some(2), "{}", String::from_utf8_lossy(&none.stderr));
}

#[test]
fn a_second_emulator_uses_the_next_free_port() {
    let port = |emulator: &mut Emulator| {
        emulator.control().rsplit(':').next().and_then(|port| port.parse::<u16>().ok()).expect("a port")
    };
    let two = || {
        let [mut one, mut other] = [(); 2].map(|()| Emulator::start(1, &["--tcp", "127.0.0.1:0"]));
        (port(&mut one), port(&mut other))
    };
    // An emulator of another test may end between the two and leave a lower port.
    let tried: Vec<_> = std::iter::repeat_with(two).take(3).collect();
    assert!(tried.iter().all(|(one, other)| *one >= 8470 && *other >= 8470 && one != other), "{tried:?}");
    assert!(tried.iter().any(|(one, other)| other > one), "{tried:?}");
}

#[test]
fn a_plan_s_expectations_decide_the_exit_code() {
    let directory = tempfile::tempdir().expect("a directory");
    let (plan, junit) = (directory.path().join("plan.toml"), directory.path().join("verdicts.xml"));
    let text = "[[fault]]\nid = \"a\"\nat_s = 2.0\nfault = \"dead\"\ngyro = \"GYRX\"\n\
                [[expect]]\nid = \"reacts\"\nafter = \"a\"\ncondition = \"command(PING)\"\nwithin_s = ";
    // Time for an answer on a loaded machine, and less where none comes.
    for (answers, within_s, duration) in [(true, "60.0", "70"), (false, "8.0", "12")] {
        fs::write(&plan, format!("{text}{within_s}")).expect("written");
        let arguments = ["--faults", plan.to_str().expect("text"), "--junit", junit.to_str().expect("text")];
        let more = ["--speed", "10", "--duration", duration, "--control", "off"];
        let (emulator, mut client) = Emulator::on_tcp(&[&arguments[..], &more].concat());
        assert!(client.read_until(|client| client.samples.len() > 8));
        if answers {
            client.ask(&geu_protocol::serial::frame(geu_protocol::serial::FrameType::Command, &[1]));
        }
        let (code, said) = emulator.end();
        assert_eq!(code, Some(if answers { 0 } else { 1 }), "{said}");
        let xml = fs::read_to_string(&junit).expect("JUnit");
        assert_eq!(xml.contains("<failure"), !answers, "{xml}");
        assert!(xml.contains("tests=\"1\""));
    }
}

#[test]
fn a_client_that_floods_the_interface_delays_no_reply_on_the_link() {
    let (_emulator, mut client, address) = start(&[]);
    let floods: Vec<_> = (0..4)
        .map(|_| {
            let address = address.clone();
            std::thread::spawn(move || {
                let script = format!(
                    "for i in $(seq 200); do printf 'GARBAGE\\r\\n\\r\\n' | timeout 1 cat > /dev/tcp/{}; done",
                    address.replace(':', "/")
                );
                let _ = Command::new("bash").args(["-c", &script]).stderr(Stdio::null()).status();
            })
        })
        .collect();
    sleep(Duration::from_millis(100));
    let ping = geu_protocol::serial::frame(geu_protocol::serial::FrameType::Command, &[1]);
    let mut times: Vec<Duration> = (0..50).map(|_| client.ask(&ping).1).collect();
    times.sort_unstable();
    assert!(times[25] < Duration::from_millis(20), "{times:?}");
    assert!(client.is_without_gap());
    floods.into_iter().for_each(|flood| flood.join().expect("it ends"));
}
