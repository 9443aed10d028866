//! The on-board computer in lock-step with a unit that a fault silences.

use geu_tests::geu_obc;

#[test]
fn loop_continues_through_a_silence_and_a_broken_frame_and_is_reproducible() {
    let directory = tempfile::tempdir().expect("a directory");
    let plan = directory.path().join("plan.toml");
    let text = "[[fault]]\nfault = \"bit-flip\"\nbits = 3\nat_s = 0.0\nfor_s = 0.5\n\n[[fault]]\nfault = \"silence\"\nat_s = 20.0\nfor_s = 3.0\n";
    std::fs::write(&plan, text).expect("written");
    let run = || {
        let arguments = ["--duration", "60", "--speed", "max", "--faults", plan.to_str().expect("UTF-8")];
        geu_obc().args(arguments).output().expect("geu-obc starts")
    };
    let first = run();
    let stderr = String::from_utf8_lossy(&first.stderr);
    // The first sample of a turn of 12″/s is lost: the loop holds an attitude that is some arcseconds off.
    assert_eq!(first.status.code(), Some(1), "{stderr}");
    assert!(String::from_utf8_lossy(&first.stdout).contains("pointing not held: after 40 s the true error was 6."));
    assert!(stderr.contains("samples 120,") && stderr.contains("reports 120 sent, 0 dropped"), "{stderr}");
    assert!(stderr.contains("late intervals 0, missing 0, jumps 0"), "{stderr}");
    // A line each second, the silent ones too.
    assert_eq!(String::from_utf8_lossy(&first.stdout).matches("pointing error: true").count(), 60);
    assert_eq!(run().stdout, first.stdout);
}
