//! `geu bench cadence`: how late samples leave, and how long they are.
//!
//! Three threads keep the same period side by side, a third of it apart, so that each meets the same machine: our
//! cadence, our cadence with a final spin, and the timer of an asynchronous runtime. Beside them runs the emulator
//! itself, for its lateness, memory and CPU time; and where a CAN interface is given, the emulator and `cangen` on it,
//! measured by the time stamps of reception.

use std::fs;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use geu_daemon::cadence::{DeadlineTimer, now_ns};
use geu_daemon::lateness::{DurationNs, Histogram};
use geu_model::units::SAMPLE_INTERVAL_NS;
use geu_process::EmulatorProcess;
use geu_protocol::CanIdMap;
use socketcan::{CanFilter, CanSocket, EmbeddedFrame, Id, Socket, SocketOptions};

use crate::failure::{CommandError, say};
use crate::settings::duration;

/// Final spin of the second arm unless told.
const SPIN_US: u32 = 200;
/// Identifier that `cangen` is told to send, away from the unit's.
const CANGEN_ID: u16 = 0x123;

/// Arguments of `geu bench cadence`.
#[derive(Args)]
pub struct Arguments {
    /// How long it is measured
    #[arg(long, value_name = "DURATION", default_value = "10m", value_parser = duration(2.0, 86_400.0))]
    duration: f64,
    /// Final spin of the arm that spins, µs
    #[arg(long, value_name = "MICROSECONDS", default_value_t = SPIN_US)]
    spin: u32,
    /// CAN interface on which the emulator is measured beside `cangen -g 500`
    #[arg(long, value_name = "INTERFACE")]
    can: Option<String>,
}

/// Measures.
///
/// # Errors
/// An emulator that does not start, an interface that cannot be opened.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let sends = (arguments.duration * 1e9 / SAMPLE_INTERVAL_NS as f64) as i64;
    let on_bus = arguments.can.as_ref().map(|interface| Bus::start(interface, arguments.duration)).transpose()?;
    let emulator = Emulator::start(arguments.can.as_deref(), arguments.duration)?;

    let start_ns = now_ns() + SAMPLE_INTERVAL_NS;
    let spin = Duration::from_micros(arguments.spin.into());
    let arm = |third: i64, spin: Duration| {
        let first_ns = start_ns + third * SAMPLE_INTERVAL_NS / 3;
        thread::spawn(move || {
            let sleeper = DeadlineTimer::new(spin);
            let deadlines = (0..sends).map(|index| first_ns + index * SAMPLE_INTERVAL_NS);
            deadlines
                .map(|deadline_ns| (sleeper.sleep_until(deadline_ns), now_ns() - deadline_ns).1)
                .collect::<Vec<_>>()
        })
    };
    let (plain, spinning) = (arm(0, Duration::ZERO), arm(1, spin));
    let runtime = thread::spawn(move || tokio_interval(start_ns + 2 * SAMPLE_INTERVAL_NS / 3, sends));

    let mut memory_kb = 0;
    while !plain.is_finished() {
        thread::sleep(Duration::from_millis(500));
        memory_kb = emulator.memory_kb().max(memory_kb);
    }
    let cpu_share = emulator.cpu_share();
    let [plain, spinning, runtime] = [plain, spinning, runtime].map(|arm| arm.join().expect("an arm does not panic"));
    let said = emulator.end();

    say!("{sends} samples each, side by side")?;
    for (name, late_ns) in
        [("sleep", &plain), (&*format!("sleep, spin {} µs", arguments.spin), &spinning), ("tokio interval", &runtime)]
    {
        let mut histogram = Histogram::default();
        late_ns.iter().for_each(|&ns| histogram.record(ns));
        say!("  {name:<22} {histogram}")?;
    }
    let median = |late_ns: &[i64]| {
        let mut sorted = late_ns.to_vec();
        sorted.sort_unstable();
        sorted[sorted.len() / 2].max(1)
    };
    say!(
        "  median against tokio's  {:.1} times less late; with spin {:.0} times",
        median(&runtime) as f64 / median(&plain) as f64,
        median(&runtime) as f64 / median(&spinning) as f64
    )?;
    for (name, late_ns) in [("sleep", &plain), ("sleep with spin", &spinning), ("tokio interval", &runtime)] {
        let times_ns: Vec<f64> = late_ns.iter().map(|&late_ns| late_ns as f64).collect();
        let (ppm, sigma) = slope_ppm(&times_ns);
        say!("  period, {name:<15} {ppm:+.4} ± {sigma:.4} ppm of the deadlines'")?;
    }
    say!("geu run{}", arguments.can.as_ref().map_or(String::new(), |interface| format!(" --can {interface}")))?;
    say!("  memory {:.1} MB, CPU {:.2} % of one core", f64::from(memory_kb) / 1024.0, 100.0 * cpu_share)?;
    for line in said.lines().filter(|line| !line.trim().is_empty()) {
        say!("  {line}")?;
    }
    if let Some(bus) = on_bus {
        bus.report()?;
    }
    Ok(())
}

