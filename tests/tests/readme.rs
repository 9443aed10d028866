//! Each command of the README runs as printed, in its own directory.
//!
//! A command that is new in the README is run here without further ado; what cannot run says why in `SKIPPED`.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use flate2::Compression;
use flate2::write::GzEncoder;
use geu_tests::{geu, geu_obc, root};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

/// Commands that are not run, by their beginning, and why.
const SKIPPED: [(&str, &str); 15] = [
    ("geu decode 127.0.0.1:4700", "needs the address of an emulator; decode_live.rs has one"),
    ("cargo ", "this test is part of `cargo test`, and `.ci/run` builds the release"),
    ("tio ", "is another program; pySerial reads the pty in tests/clients"),
    ("geu run --can", "needs a CAN interface; tests/vcan has one"),
    ("candump ", "needs a CAN interface; tests/vcan has one"),
    ("cansend ", "needs a CAN interface; tests/vcan has one"),
    ("geu replay day/link.log --can", "needs a CAN interface; tests/vcan has one"),
    ("geu replay trace.pcap --base 300 --can", "needs a CAN interface; tests/vcan has one"),
    ("geu diagnose --device suchai3", "needs telemetry of another gyro; tests/diagnose_magnitudes.rs has some"),
    // Each of these is minutes of computing in the test profile.
    ("geu checkout --precautions", "takes too long; tools/calibration/tests/checkout.rs does it"),
    ("geu checkout --runs", "takes too long; tools/calibration/tests/checkout.rs does it"),
    ("geu diagnose --link run5", "takes too long; tests/diagnose_page.rs does it"),
    ("geu diagnose --config trial", "takes too long; tests/diagnose_page.rs does it"),
    ("geu blind score", "needs the diagnosis that takes too long; tools/geu/tests/blind.rs does it"),
    ("geu selftest", "takes too long; tools/selftest/tests/selftest.rs does it"),
];
/// Replacements that make commands short and independent of other programs.
const INSTEAD: [(&str, &str); 6] = [
    ("/tmp/geu0", "pty0"),
    ("--record run1 --duration 60", "--record run1 --duration 5"),
    ("127.0.0.1:4701", "127.0.0.1:0"),
    ("127.0.0.1:4700", "127.0.0.1:0"),
    ("--duration 86400", "--duration 7200"),
    // A whole minute in real time otherwise.
    ("geu-obc \n", "geu-obc --speed max\n"),
];
/// Commands that go on until they are ended, by their beginning.
const LIVE: [&str; 7] = [
    "geu run --pty pty0 ",
    "geu run --truth udp:",
    "geu decode pty0 ",
    "geu track pty0 ",
    "geu replay candump",
    "geu replay raw.bin",
    "geu run --pty pty0 --set",
];
/// Time after which a live command must still run, or have succeeded.
const LIVES: Duration = Duration::from_millis(1500);
/// A command takes a second or two; on a loaded machine a build beside it may take all the rest.
const TIMEOUT: Duration = Duration::from_secs(120);

/// The commands of the indented blocks, a line each, without what is said behind `#`.
fn commands(text: &str) -> Vec<String> {
    let joined = text.replace("\\\n", " ");
    let indented = joined.lines().filter_map(|line| line.strip_prefix("    "));
    let first = ["cargo", "geu", "geu-obc", "tio", "candump", "cansend"];
    let is_command = |line: &&str| first.contains(&line.split_whitespace().next().unwrap_or_default());
    indented.filter(is_command).map(|line| line.split(" #").next().unwrap_or(line).trim().to_owned()).collect()
}

/// Creates the recordings that the README assumes.
fn give(directory: &Path) {
    symlink(root().join("configs"), directory.join("configs")).expect("a link");
    for (capture, name) in [
        ("encoded.log", "candump-2026-07-01.log"),
        ("encoded.pcapng", "trace.pcapng"),
        ("encoded-python-can.asc", "bench.asc"),
    ] {
        fs::copy(root().join("tests/captures").join(capture), directory.join(name)).expect("copied");
    }
    let mut simulate = geu();
    simulate.current_dir(directory).args(["simulate", "--duration", "60", "--wire", "serial", "--out", "raw"]);
    assert!(simulate.output().expect("geu starts").status.success());
    fs::copy(directory.join("raw/link.bin"), directory.join("raw.bin")).expect("copied");
    let gz = fs::File::create(directory.join("raw.bin.gz")).expect("a file");
    let mut gz = GzEncoder::new(gz, Compression::fast());
    std::io::copy(&mut fs::File::open(directory.join("raw.bin")).expect("a file"), &mut gz).expect("packed");
    gz.finish().expect("packed");
    fs::copy(directory.join("raw/reference.csv"), directory.join("attitude.aem")).expect("copied");
    let telemetry = "timestamp_s,gyro_x_lsb,gyro_y_lsb,gyro_z_lsb\n1000,-1456,0,1\n1001,-1455,0,1\n";
    fs::write(directory.join("telemetry.csv"), telemetry).expect("written");
}

