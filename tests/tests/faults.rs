//! Link faults with a client: late and withheld messages, and their entries in `faults.jsonl`.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use geu_protocol::serial::{FrameType, frame};
use geu_tests::emulator::Emulator;
use geu_tests::geu;
use serde_json::{Value, json};

fn file(directory: &Path, name: &str, text: &str) -> PathBuf {
    let path = directory.join(name);
    fs::write(&path, text).expect("written");
    path
}

fn events(recording: &Path) -> Vec<Value> {
    let text = fs::read_to_string(recording.join("faults.jsonl")).expect("a file");
    text.lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect()
}

fn events_of<'a>(events: &'a [Value], what: &str) -> Vec<&'a Value> {
    events.iter().filter(|event| event["what"] == what).collect()
}

fn simulate(configuration: &Path, out: &Path, more: &[&str]) {
    let output =
        geu().arg("simulate").arg(configuration).arg("--out").arg(out).args(more).output().expect("geu starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn a_command_acts_at_once_and_only_its_reply_is_late() {
    let directory = tempfile::tempdir().expect("a directory");
    let plan = file(directory.path(), "plan.toml", "[[fault]]\nid = \"late\"\nfault = \"reply-late\"\ndelay_s = 1.0\n");
    let (live, again) = (directory.path().join("live"), directory.path().join("again"));
    let (plan, recorded) = (plan.to_str().expect("text"), live.to_str().expect("text"));
    let (emulator, mut client) =
        Emulator::on_tcp(&["--faults", plan, "--record", recorded, "--wire", "serial", "--control", "off"]);
    assert!(client.read_until(|client| client.samples.len() == 1));
    let start = Instant::now();
    // The first command stops the samples at once.
    for payload in [&[2, 1][..], &[1], &[1]] {
        client.stream.write_all(&frame(FrameType::Command, payload)).expect("written");
        std::thread::sleep(Duration::from_millis(20));
    }
    for count in 1..=3_u32 {
        assert!(client.read_until(|client| client.replies.len() as u32 >= count));
        let (took, min) = (start.elapsed(), Duration::from_millis(1000 + 20 * u64::from(count - 1)));
        assert!(took >= min && took < min + Duration::from_millis(400), "reply {count} after {took:?}");
    }
    assert_eq!(client.samples.len(), 1, "samples had stopped by then");
    // A reply that is still delayed at the end is sent then.
    client.stream.write_all(&frame(FrameType::Command, &[1])).expect("written");
    std::thread::sleep(Duration::from_millis(50));
    emulator.ask_to_end();
    client.read_until(|_| false);
    assert_eq!(emulator.end().0, Some(0));
    assert_eq!(client.replies.len(), 4);
    let reported = events(&live);
    let replies = events_of(&reported, "reply");
    assert_eq!(replies.len(), 4);
    assert_eq!(replies[0]["half_second"], replies[2]["half_second"], "all came in one sample interval");
    assert_eq!((&replies[1]["command"], &replies[1]["ids"]), (&json!("01"), &json!(["late"])));
    assert_eq!((&replies[1]["late_s"], &replies[1]["link"]), (&json!(1.0), &json!("tcp")));
    assert_eq!(replies[1]["before"], replies[1]["after"]);
    simulate(&live.join("run.toml"), &again, &[]);
    assert_eq!(events(&again), reported);
}

#[test]
fn withheld_messages_are_sent_and_recorded_at_the_end() {
    let directory = tempfile::tempdir().expect("a directory");
    let text = "[[fault]]\nfault = \"delay\"\ndelay_s = 60.0\nat_s = 1.0\n[[fault]]\nfault = \"babble\"\nat_s = 2.0\n\
                [[fault]]\nfault = \"merge\"\nframes = 64\nat_s = 2.0\nuntil_s = 2.5\n";
    let plan = file(directory.path(), "plan.toml", text);
    let plan = plan.to_str().expect("text");
    for is_asked_to_end in [false, true] {
        let [live, again] = ["live", "again"].map(|name| directory.path().join(format!("{name}-{is_asked_to_end}")));
        let recorded = ["--record", live.to_str().expect("text"), "--wire", "serial", "--control", "off", "--wait"];
        let (emulator, mut client) =
            Emulator::on_tcp(&[&recorded[..], &["--faults", plan, "--speed", "4", "--duration", "6"]].concat());
        if is_asked_to_end {
            assert!(client.read_until(|client| client.bytes.len() > 90));
            emulator.ask_to_end();
        }
        client.read_until(|_| false);
        assert_eq!(emulator.end().0, Some(0));
        let link = fs::read(live.join("link.bin")).expect("a recording");
        assert_eq!(link, client.bytes, "asked to end: {is_asked_to_end}");
        assert!(is_asked_to_end || client.samples.len() == 12, "{}", client.samples.len());
        simulate(&live.join("run.toml"), &again, &[]);
        assert!(link == fs::read(again.join("link.bin")).expect("a recording"));
    }
}

#[test]
fn a_frame_with_a_long_gap_arrives_whole() {
    let directory = tempfile::tempdir().expect("a directory");
    let text = "[[fault]]\nlink = \"tcp\"\nfault = \"split\"\nbyte = 9\ngap_s = 1.3\nat_s = 1.0\nfor_s = 1.5\n";
    let plan = file(directory.path(), "plan.toml", text);
    let arguments = ["--faults", plan.to_str().expect("text"), "--speed", "4", "--duration", "8", "--control", "off"];
    let (emulator, mut client) = Emulator::on_tcp(&[&arguments[..], &["--wait"]].concat());
    for count in 1..30 {
        if client.stream.write_all(&frame(FrameType::Command, &[1])).is_err() {
            break;
        }
        client.read_for(Duration::from_millis(60), |client| client.replies.len() >= count);
    }
    client.read_until(|_| false);
    assert_eq!(emulator.end().0, Some(0));
    assert!(client.is_without_gap() && client.samples.len() == 16, "{}", client.samples.len());
    assert!(client.replies.len() >= 20, "{} replies", client.replies.len());
}

#[test]
fn the_fault_log_of_a_polled_sample_names_its_own_bytes() {
    let directory = tempfile::tempdir().expect("a directory");
    let text = "[run]\nduration_s = 5.0\nwire = \"serial\"\nlinks = [\"pty\", \"tcp\"]\n\
                [[fault]]\nid = \"st\"\nfault = \"stuck-count\"\ngyro = \"GYRX\"\ncounts = 77\nat_s = 1.0\nfor_s = 0.5\n\
                [[fault]]\nid = \"late\"\nfault = \"delay\"\ndelay_s = 0.2\nlink = \"tcp\"\nat_s = 1.5\nfor_s = 0.5\n\
                [[run.command]]\nhalf_second = 0\nlink = \"tcp 127.0.0.1:1\"\nbytes = \"0201\"\n\
                [[run.command]]\nhalf_second = 3\nlink = \"control\"\nbytes = \"03\"\n\
                [[run.command]]\nhalf_second = 3\nlink = \"tcp 127.0.0.1:1\"\nbytes = \"03\"\n";
    let (run, out) = (file(directory.path(), "run.toml", text), directory.path().join("out"));
    simulate(&run, &out, &["--wire", "can"]);
    let reported = events(&out);
    let bytes = events_of(&reported, "bytes");
    assert_eq!(bytes.len(), 1, "over the link that asked, and no other: {bytes:?}");
    assert_eq!(
        (&bytes[0]["half_second"], &bytes[0]["t_s"], &bytes[0]["polled"]),
        (&json!(2), &json!(1.5), &json!(true))
    );
    assert_eq!((&bytes[0]["link"], &bytes[0]["ids"]), (&json!("tcp"), &json!(["st", "late"])));
    let touched: Vec<_> =
        events_of(&reported, "end").into_iter().map(|end| (end["id"].clone(), end["touched"].clone())).collect();
    assert!(touched.contains(&(json!("late"), json!(1))), "{touched:?}");
    // Two polls of the same sample: time stamps increase.
    let log = fs::read_to_string(out.join("link.log")).expect("a recording");
    let stamps: Vec<&str> = log.lines().map(|line| line.split(' ').next().expect("a stamp")).collect();
    assert!(stamps.len() == 6 && stamps.is_sorted(), "{log}");
}

#[test]
fn a_polled_sample_that_is_late_is_recorded_when_it_leaves() {
    let directory = tempfile::tempdir().expect("a directory");
    let text = "[run]\nduration_s = 5.0\nwire = \"can\"\n\
                [[fault]]\nfault = \"delay\"\ndelay_s = 0.7\nat_s = 1.5\nfor_s = 0.5\n\
                [[run.command]]\nhalf_second = 0\nlink = \"control\"\nbytes = \"0201\"\n\
                [[run.command]]\nhalf_second = 3\nlink = \"control\"\nbytes = \"03\"\n\
                [[run.command]]\nhalf_second = 3\nlink = \"control\"\nbytes = \"0200\"\n";
    let (run, out) = (file(directory.path(), "run.toml", text), directory.path().join("out"));
    simulate(&run, &out, &[]);
    let log = fs::read_to_string(out.join("link.log")).expect("a recording");
    let stamps: Vec<&str> = log.lines().map(|line| line.split(' ').next().expect("a stamp")).collect();
    assert!(stamps.is_sorted() && stamps[0] == "(2.200000)", "{log}");
}

#[test]
fn a_command_to_a_silent_unit_is_logged_with_its_missing_reply() {
    let directory = tempfile::tempdir().expect("a directory");
    let text = "[run]\nduration_s = 5.0\nwire = \"serial\"\nlinks = [\"tcp\"]\n\
                [[fault]]\nid = \"r\"\nfault = \"reset\"\nat_s = 1.0\n\
                [[run.command]]\nhalf_second = 0\nlink = \"tcp 127.0.0.1:1\"\nbytes = \"01\"\n\
                [[run.command]]\nhalf_second = 3\nlink = \"tcp 127.0.0.1:1\"\nbytes = \"01\"\n";
    let (run, out) = (file(directory.path(), "run.toml", text), directory.path().join("out"));
    simulate(&run, &out, &[]);
    let reported = events(&out);
    let replies = events_of(&reported, "reply");
    assert_eq!(replies.len(), 1, "{replies:?}");
    assert_eq!((&replies[0]["half_second"], &replies[0]["ids"]), (&json!(3), &json!(["r"])));
    assert!(
        replies[0]["before"].as_str().is_some_and(|text| text.starts_with("EB90")) && replies[0]["after"].is_null()
    );
}

#[test]
fn a_message_withheld_for_a_sample_after_the_end_has_that_sample_s_time() {
    let directory = tempfile::tempdir().expect("a directory");
    let text = "[run]\nduration_s = 5.0\nwire = \"can\"\nlinks = [\"can\"]\n\
                [[fault]]\nfault = \"reorder\"\nat_s = 4.5\n[[fault]]\nfault = \"babble\"\namount = 2\nat_s = 4.5\n";
    let (run, out) = (file(directory.path(), "run.toml", text), directory.path().join("out"));
    simulate(&run, &out, &[]);
    let log = fs::read_to_string(out.join("link.log")).expect("a recording");
    let stamps: Vec<f64> = log
        .lines()
        .filter_map(|line| line.split(['(', ')']).nth(1)?.parse().ok())
        .filter(|&stamp_s: &f64| stamp_s > 4.6)
        .collect();
    let reported = events(&out);
    let late: Vec<f64> = events_of(&reported, "bytes")[0]["after"]
        .as_array()
        .expect("frames")
        .iter()
        .filter_map(|frame| frame["late_s"].as_f64())
        .collect();
    let mut claimed: Vec<f64> = late.iter().map(|late_s| 5.0 + late_s).collect();
    claimed.sort_by(f64::total_cmp);
    assert_eq!(stamps.len(), 5, "{log}");
    assert!(
        stamps.iter().zip(&claimed).all(|(stamp_s, due_s)| (stamp_s - due_s).abs() < 1e-5),
        "{stamps:?} {claimed:?}"
    );
}