/// Lateness of tokio's own timer at the same deadlines, ns.
fn tokio_interval(first_ns: i64, sends: i64) -> Vec<i64> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().expect("a runtime");
    runtime.block_on(async {
        let to_first = Duration::from_nanos((first_ns - now_ns()).max(0) as u64);
        let first = tokio::time::Instant::now() + to_first;
        let mut interval = tokio::time::interval_at(first, Duration::from_nanos(SAMPLE_INTERVAL_NS as u64));
        let mut late_ns = Vec::with_capacity(sends as usize);
        for index in 0..sends {
            interval.tick().await;
            late_ns.push(now_ns() - first_ns - index * SAMPLE_INTERVAL_NS);
        }
        late_ns
    })
}

/// Slope of a straight line through `residual_ns`, one per period, in ppm of the period, and its standard deviation.
fn slope_ppm(residual_ns: &[f64]) -> (f64, f64) {
    let count = residual_ns.len() as f64;
    let mean_index = (count - 1.0) / 2.0;
    let mean_ns = residual_ns.iter().sum::<f64>() / count;
    let (mut covariance, mut spread) = (0.0, 0.0);
    for (index, &ns) in residual_ns.iter().enumerate() {
        let from_mean = index as f64 - mean_index;
        covariance += from_mean * (ns - mean_ns);
        spread += from_mean * from_mean;
    }
    let slope = covariance / spread;
    let left: f64 = residual_ns
        .iter()
        .enumerate()
        .map(|(index, &ns)| (ns - mean_ns - slope * (index as f64 - mean_index)).powi(2))
        .sum();
    let sigma = (left / (count - 2.0).max(1.0) / spread).sqrt();
    (slope / SAMPLE_INTERVAL_NS as f64 * 1e6, sigma / SAMPLE_INTERVAL_NS as f64 * 1e6)
}

/// The emulator as a process of its own.
struct Emulator {
    process: EmulatorProcess,
    started: Instant,
    /// Of the symlink.
    _directory: tempfile::TempDir,
}

impl Emulator {
    fn start(can: Option<&str>, duration_s: f64) -> Result<Emulator, CommandError> {
        let mut command = Command::new(std::env::current_exe().map_err(CommandError::failed)?);
        command.arg("run").args(["--duration", &(duration_s + 60.0).to_string()]);
        let directory = tempfile::tempdir().map_err(CommandError::failed)?;
        match can {
            Some(interface) => command.args(["--can", interface]),
            None => command.arg("--pty").arg(directory.path().join("geu0")),
        };
        let process = EmulatorProcess::start(command).map_err(CommandError::failed)?;
        Ok(Emulator { process, started: Instant::now(), _directory: directory })
    }

    fn of_proc(&self, file: &str) -> String {
        fs::read_to_string(format!("/proc/{}/{file}", self.process.child.id())).unwrap_or_default()
    }

    fn memory_kb(&self) -> u32 {
        let status = self.of_proc("status");
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        line.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok()).unwrap_or(0)
    }

    /// CPU time of all its threads against the wall clock.
    fn cpu_share(&self) -> f64 {
        let threads = fs::read_dir(format!("/proc/{}/task", self.process.child.id())).into_iter().flatten().flatten();
        let on_cpu_ns: f64 = threads
            .filter_map(|thread| fs::read_to_string(thread.path().join("schedstat")).ok())
            .filter_map(|stat| stat.split_whitespace().next()?.parse::<f64>().ok())
            .sum();
        on_cpu_ns * 1e-9 / self.started.elapsed().as_secs_f64()
    }

    /// Asks it to end and gives what it wrote on standard error.
    fn end(self) -> String {
        let _ = self.process.terminate();
        self.process.wait().map(|(_, text)| text).unwrap_or_default()
    }
}

