//! A running unit watched and driven: injected into, monitored, its recording made again.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::thread::sleep;
use std::time::Duration;

use geu_tests::emulator::{Client, Emulator};
use geu_tests::geu;

/// An emulator on TCP with its control interface at a free port, and that port.
fn start(arguments: &[&str]) -> (Emulator, Client, String) {
    let arguments = [&["--tcp", "127.0.0.1:0", "--control", "127.0.0.1:0"], arguments].concat();
    let mut emulator = Emulator::start(1, &arguments);
    let client = emulator.tcp();
    let mut said = BufReader::new(emulator.child.stderr.take().expect("a pipe"));
    let mut line = String::new();
    said.read_line(&mut line).expect("text");
    let address = line.trim().trim_end_matches('/').rsplit('/').next().expect("an address").to_owned();
    // Read on, so that the emulator can say on.
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
fn what_is_injected_is_seen_by_the_client_cleared_recorded_and_made_again() {
    let directory = tempfile::tempdir().expect("a directory");
    let (live, again) = (directory.path().join("live"), directory.path().join("again"));
    let recorded = live.to_str().expect("text");
    let (mut emulator, mut client, address) =
        start(&["--record", recorded, "--wire", "serial", "--speed", "10", "--start", "0"]);
    assert!(client.read_until(|client| client.half_seconds.len() > 4));
    let said = out(&inject(&address, &["stuck-count", "GYRY", "counts=-321"]));
    assert!(said.starts_with("fault-1 from "), "{said}");
    assert!(client.read_until(|client| client.half_seconds.last().is_some_and(|last| last.increments[1] == -321)));
    out(&inject(&address, &["drift.arcsec_per_h", "GYRX", "ramp=36000", "over_s=20", "id=drift", "release_s=5"]));
    out(&inject(&address, &["bit-flip", "tcp", "bits=2", "when=frame % 3 == 0", "for_s=0.5", "times=1000"]));
    assert!(client.read_until(|client| client.defects > 5), "frames with a wrong CRC");
    assert!(out(&inject(&address, &["--list"])).contains("active   fault-1"));
    assert_eq!(out(&inject(&address, &["--clear", "fault-1"])), "cleared fault-1\n");
    assert!(client.read_until(|client| client.half_seconds.last().is_some_and(|last| last.increments[1] != -321)));
    out(&inject(&address, &["--clear", "all"]));
    let seen = client.half_seconds.len();
    assert!(client.read_until(|client| client.half_seconds.len() > seen + 30));
    emulator.ask_to_end();
    assert!(emulator.child.wait().expect("its end").success());

    let output =
        geu().arg("simulate").arg(live.join("run.toml")).arg("--out").arg(&again).output().expect("geu starts");
    out(&output);
    for name in ["link.bin", "truth.csv", "reference.csv", "run.toml"] {
        assert_eq!(fs::read(live.join(name)).expect(name), fs::read(again.join(name)).expect(name), "{name}");
    }
    let told = |path: &Path| {
        let all = lines(&path.join("faults.jsonl")).into_iter();
        all.filter(|line| line["what"] != "injected" && line["what"] != "cleared").collect::<Vec<_>>()
    };
    assert_eq!(told(&live), told(&again));
    assert!(told(&live).iter().any(|line| line["what"] == "bytes" && line["ids"][0] == "fault-1"));
}

#[test]
fn what_is_refused_leaves_nothing_behind_and_is_told_with_the_valid_names() {
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
        (&["--clear", "nobody"], "there is none"),
        (&["--start", "nobody"], "by_hand"),
        (&["--plan", plan.to_str().expect("text")], "plan.toml:5"),
    ] {
        let output = inject(&address, arguments);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(expected), "{arguments:?}: {said}");
    }
    assert_eq!(out(&inject(&address, &["--list"])), "");
    let nobody = inject("127.0.0.1:1", &["--list"]);
    assert_eq!(nobody.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&nobody.stderr).contains("a running emulator"));
}

