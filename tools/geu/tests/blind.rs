//! `geu blind` as a user runs it.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn geu(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_geu")).arg("blind").args(arguments).output().expect("geu runs")
}

fn names(directory: &Path) -> Vec<String> {
    let entries = fs::read_dir(directory).expect("a directory");
    let mut names: Vec<String> =
        entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("text")).collect();
    names.sort();
    names
}

#[test]
fn key_is_separate_from_the_recording_and_a_score_needs_it() {
    let directory = tempfile::tempdir().expect("a directory");
    let [one, other] = ["one", "other"].map(|name| directory.path().join(name));
    for out in [&one, &other] {
        let written =
            geu(&["hide", "--seed", "5", "--duration", "1200", "--count", "2", "--out", out.to_str().expect("text")]);
        assert!(written.status.success() && written.stdout.is_empty() && written.stderr.is_empty(), "{written:?}");
    }
    assert_eq!(names(&one), ["1", "2"]);
    for number in ["1", "2"] {
        let recording = one.join(number).join("recording");
        assert_eq!(names(&recording), ["link.log", "nominal.toml", "reference.csv"]);
        for (place, name) in [("recording", "link.log"), ("recording", "reference.csv"), ("key", "key.toml")] {
            let read = |out: &Path| fs::read(out.join(number).join(place).join(name)).expect("written");
            assert_eq!(read(&one), read(&other), "{place}/{name}");
        }
        let nominal = fs::read_to_string(recording.join("nominal.toml")).expect("written");
        assert_eq!(nominal, fs::read_to_string(one.join("1/recording/nominal.toml")).expect("written"));
    }

    let [key, result] = ["key.toml", "result.json"].map(|name| directory.path().join(name));
    fs::write(&key, "seed = 1\nduration_s = 1200.0\n").expect("written");
    let scored = |text: &str| {
        fs::write(&result, text).expect("written");
        geu(&["score", "--key", key.to_str().expect("text"), "--json", result.to_str().expect("text")])
    };
    let consistent = scored(r#"{"verdict": "consistent", "effects": []}"#);
    assert_eq!(
        (consistent.status.code(), &consistent.stdout[..]),
        (Some(0), &b"injected  nothing\nverdict   consistent\n"[..])
    );
    let misnamed =
        r#"{"code": "drift-step", "class": "missing-effect", "gyros": ["GYRX"], "parameters": {}, "rivals": []}"#;
    let misnamed = scored(&format!(r#"{{"verdict": "explained", "effects": [{misnamed}]}}"#));
    assert_eq!(misnamed.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&misnamed.stdout).contains("\nfalse alarm  GYRX drift-step\n"), "{misnamed:?}");
    let broken = scored("{}");
    assert_eq!(broken.status.code(), Some(2));
    assert!(
        String::from_utf8_lossy(&broken.stderr).contains("verdict: expected consistent, explained or unexplained"),
        "{broken:?}"
    );
}
