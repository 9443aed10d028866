//! Child processes of benchmarks: the emulator, scripts, and their time and memory.

use std::fs;
use std::io;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use geu_process::EmulatorProcess;
use nix::sys::prctl::set_pdeathsig;
use nix::sys::resource::{UsageWho, getrusage};
use nix::sys::signal::Signal;
use nix::sys::time::TimeValLike;

use crate::Result;

/// The program `geu` beside this one.
///
/// # Errors
/// It is not built.
pub fn geu() -> Result<Command> {
    let path = std::env::current_exe()?.with_file_name("geu");
    match path.is_file() {
        true => Ok(Command::new(path)),
        false => {
            Err(format!("{}: expected the program geu; build it with `cargo build --release`", path.display()).into())
        }
    }
}

/// `geu run` as a process.
pub struct Emulator {
    pub process: EmulatorProcess,
    started: Instant,
    /// Directory of the pty's symlink.
    _directory: tempfile::TempDir,
}

impl Emulator {
    /// Starts `geu run` with these arguments, on a pty unless a CAN interface is given.
    ///
    /// # Errors
    /// The process does not start.
    pub fn start(can: Option<&str>, arguments: &[&str]) -> Result<Emulator> {
        let directory = tempfile::tempdir()?;
        let mut command = geu()?;
        command.arg("run").args(arguments);
        match can {
            Some(interface) => command.args(["--can", interface]),
            None => command.arg("--pty").arg(directory.path().join("geu0")),
        };
        let process = EmulatorProcess::start(command)?;
        Ok(Emulator { process, started: Instant::now(), _directory: directory })
    }

    pub fn memory_mb(&self) -> f64 {
        status_mb(&self.process.child.id().to_string(), "VmRSS").unwrap_or(0.0)
    }

    /// CPU time of all threads divided by the wall clock time.
    pub fn cpu_share(&self) -> f64 {
        let threads = fs::read_dir(format!("/proc/{}/task", self.process.child.id())).into_iter().flatten().flatten();
        let on_cpu_ns: f64 = threads
            .filter_map(|thread| fs::read_to_string(thread.path().join("schedstat")).ok())
            .filter_map(|stat| stat.split_whitespace().next()?.parse::<f64>().ok())
            .sum();
        on_cpu_ns * 1e-9 / self.started.elapsed().as_secs_f64()
    }

    /// Terminates the process and returns its standard error.
    pub fn end(self) -> String {
        let _ = self.process.terminate();
        self.process.wait().map(|(_, text)| text).unwrap_or_default()
    }
}

/// A memory figure of `/proc/PROCESS/status`, MB.
pub fn status_mb(process: &str, key: &str) -> Option<f64> {
    let status = fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(':'))?;
    line.trim().trim_end_matches(" kB").parse::<f64>().ok().map(|kb| kb / 1024.0)
}

/// A finished process.
pub struct Finished {
    pub time_s: f64,
    pub cpu_s: f64,
    pub peak_mb: f64,
    pub output: Output,
}

impl Finished {
    /// Standard output.
    ///
    /// # Errors
    /// The process failed: the last line of its standard error.
    pub fn text(&self) -> Result<String, String> {
        match self.output.status.success() {
            true => Ok(String::from_utf8_lossy(&self.output.stdout).into_owned()),
            false => Err(String::from_utf8_lossy(&self.output.stderr).lines().last().unwrap_or("no output").to_owned()),
        }
    }
}

/// Interval at which a child's memory is read.
const POLL_INTERVAL: Duration = Duration::from_millis(1);

/// Runs a command to its end, or to that of this program. Its output must be short, and is thrown away unless piped.
///
/// # Errors
/// The command cannot be started.
pub fn finish(command: &mut Command, stdout: Stdio) -> Result<Finished, String> {
    let (start, cpu_before_s) = (Instant::now(), children_cpu_s());
    let failed = |error| format!("it cannot be started: {error}");
    // SAFETY: between fork and exec this makes one system call and touches no memory.
    unsafe { command.pre_exec(|| set_pdeathsig(Signal::SIGTERM).map_err(io::Error::from)) };
    let mut child = command.stdin(Stdio::null()).stdout(stdout).stderr(Stdio::piped()).spawn().map_err(failed)?;
    let (id, mut peak_mb) = (child.id().to_string(), 0.0f64);
    while child.try_wait().map_err(|error| error.to_string())?.is_none() {
        peak_mb = peak_mb.max(status_mb(&id, "VmHWM").unwrap_or(0.0));
        std::thread::sleep(POLL_INTERVAL);
    }
    let time_s = start.elapsed().as_secs_f64();
    Ok(Finished {
        time_s,
        cpu_s: children_cpu_s() - cpu_before_s,
        peak_mb,
        output: child.wait_with_output().map_err(|error| error.to_string())?,
    })
}

/// CPU time of all children that have ended.
fn children_cpu_s() -> f64 {
    let usage = getrusage(UsageWho::RUSAGE_CHILDREN).map(|usage| usage.user_time() + usage.system_time());
    usage.map_or(0.0, |time| time.num_microseconds() as f64 * 1e-6)
}

/// Standard output of a Python script.
///
/// # Errors
/// Python cannot be started, or fails.
pub fn python_text(script: &str) -> Result<String, String> {
    finish(Command::new("python3").args(["-c", script]), Stdio::piped())?.text()
}

/// Runs this program again on one thread, unless it does, so that it measures one core.
///
/// # Errors
/// It cannot be started.
pub fn on_one_thread() -> Result {
    const THREADS: &str = "RAYON_NUM_THREADS";
    if std::env::var_os(THREADS).is_some_and(|threads| threads == "1") {
        return Ok(());
    }
    let mut command = Command::new(std::env::current_exe()?);
    Err(command.args(std::env::args_os().skip(1)).env(THREADS, "1").exec().into())
}

/// Runs a Python script with arguments.
///
/// # Errors
/// Python cannot be started.
pub fn python(directory: &Path, script: &str, arguments: &[&str]) -> Result<Finished, String> {
    let file = directory.join("bench.py");
    fs::write(&file, script).map_err(|error| error.to_string())?;
    finish(Command::new("python3").arg(&file).args(arguments), Stdio::piped())
        .map_err(|error| format!("python3: {error}"))
}
