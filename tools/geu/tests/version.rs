//! The program itself. That this test is here makes `cargo test` build the program that the tests in `tests/` run.

use std::process::Command;

#[test]
fn version_tells_the_link_version_too() {
    let output = Command::new(env!("CARGO_BIN_EXE_geu")).arg("--version").output().expect("the program runs");
    let (major, minor) = geu_protocol::LINK_VERSION;
    let expected = format!("geu {} (link version {major}.{minor})\n", env!("CARGO_PKG_VERSION"));
    assert_eq!(String::from_utf8_lossy(&output.stdout), expected);
}
