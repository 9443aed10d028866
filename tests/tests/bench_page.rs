//! Data of the bench page: the last ten minutes at any speed, and the reason why a sample was not sent.

use std::time::{Duration, Instant};

use geu_tests::emulator::Emulator;
use geu_tests::http::ask;
use serde_json::Value;

fn get(address: &str, path: &str) -> String {
    let (status, body) = ask(address, "GET", path, "", "");
    assert_eq!(status, 200, "{body}");
    body
}

fn json(address: &str, path: &str) -> Value {
    serde_json::from_str(&get(address, path)).expect("JSON")
}

#[test]
fn a_run_at_a_thousand_times_keeps_its_last_ten_minutes_and_counts_unread_samples() {
    let directory = tempfile::tempdir().expect("a directory");
    let pty = directory.path().join("geu0").display().to_string();
    let arguments = ["--pty", &pty, "--tcp", "127.0.0.1:0", "--control", "127.0.0.1:0", "--speed", "1000"];
    let mut emulator = Emulator::start(2, &arguments);
    let address = emulator.control();
    // 1200 samples take 0.6 s; the rest is for a loaded machine.
    let start = Instant::now();
    let mut history = json(&address, "/api/history");
    while history.as_array().map(Vec::len) != Some(1200) && start.elapsed() < Duration::from_secs(30) {
        history = json(&address, "/api/history");
    }
    let reported = history.as_array().expect("a list");
    let times: Vec<f64> = reported.iter().filter_map(|sample| sample["t_s"].as_f64()).collect();
    assert_eq!(times.len(), 1200);
    assert!(times.windows(2).all(|pair| pair[1] - pair[0] == 0.5), "{times:?}");
    // A fast run publishes its status less often than each sample.
    let links = || json(&address, "/api/status")["links"].as_array().expect("links").clone();
    let has_all = |link: &Value| link["unread"].as_u64().is_some_and(|unread| unread >= 1200);
    while !links().iter().all(has_all) {
        assert!(start.elapsed() < Duration::from_secs(30), "{:?}", links());
    }
    for link in links() {
        assert_eq!((&link["sent"], &link["dropped"], &link["clients"]), (&0.into(), &0.into(), &0.into()), "{link}");
    }
    emulator.ask_to_end();
    let (_, said) = emulator.end();
    assert!(said.contains("not sent (no reader)"), "{said}");
}

#[test]
fn the_page_names_its_angles_distinguishes_alarms_and_requests_the_history() {
    let mut emulator = Emulator::start(1, &["--tcp", "127.0.0.1:0", "--control", "127.0.0.1:0"]);
    let address = emulator.control();
    let script = get(&address, "/page.js");
    for part in ["solar aspect angle θ", "angle about the sun vector ψ", "/api/history", "_saturated", "self_test"] {
        assert!(script.contains(part), "{part}");
    }
    assert!(get(&address, "/charts.js").contains("not valid") && get(&address, "/").contains("no reader"));
    let style = get(&address, "/page.css");
    assert!(style.contains("--tone: var(--bad)") && style.contains("--tone: var(--doubt)"), "{style}");
}