#[test]
fn a_fault_that_waits_for_a_hand_starts_with_it() {
    let directory = tempfile::tempdir().expect("a directory");
    let plan = directory.path().join("plan.toml");
    fs::write(&plan, "[[fault]]\nid = \"hold\"\nby_hand = true\nfault = \"dead\"\ngyro = \"GYRZB\"").expect("written");
    let live = directory.path().join("live");
    let arguments =
        ["--faults", plan.to_str().expect("text"), "--record", live.to_str().expect("text"), "--speed", "10"];
    let (mut emulator, mut client, address) = start(&arguments);
    assert!(client.read_until(|client| client.half_seconds.len() > 10));
    assert!(client.half_seconds.iter().all(|row| row.gyro_flags & 8 != 0));
    out(&inject(&address, &["--start", "hold"]));
    assert!(client.read_until(|client| client.half_seconds.last().is_some_and(|last| last.gyro_flags & 8 == 0)));
    emulator.ask_to_end();
    assert!(emulator.child.wait().expect("its end").success());
    let events = lines(&live.join("faults.jsonl"));
    let of = |what: &str| events.iter().find(|event| event["what"] == what).expect("told");
    let (by_hand, start) = (of("started-by-hand"), of("start"));
    assert_eq!((&by_hand["id"], &by_hand["t_s"]), (&start["id"], &start["t_s"]));
}

#[test]
fn a_monitor_shows_half_seconds_and_what_happens_a_line_each() {
    let (_emulator, mut client, address) = start(&[]);
    let mut monitor = geu();
    let monitor = monitor.args(["monitor", "--control", &address, "--count", "4"]);
    let monitor = monitor.stdout(Stdio::piped()).spawn().expect("geu starts");
    assert!(client.read_until(|client| client.half_seconds.len() > 1));
    out(&inject(&address, &["stuck-count", "GYRX", "counts=99"]));
    let said = out(&monitor.wait_with_output().expect("its end"));
    assert!(said.lines().filter(|line| line.contains("seq ")).count() == 4, "{said}");
    assert!(said.contains("fault-start  fault-1 acts: stuck-count") && said.contains("GYRX    +99"), "{said}");
}

#[test]
fn a_second_emulator_takes_the_next_free_port_and_says_so() {
    let port = |emulator: &mut Emulator| {
        let mut line = String::new();
        BufReader::new(emulator.child.stderr.as_mut().expect("a pipe")).read_line(&mut line).expect("text");
        line.trim().trim_end_matches('/').rsplit(':').next().and_then(|port| port.parse::<u16>().ok()).expect("a port")
    };
    let mut one = Emulator::start(1, &["--tcp", "127.0.0.1:0"]);
    let mut other = Emulator::start(1, &["--tcp", "127.0.0.1:0"]);
    let (one, other) = (port(&mut one), port(&mut other));
    assert!(one >= 8470 && other > one, "{one} {other}");
}

#[test]
fn a_plan_s_expectations_decide_the_exit_code() {
    let directory = tempfile::tempdir().expect("a directory");
    let (plan, junit) = (directory.path().join("plan.toml"), directory.path().join("verdicts.xml"));
    let text = "[[fault]]\nid = \"a\"\nat_s = 2.0\nfault = \"dead\"\ngyro = \"GYRX\"\n\
                [[expect]]\nid = \"reacts\"\nafter = \"a\"\ncondition = \"command(PING)\"\nwithin_s = 60.0";
    fs::write(&plan, text).expect("written");
    for answers in [true, false] {
        let arguments = ["--faults", plan.to_str().expect("text"), "--junit", junit.to_str().expect("text")];
        let more = ["--speed", "10", "--duration", "70", "--control", "off"];
        let (emulator, mut client) = Emulator::on_tcp(&[&arguments[..], &more].concat());
        assert!(client.read_until(|client| client.half_seconds.len() > 8));
        if answers {
            client.ask(&geu_protocol::serial::frame(geu_protocol::serial::Kind::Command, &[1]));
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
    let ping = geu_protocol::serial::frame(geu_protocol::serial::Kind::Command, &[1]);
    let mut times: Vec<Duration> = (0..50).map(|_| client.ask(&ping).1).collect();
    times.sort_unstable();
    assert!(times[25] < Duration::from_millis(20), "{times:?}");
    assert!(client.is_without_gap());
    floods.into_iter().for_each(|flood| flood.join().expect("it ends"));
}
