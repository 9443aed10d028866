//! Tests that need two crates or a process stand in `tests/`; here is what they share.

pub mod comparison;
pub mod emulator;
pub mod page;
pub mod whitening;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// The root of the workspace.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap_or(Path::new("."))
}

/// The program `geu` of this build.
///
/// # Panics
/// Where it cannot be built.
pub fn geu() -> Command {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    apart(Command::new(PROGRAM.get_or_init(|| program("geu"))))
}

/// The same, with a runtime directory of its own: emulators of the user and those of tests do not find each other.
fn apart(mut command: Command) -> Command {
    static RUNTIME: OnceLock<PathBuf> = OnceLock::new();
    command.env(
        "XDG_RUNTIME_DIR",
        RUNTIME.get_or_init(|| {
            let test = std::env::current_exe().expect("the path of this test");
            let runtime = test.with_file_name("runtime");
            std::fs::create_dir_all(&runtime).expect("a directory beside the tests");
            runtime
        }),
    );
    command
}

/// The on-board computer of this build, with the `geu` beside it.
///
/// # Panics
/// Where one of them cannot be built.
pub fn geu_obc() -> Command {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    apart(Command::new(PROGRAM.get_or_init(|| {
        program("geu");
        program("geu-obc")
    })))
}

/// The program of a package of the same name.
///
/// `cargo test` at the root builds it. `cargo test -p geu-tests` alone does not: it takes the one that is there, and
/// builds it where there is none.
fn program(name: &str) -> PathBuf {
    // A test runs in <target>/<profile>/deps.
    let test = std::env::current_exe().expect("the path of this test");
    let directory = test.ancestors().nth(2).expect("the directory of the profile");
    let program = directory.join(name);
    if !program.exists() {
        let release = directory.ends_with("release");
        let mut cargo = Command::new(env!("CARGO"));
        cargo.current_dir(root()).args(["build", "--package", name]).args(release.then_some("--release"));
        let built = cargo.status().is_ok_and(|status| status.success());
        assert!(built && program.exists(), "{} is missing: run `cargo build` first", program.display());
    }
    program
}

/// Says on standard error that a test could not run, and why.
pub fn skipped(reason: &str) {
    // Not eprintln!, which the test harness keeps to itself when a test passes.
    let _ = writeln!(std::io::stderr(), "skipped: {reason}");
}