/// A running command, ended on drop.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A shell's process for a command, as a user has it.
fn start(directory: &Path, command: &str, path: &str) -> Running {
    let error = fs::File::create(directory.join("stderr")).expect("a file");
    let mut shell = Command::new("sh");
    shell.args(["-c", &format!("exec {command}")]).current_dir(directory);
    shell.env("PATH", path).env("XDG_RUNTIME_DIR", directory).env("XDG_CACHE_HOME", directory.join("cache"));
    shell.env_remove("GEU_CONTROL_TOKEN").stdin(Stdio::null()).stdout(Stdio::null()).stderr(error);
    Running(shell.spawn().expect("sh starts"))
}

/// Waits for the end; returns the exit code, or `None` after the time `within`.
fn ended(child: &mut Running, within: Duration) -> Option<i32> {
    let start = Instant::now();
    loop {
        if let Some(status) = child.0.try_wait().expect("a process") {
            return Some(status.code().unwrap_or(-1));
        }
        if start.elapsed() > within {
            return None;
        }
        sleep(Duration::from_millis(20));
    }
}

fn end(mut child: Running) {
    // It may have ended by itself.
    let _ = kill(Pid::from_raw(child.0.id() as i32), Signal::SIGTERM);
    assert!(ended(&mut child, TIMEOUT).is_some(), "a process that does not end");
}

#[test]
fn every_command_of_the_readme_runs() {
    let directory = tempfile::tempdir().expect("a directory");
    let directory = directory.path();
    give(directory);
    let program = geu_obc().get_program().to_owned();
    let programs = Path::new(&program).parent().expect("a directory").display();
    let path = format!("{programs}:{}", std::env::var("PATH").unwrap_or_default());
    let all = commands(&fs::read_to_string(root().join("README.md")).expect("a README"));
    assert!(all.len() > 45, "{all:?}");
    // The unit of `geu run --pty`, which the commands after it speak with.
    let mut unit: Option<Running> = None;
    for (begin, _) in SKIPPED {
        assert!(all.iter().any(|command| command.starts_with(begin)), "{begin:?} is not in the README");
    }
    for shown in all.iter().filter(|shown| !SKIPPED.iter().any(|(begin, _)| shown.starts_with(begin))) {
        let command = INSTEAD.iter().fold(format!("{shown} \n"), |text, (from, to)| text.replace(from, to));
        let said = || fs::read_to_string(directory.join("stderr")).unwrap_or_default();
        let began = Instant::now();
        let is_unit = command.starts_with("geu run --pty") || command.starts_with("geu replay candump");
        if let Some(unit) = unit.take_if(|_| is_unit) {
            end(unit);
        }
        if (command.starts_with("geu inject") || command.starts_with("geu send")) && unit.is_none() {
            unit = Some(start(directory, "geu run --pty pty0", &path));
            sleep(LIVES);
        }
        let mut child = start(directory, &command, &path);
        if LIVE.iter().any(|begin| command.starts_with(begin)) && !command.contains("--duration") {
            let code = ended(&mut child, LIVES);
            assert!(matches!(code, None | Some(0)), "{shown}: exit {code:?}: {}", said());
            if is_unit { unit = Some(child) } else { end(child) }
        } else {
            let code = ended(&mut child, TIMEOUT);
            assert_eq!(code, Some(0), "{shown}: {}", said());
        }
        println!("{:6.1} s  {shown}", began.elapsed().as_secs_f64());
    }
    unit.into_iter().for_each(end);
    assert!(
        fs::metadata(directory.join("run4/faults.jsonl")).is_ok_and(|file| file.len() > 0),
        "no faults were logged"
    );
}
