//! The on-board computer in lock-step with a unit that a fault keeps silent.

use geu_tests::geu_obc;

#[test]
fn a_loop_goes_on_through_a_silence_and_a_broken_frame_and_is_the_same_again() {
    let room = tempfile::tempdir().expect("a directory");
    let plan = room.path().join("plan.toml");
    let text = "[[fault]]\nfault = \"bit-flip\"\nbits = 3\nat_s = 0.0\nfor_s = 0.5\n\n[[fault]]\nfault = \"silence\"\nat_s = 20.0\nfor_s = 3.0\n";
    std::fs::write(&plan, text).expect("written");
    let fly = || {
        let arguments = ["--duration", "60", "--speed", "max", "--faults", plan.to_str().expect("UTF-8")];
        geu_obc().args(arguments).output().expect("geu-obc starts")
    };
    let first = fly();
    let said = String::from_utf8_lossy(&first.stderr);
    // What the first sample told of a turn of 12″/s is lost: the loop holds another attitude, some arcseconds off.
    assert_eq!(first.status.code(), Some(1), "{said}");
    assert!(String::from_utf8_lossy(&first.stdout).contains("pointing not held: after 40 s the true error was 6."));
    assert!(said.contains("samples 120,") && said.contains("reports 120 sent, 0 dropped"), "{said}");
    assert!(said.contains("late samples 0, missing 0, jumps 0"), "{said}");
    // A line each second, the silent ones too.
    assert_eq!(String::from_utf8_lossy(&first.stdout).matches("pointing error: true").count(), 60);
    assert_eq!(fly().stdout, first.stdout);
}