/// The emulator's INCREMENTS and the frames of `cangen -g 500`, by their time stamps of reception.
struct Bus(thread::JoinHandle<[Vec<f64>; 2]>);

impl Bus {
    fn start(interface: &str, duration_s: f64) -> Result<Bus, CommandError> {
        let fail = |error| CommandError::input(format!("--can {interface}: {error}"));
        let socket = CanSocket::open(interface).map_err(fail)?;
        let ids = [CanIdMap::default().base(), CANGEN_ID];
        socket.set_filters(&ids.map(|id| CanFilter::new(id.into(), 0x7FF))).map_err(fail)?;
        socket.set_recv_timestamp(true).map_err(fail)?;
        socket.set_read_timeout(Duration::from_secs(1)).map_err(fail)?;
        let mut cangen = Command::new("cangen")
            .args([interface, "-g", "500", "-I", &format!("{CANGEN_ID:X}"), "-L", "8"])
            .stdin(Stdio::null())
            .spawn()
            .map_err(|error| CommandError::failed(format!("cangen: {error}; expected Debian's can-utils")))?;
        let until = Instant::now() + Duration::from_secs_f64(duration_s);
        Ok(Bus(thread::spawn(move || {
            let mut stamps_ns = [Vec::new(), Vec::new()];
            while Instant::now() < until {
                let Ok((frame, stamp)) = socket.read_frame_with_timestamp() else { continue };
                let since = stamp.duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
                if let Id::Standard(id) = frame.id()
                    && let Some(which) = ids.iter().position(|&wanted| wanted == id.as_raw())
                {
                    stamps_ns[which].push(since.as_nanos() as f64);
                }
            }
            let _ = cangen.kill();
            let _ = cangen.wait();
            stamps_ns
        })))
    }

    fn report(self) -> Result<(), CommandError> {
        let stamps_ns = self.0.join().expect("the receiver does not panic");
        say!("by reception on the bus")?;
        for (name, stamps_ns) in ["geu run", "cangen -g 500"].iter().zip(&stamps_ns) {
            if stamps_ns.len() < 3 {
                say!("  {name:<22} {} frames: too few", stamps_ns.len())?;
                continue;
            }
            let first_ns = stamps_ns[0];
            let residual_ns: Vec<f64> = (0..)
                .zip(stamps_ns)
                .map(|(index, ns)| ns - first_ns - f64::from(index) * SAMPLE_INTERVAL_NS as f64)
                .collect();
            let (ppm, sigma) = slope_ppm(&residual_ns);
            let least = |all: &[f64]| all.iter().copied().fold(f64::INFINITY, f64::min);
            let mut histogram = Histogram::default();
            let intervals_ns: Vec<f64> =
                stamps_ns.windows(2).map(|pair| pair[1] - pair[0] - SAMPLE_INTERVAL_NS as f64).collect();
            intervals_ns.iter().for_each(|ns| histogram.record(ns.abs() as i64));
            say!("  {name:<22} interval off by {histogram}")?;
            say!("  {:<22} period {ppm:+.4} ± {sigma:.4} ppm, behind by {} at the end", "", {
                let behind_ns = residual_ns[residual_ns.len() - 1] - least(&residual_ns);
                DurationNs(behind_ns.max(0.0) as u64)
            })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_of_a_straight_line_is_found_and_its_sigma_is_that_of_the_noise() {
        let line: Vec<f64> = (0..1200).map(|index| 7.0 + 50.0 * f64::from(index)).collect();
        let (ppm, sigma) = slope_ppm(&line);
        assert!((ppm - 0.1).abs() < 1e-9 && sigma < 1e-9, "{ppm} {sigma}");
        // 100 ns of alternating noise: sigma is 100 ns / (period × sqrt(n³/12)) by the textbook.
        let noise: Vec<f64> = (0..1200).map(|index| if index % 2 == 0 { 100.0 } else { -100.0 }).collect();
        let expected = 100.0 / (1200f64.powi(3) / 12.0).sqrt() / 5e8 * 1e6;
        assert!((slope_ppm(&noise).1 / expected - 1.0).abs() < 0.01);
    }
}
