//! `geu watch`: a healthy recording, faults on a recording and on a running link, and refused input.

use std::fs;
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use geu_tests::emulator::Emulator;
use geu_tests::geu;
use geu_tests::http::ask;
use serde_json::Value;

/// Length of a recording: a pointing, slews about Y, and most of the scan after them.
const LENGTH_S: &str = "5400";

fn simulate(out: &Path, duration_s: &str, more: &[&str]) {
    let arguments = ["simulate", "--duration", duration_s, "--seed", "71"];
    let output = geu().args(arguments).args(more).arg("--out").arg(out).output().expect("geu starts");
    assert!(output.status.success(), "{}", text(&output.stderr));
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Watches a recording.
fn watch(recording: &Path, with_reference: bool, more: &[&str]) -> Output {
    let mut command = geu();
    command.arg("watch").arg(recording.join("link.log"));
    if with_reference {
        command.arg("--reference").arg(recording.join("reference.csv"));
    }
    command.args(more).output().expect("geu starts")
}

fn events(output: &Output) -> Vec<Value> {
    text(&output.stdout).lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect()
}

#[test]
fn a_healthy_recording_has_no_alarm_with_and_without_reference() {
    let directory = tempfile::tempdir().expect("a directory");
    let recording = directory.path().join("healthy");
    simulate(&recording, LENGTH_S, &[]);
    for with_reference in [true, false] {
        let output = watch(&recording, with_reference, &["--strict"]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        assert_eq!(events(&output), Vec::<Value>::new());
        assert!(text(&output.stderr).contains("alarms         0"), "{}", text(&output.stderr));
    }
}

#[test]
fn faults_of_a_recording_are_alarms_on_their_gyros_and_the_same_again() {
    let directory = tempfile::tempdir().expect("a directory");
    let (recording, plan) = (directory.path().join("faulty"), directory.path().join("plan.toml"));
    let fault = |gyro: &str, parameter: &str, step: f64| {
        format!(
            "[[fault]]\nat_s = 3000.0\ngyro = \"{gyro}\"\nparameter = \"{parameter}\"\ncourse = {{ step = {step} }}\n"
        )
    };
    let drift = fault("GYRZB", "drift.arcsec_per_h", -300.0);
    fs::write(&plan, drift + &fault("GYRY", "pivot-clearance.clearance_arcsec", 9.0)).expect("written");
    simulate(&recording, LENGTH_S, &["--faults", plan.to_str().expect("text")]);

    let output = watch(&recording, true, &["--strict"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let alarms: Vec<Value> = events(&output).into_iter().filter(|event| event["event"] == "alarm").collect();
    for gyro in ["GYRY", "GYRZB"] {
        let own: Vec<&Value> = alarms.iter().filter(|alarm| alarm["gyros"][0] == gyro).collect();
        assert_eq!(own.len(), 1, "{alarms:?}");
        assert!((3000.0..3600.0).contains(&own[0]["t_s"].as_f64().expect("a time")), "{own:?}");
        assert!(own[0]["statistic"].as_f64() > own[0]["threshold"].as_f64(), "{own:?}");
        let keys: Vec<&String> = own[0].as_object().expect("an object").keys().collect();
        assert_eq!(keys, ["code", "event", "gyros", "statistic", "t_s", "threshold"]);
    }
    assert_eq!(alarms.len(), 2, "{alarms:?}");
    assert_eq!(watch(&recording, true, &[]).stdout, output.stdout, "the same again");

    // Without a reference the pair shows a drift of GYRZB.
    let pair = events(&watch(&recording, false, &[]));
    assert_eq!(pair[0]["event"], "alarm", "{pair:?}");
    assert_eq!(pair[0]["gyros"], serde_json::json!(["GYRZA", "GYRZB"]));
}

#[test]
fn a_reference_of_another_time_is_said_to_show_no_change() {
    let directory = tempfile::tempdir().expect("a directory");
    let recording = directory.path().join("recording");
    simulate(&recording, "2400", &[]);
    let reference = fs::read_to_string(recording.join("reference.csv")).expect("recorded");
    let later = |line: &str| match line.split_once(',').and_then(|(time, row)| Some((time.parse::<f64>().ok()?, row))) {
        Some((t_s, row)) => format!("{},{row}\n", t_s + 1e6),
        None => format!("{line}\n"),
    };
    fs::write(recording.join("reference.csv"), reference.lines().map(later).collect::<String>()).expect("written");
    let said = text(&watch(&recording, true, &[]).stderr);
    assert!(said.contains("expected more than half an hour of the input along the reference, got 0 s"), "{said}");
}

#[test]
fn a_drift_injected_into_a_running_unit_has_an_alarm_and_a_name() {
    let directory = tempfile::tempdir().expect("a directory");
    let truth = directory.path().join("truth");
    simulate(&truth, LENGTH_S, &[]);
    let speed = ["--tcp", "127.0.0.1:0", "--control", "127.0.0.1:0", "--speed", "400", "--seed", "71", "--start", "0"];
    let mut emulator = Emulator::start(1, &speed);
    let control = emulator.control();
    let link = emulator.ready[0].strip_prefix("tcp ").expect("a TCP link").to_owned();
    let mut child = geu()
        .args(["watch", &link, "--clock", "--reference"])
        .arg(truth.join("reference.csv"))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("geu starts");
    let said = BufReader::new(child.stderr.take().expect("a pipe"));
    std::thread::spawn(move || said.lines().for_each(drop));
    // From 3000 s of on-board time: after the start, in the scan.
    let inject = ["inject", "--control", &control, "drift.arcsec_per_h", "GYRX", "step=400", "at_s=3000"];
    let output = geu().args(inject).output().expect("geu starts");
    assert!(output.status.success(), "{}", text(&output.stderr));

    let patience = Instant::now() + Duration::from_secs(60);
    let mut events: Vec<Value> = Vec::new();
    for line in BufReader::new(child.stdout.take().expect("a pipe")).lines() {
        events.push(serde_json::from_str(&line.expect("text")).expect("a line of JSON"));
        if ["named", "reference-end"].iter().any(|last| events.last().is_some_and(|event| event["event"] == *last))
            || Instant::now() > patience
        {
            break;
        }
    }
    // The emulator has each event, as printed and with a number, found by its link.
    let patience = Instant::now() + Duration::from_secs(20);
    let posted = loop {
        let answer = ask(&control, "GET", "/api/watch", "", "").1;
        let posted: Vec<Value> = serde_json::from_str(&answer).expect("a list");
        if posted.len() >= events.len() || Instant::now() > patience {
            break posted;
        }
        sleep(Duration::from_millis(50));
    };
    child.kill().expect("it runs");
    child.wait().expect("its end");
    for (number, event) in events.iter().enumerate() {
        let mut event = event.clone();
        event["number"] = (number + 1).into();
        assert_eq!(posted.get(number), Some(&event), "{posted:?}");
    }
    let alarm =
        events.iter().find(|event| event["event"] == "alarm").unwrap_or_else(|| panic!("no alarm in {events:?}"));
    assert_eq!(alarm["gyros"], serde_json::json!(["GYRX"]), "{events:?}");
    let named = events.iter().find(|event| event["event"] == "named");
    assert!(named.is_none_or(|named| named["code"] == "drift"), "{events:?}");
}

#[test]
fn an_emulator_that_is_absent_slow_or_refuses_neither_ends_nor_delays_a_watch() {
    let directory = tempfile::tempdir().expect("a directory");
    let (recording, plan) = (directory.path().join("gaps"), directory.path().join("plan.toml"));
    let gap = |at_s: u32| format!("[[fault]]\nfault = \"drop\"\nat_s = {at_s}.0\nfor_s = 3.0\n");
    fs::write(&plan, gap(100) + &gap(200) + &gap(300)).expect("written");
    simulate(&recording, "400", &["--faults", plan.to_str().expect("text")]);
    let alone = watch(&recording, false, &["--control", "off"]);
    assert_eq!(events(&alone).len(), 3, "{}", text(&alone.stdout));
    assert!(!text(&alone.stderr).contains("posts events"), "{}", text(&alone.stderr));

    let token = directory.path().join("token");
    fs::write(&token, "secret-word").expect("written");
    let arguments = ["--tcp", "127.0.0.1:0", "--control", "127.0.0.1:0", "--control-token-file"];
    let mut emulator = Emulator::start(1, &[&arguments[..], &[token.to_str().expect("text")]].concat());
    let refusing = emulator.control();
    // Never accepts.
    let slow = TcpListener::bind("127.0.0.1:0").expect("a port");
    let absent = TcpListener::bind("127.0.0.1:0").expect("a port").local_addr().expect("an address").to_string();
    for (control, expected) in [
        (refusing.as_str(), "expected the token of the emulator"),
        (&absent, "expected a running emulator"),
        (&slow.local_addr().expect("an address").to_string(), "too slow"),
    ] {
        let start = Instant::now();
        let output = watch(&recording, false, &["--control", control]);
        assert!(start.elapsed() < Duration::from_secs(10), "{:?}", start.elapsed());
        let said = text(&output.stderr);
        assert!(output.status.success() && said.contains(expected), "{said}");
        assert_eq!(said.matches("the bench page lacks an event").count(), 1, "{said}");
        assert_eq!(output.stdout, alone.stdout, "{said}");
    }
    let with_token = ["--control", &refusing, "--control-token-file", token.to_str().expect("text")];
    assert!(!text(&watch(&recording, false, &with_token).stderr).contains("lacks"));
    let authorization = "authorization: Bearer secret-word\r\n";
    let list = || {
        serde_json::from_str::<Vec<Value>>(&ask(&refusing, "GET", "/api/watch", authorization, "").1).expect("a list")
    };
    assert_eq!(list().len(), 3);

    // Other bodies are refused with one message, and changes no list.
    for (body, expected) in [
        ("{}", "t_s: expected a time from 0 to 1e12 s, got none"),
        ("[1]", "body: expected a JSON object, got [1]"),
        (
            r#"{"t_s":1,"event":"<img src=x>","code":"drift","gyros":[],"statistic":1,"threshold":1}"#,
            "event: expected alarm, named, interruption or reference-end, got",
        ),
        (r#"{"t_s":1e999}"#, "body: expected a JSON object: number out of range"),
        (&format!(r#"{{"{}":1}}"#, "x".repeat(900)), "expected the keys t_s, event, code"),
        (&"[".repeat(1025), "body: expected at most 1024 bytes, got more"),
    ] {
        let (status, answer) = ask(&refusing, "POST", "/api/watch", authorization, body);
        let refused: Value = serde_json::from_str(&answer).expect("JSON");
        assert!(
            [400, 413].contains(&status) && refused["error"].as_str().is_some_and(|error| error.starts_with(expected)),
            "{answer}"
        );
    }
    assert_eq!(ask(&refusing, "POST", "/api/watch", "", "{}").0, 401);
    assert_eq!(list().len(), 3);
}

#[test]
fn refused_input_is_one_message_and_a_closed_output_ends_it_quietly() {
    let directory = tempfile::tempdir().expect("a directory");
    let recording = directory.path().join("recording");
    simulate(&recording, "100", &[]);
    let link = recording.join("link.log");
    let refused = |arguments: &[&str], expected: &str| {
        let output = geu().arg("watch").args(arguments).output().expect("geu starts");
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(expected), "{expected} not in {said}");
        assert!(output.stdout.is_empty());
    };
    let link = link.to_str().expect("text");
    refused(&[link, "--reference", "none.csv"], "none.csv");
    refused(&[link, "--reference", link], "link.log");
    refused(&[link, "--config", "none.toml"], "none.toml");
    refused(&["no-such-link"], "no-such-link");

    let mut child =
        geu().args(["watch", link, "-q"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("geu starts");
    drop(child.stdout.take());
    let output = child.wait_with_output().expect("its end");
    assert_eq!((output.status.code(), text(&output.stderr)), (Some(0), String::new()));
}

#[test]
fn a_head_of_a_described_unit_that_changed_is_an_alarm_with_its_name() {
    let directory = tempfile::tempdir().expect("a directory");
    let turns = |[x, y, z]: [f64; 3]| {
        format!(
            "[[motion]]\nduration_s = 300.0\nx_deg_s = {x}\ny_deg_s = {y}\nz_deg_s = {z}\n[[motion]]\nduration_s = 60.0\n"
        )
    };
    let rates = [[0.5, 0.0, 0.1], [0.0, -0.4, 0.0], [-0.3, 0.2, 0.6], [0.0, 0.3, -0.5], [-0.4, 0.0, 0.0]];
    let motion: String = rates.iter().cycle().take(15).map(|rates| turns(*rates)).collect();
    for (device, heads, head, link) in
        [("tetrad", &["A", "B", "C", "D"][..], "C", "link.bin"), ("mm5.10", &["Z", "X"], "X", "link.log")]
    {
        let (unit, out) = (directory.path().join(format!("{device}.toml")), directory.path().join(device));
        // The configuration of the watch has no noise: the first half hour shows it.
        let noise = |own: &str| format!("[gyro.{own}]\nangle-random-walk = {{ arcsec_per_sqrt_s = 0.4 }}\n");
        let noise: String = heads.iter().map(|own| noise(own)).collect();
        fs::write(&unit, format!("device = \"{device}\"\n{noise}{motion}")).expect("written");
        let unit = unit.to_str().expect("text");
        let step = [format!("gyro.{head}.drift-step.arcsec_per_h=900"), format!("gyro.{head}.drift-step.time_s=3000")];
        let mut simulate = geu();
        simulate.args(["simulate", unit, "--duration", "5400", "--set", &step[0], "--set", &step[1], "--out"]);
        let output = simulate.arg(&out).output().expect("geu starts");
        assert!(output.status.success(), "{}", text(&output.stderr));
        let (link, reference) = (out.join(link), out.join("reference.csv"));
        if device == "tetrad" {
            // A second of it is lost on the line.
            let bytes = fs::read(&link).expect("a link");
            let length = bytes.len() / 540_000;
            fs::write(&link, [&bytes[..250_000 * length], &bytes[250_100 * length..]].concat()).expect("written");
        }
        let mut watch = geu();
        watch.arg("watch").arg(&link).args(["--device", device, "--control", "off", "--reference"]).arg(&reference);
        let output = watch.output().expect("geu starts");
        let seen: Vec<(String, String, Value)> = events(&output)
            .into_iter()
            .map(|event| {
                let word = |key: &str| event[key].as_str().expect("a word").to_owned();
                if event["event"] == "alarm" {
                    assert!((3000.0..3900.0).contains(&event["t_s"].as_f64().expect("a time")), "{event}");
                }
                (word("event"), word("code"), event["gyros"].clone())
            })
            .collect();
        let own = serde_json::json!([head]);
        let all = serde_json::json!(heads);
        let mut expected = vec![("alarm", "unknown", &own), ("named", "drift", &own)];
        if device == "tetrad" {
            expected.insert(0, ("interruption", "lost-samples", &all));
        }
        let seen: Vec<(&str, &str, &Value)> = seen.iter().map(|(a, b, c)| (a.as_str(), b.as_str(), c)).collect();
        assert_eq!(seen, expected, "{device}: {}", text(&output.stderr));

        let output = geu().arg("watch").arg(&link).args(["--device", device]).output().expect("geu starts");
        let said = text(&output.stderr);
        assert!(output.status.code() == Some(2) && said.contains("expected --reference FILE"), "{said}");
    }
}
