//! The help of `geu-obc`. With this test `cargo test` builds the program, which the tests of two programs need.

use std::process::Command;

#[test]
fn the_help_lists_the_exit_codes() {
    let help = Command::new(env!("CARGO_BIN_EXE_geu-obc")).arg("--help").output().expect("geu-obc starts").stdout;
    let help = String::from_utf8_lossy(&help);
    for part in ["Exit codes:", "  0  pointing was held", "  1  it was not held", "  2  the run could not start"] {
        assert!(help.contains(part), "{part} not in {help}");
    }
}
