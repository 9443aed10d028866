//! Shared parts of the tests in `tests/`, which need two crates or a process.

pub mod comparison;
pub mod emulator;
pub mod http;
pub mod page;
pub mod pty;
pub mod simulator;
pub mod stalled_disk;
pub mod whitening;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use nix::libc::{PRIO_PROCESS, setpriority};

/// The root of the workspace.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap_or(Path::new("."))
}

/// The program `geu` of this build.
///
/// # Panics
/// If it cannot be built.
pub fn geu() -> Command {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    isolated(Command::new(PROGRAM.get_or_init(|| program("geu"))))
}

/// Gives a command its own runtime directory, so that emulators of the user and of tests do not interfere.
fn isolated(mut command: Command) -> Command {
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
/// If one of them cannot be built.
pub fn geu_obc() -> Command {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    isolated(Command::new(PROGRAM.get_or_init(|| {
        program("geu");
        program("geu-obc")
    })))
}

/// The program of a package of the same name.
///
/// `cargo test` at the root builds it. `cargo test -p geu-tests` alone does not: it uses the existing one, and
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

/// Lowers the priority of a test that computes, with the threads and programs that it starts: a test of timing beside it goes first.
pub fn give_way() {
    // SAFETY: uses no memory; on Linux process 0 is the calling thread.
    unsafe { setpriority(PRIO_PROCESS, 0, 10) };
}

/// Says that the test of this thread could not run, and why: one line `skipped: TEST: REASON` that `.ci/count` counts.
///
/// The harness of cargo calls such a test `ok`: it knows no test that finds out while it runs that it cannot.
pub fn skipped(reason: &str) {
    let test = std::thread::current().name().unwrap_or("a test").to_owned();
    // Not eprintln!, which the test harness keeps to itself when a test passes; in one write, so that no other line comes between.
    let _ = std::io::stderr().write_all(format!("skipped: {test}: {reason}\n").as_bytes());
}

/// A directory of the recordings that others made, `..` of the workspace's `shared/recordings` or what `GEU_RECORDINGS` names; where it
/// is not there, this says that the test is skipped.
pub fn recordings(part: &str) -> Option<PathBuf> {
    let all = std::env::var_os("GEU_RECORDINGS").map_or_else(|| root().join("../shared/recordings"), PathBuf::from);
    let directory = all.join(part);
    if directory.exists() {
        return Some(directory);
    }
    skipped(&format!("{} is not there; GEU_RECORDINGS names another directory of recordings", directory.display()));
    None
}
