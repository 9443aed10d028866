//! A test that cannot run here says so past the capture of the harness, and is counted as skipped.

use std::fs;
use std::process::Command;

use geu_tests::{recordings, root};

/// Set for the tests that this file starts in a process of its own.
const IS_CHILD: &str = "GEU_SKIPPED_TEST";

/// The line that `.ci/count` prints of these logs.
fn counted(logs: &[&str]) -> String {
    let room = tempfile::tempdir().expect("a directory");
    let mut count = Command::new(root().join(".ci/count"));
    for (index, log) in logs.iter().enumerate() {
        let path = room.path().join(index.to_string());
        fs::write(&path, log).expect("written");
        count.arg(path);
    }
    let output = count.output().expect("awk is installed");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).trim().to_owned()
}

#[test]
fn without_recordings_a_test_says_skipped_and_counts_as_skipped() {
    if std::env::var_os(IS_CHILD).is_some() {
        assert_eq!(recordings("01"), None);
        return;
    }
    // Beside others, and one test at a time, where the harness has begun the line.
    for threads in ["2", "1"] {
        let mut test = Command::new(std::env::current_exe().expect("the path of this test"));
        test.args(["--exact", "skipped::without_recordings_a_test_says_skipped_and_counts_as_skipped"]);
        test.args(["--test-threads", threads]).env("GEU_RECORDINGS", "/nonexistent").env(IS_CHILD, "1");
        let output = test.output().expect("this test starts");
        let [said, log] = [&output.stderr, &output.stdout].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
        assert!(output.status.success(), "{log}{said}");
        assert!(said.starts_with("skipped: ") && said.contains("/nonexistent/01 is not there"), "{said}");
        assert_eq!(said.lines().count(), 1, "{said}");
        assert!(threads == "1" || said.contains(": skipped::without_recordings_"), "the test's name: {said}");
        // As a terminal or a log has them, standard error behind what the harness has written so far.
        let log = log.replacen("... ok", &format!("... {said}ok"), 1);
        assert_eq!(counted(&[&log]), "0 passed, 0 failed, 1 skipped", "{log}");
    }
}

#[test]
fn skipped_failed_and_ignored_tests_are_counted_each_once() {
    let tests = "test one ... ok\ntest long ... ignored, minutes; .ci/run has it\ntest never ... ignored\n\
                 skipped: two: no tool\ntest two ... ok\ntest three ... FAILED\n\
                 test result: FAILED. 2 passed; 1 failed; 2 ignored; 0 measured; 0 filtered out; finished in 0.10s\n";
    assert_eq!(counted(&[tests]), "1 passed, 1 failed, 3 skipped");
    let later = "test long ... ok\ntest result: ok. 1 passed; 0 failed; 0 ignored; 0 measured; 4 filtered out\n";
    assert_eq!(counted(&[tests, later]), "2 passed, 1 failed, 2 skipped");
    // A word in passing is no skipped test; a script's closing line counts as it says.
    assert_eq!(
        counted(&["12 bytes were skipped: noise\n3 passed, 0 failed, 2 skipped\n"]),
        "3 passed, 0 failed, 2 skipped"
    );
}
