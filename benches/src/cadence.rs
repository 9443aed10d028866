//! `geu-bench cadence`: lateness and period of samples.
//!
//! Three threads and python-can's periodic task run the same period on the same machine, shifted by a third of it: our cadence, our cadence with a
//! final spin, and the timer of an asynchronous runtime. The emulator runs beside them, for its lateness, memory and CPU
//! time. With a CAN interface, the emulator and `cangen` on it are measured by the time stamps of reception.

use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use geu_daemon::cadence::{DeadlineTimer, now_ns};
use geu_daemon::lateness::{DurationNs, Histogram};
use geu_model::units::{SAMPLE_INTERVAL_NS, duration_s};
use geu_protocol::CanIdMap;
use socketcan::{CanFilter, CanSocket, EmbeddedFrame, Id, Socket, SocketOptions};

use crate::Result;
use crate::process::{Emulator, python};
use crate::table::Table;

/// Default of `--spin`.
const SPIN_US: u32 = 200;
/// python-can's periodic task on its virtual bus.
const PYTHON_CAN: &str = include_str!("cadence.py");
/// Identifier of the frames of `cangen`, not used by the unit.
const CANGEN_ID: u16 = 0x123;

/// Arguments of `geu-bench cadence`.
#[derive(Args)]
pub struct Arguments {
    /// Time to measure
    #[arg(long, value_name = "DURATION", default_value = "10m", value_parser = |text: &str| duration_s(text, 2.0, 86_400.0))]
    duration: f64,
    /// Final spin of the spinning thread, µs
    #[arg(long, value_name = "MICROSECONDS", default_value_t = SPIN_US)]
    spin: u32,
    /// CAN interface for a measurement of the emulator beside `cangen -g 500`
    #[arg(long, value_name = "INTERFACE")]
    can: Option<String>,
}

/// Measures and prints.
///
/// # Errors
/// The emulator does not start, the interface cannot be opened.
pub fn run(arguments: &Arguments) -> Result {
    let sends = (arguments.duration * 1e9 / SAMPLE_INTERVAL_NS as f64) as i64;
    let on_bus = arguments.can.as_ref().map(|interface| Bus::start(interface, arguments.duration)).transpose()?;
    let run_s = (arguments.duration + 60.0).to_string();
    let emulator = Emulator::start(arguments.can.as_deref(), &["--duration", &run_s])?;

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
    let (period_s, length_s) = (SAMPLE_INTERVAL_NS as f64 * 1e-9, arguments.duration);
    let others = thread::spawn(move || python_can(length_s, period_s));
    let runtime = thread::spawn(move || tokio_interval(start_ns + 2 * SAMPLE_INTERVAL_NS / 3, sends));

    let mut memory_mb = 0.0f64;
    while !plain.is_finished() {
        thread::sleep(Duration::from_millis(500));
        memory_mb = memory_mb.max(emulator.memory_mb());
    }
    let cpu_share = emulator.cpu_share();
    let [plain, spinning, runtime] = [plain, spinning, runtime].map(|arm| arm.join().expect("no panic"));
    let stderr = emulator.end();

    println!("{sends} samples each, side by side");
    let python_can = others.join().expect("no panic");
    let columns =
        ["", "median", "p90", "p99", "period against the deadlines'", "median of tokio `interval` against it"];
    let mut table = Table::new("cadence", &columns);
    let at = |late_ns: &[i64], share: f64| {
        let mut sorted = late_ns.to_vec();
        sorted.sort_unstable();
        sorted[((sorted.len() as f64 * share) as usize).min(sorted.len() - 1)]
    };
    let spin = format!("with a final spin of {} µs", arguments.spin);
    let own: [(&str, Result<&Vec<i64>, String>); 4] = [
        ("absolute sleep", Ok(&plain)),
        (&spin, Ok(&spinning)),
        ("tokio `interval`", Ok(&runtime)),
        ("python-can's periodic task", python_can.as_ref().map_err(Clone::clone)),
    ];
    for (name, late_ns) in own {
        let late_ns = match late_ns {
            Ok(late_ns) => late_ns,
            Err(reason) => {
                table.row([name.to_owned(), format!("skipped: {reason}")]);
                continue;
            }
        };
        let times_ns: Vec<f64> = late_ns.iter().map(|&late_ns| late_ns as f64).collect();
        let (ppm, sigma) = slope_ppm(&times_ns);
        let quantiles = [0.5, 0.9, 0.99].map(|share| DurationNs(at(late_ns, share).max(0) as u64).to_string());
        let ratio = at(&runtime, 0.5).max(1) as f64 / at(late_ns, 0.5).max(1) as f64;
        let period = [format!("{ppm:+.2} ± {sigma:.2} ppm"), format!("{ratio:.1} times")];
        table.row([name.to_owned()].into_iter().chain(quantiles).chain(period));
    }
    if arguments.can.is_none() {
        table.row(["cangen".to_owned(), "skipped: --can names no interface".to_owned()]);
    }
    println!("{table}");
    println!("geu run{}", arguments.can.as_ref().map_or(String::new(), |interface| format!(" --can {interface}")));
    println!("  memory {memory_mb:.1} MB, CPU {:.2} % of one core", 100.0 * cpu_share);
    for line in stderr.lines().filter(|line| !line.trim().is_empty()) {
        println!("  {line}");
    }
    if let Some(bus) = on_bus {
        bus.report();
    }
    Ok(())
}

fn histogram(values_ns: impl Iterator<Item = i64>) -> Histogram {
    let mut histogram = Histogram::default();
    values_ns.for_each(|ns| histogram.record(ns));
    histogram
}

/// Lateness of tokio's timer at the same deadlines, ns.
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

/// Lateness of python-can's periodic task, ns.
fn python_can(duration_s: f64, period_s: f64) -> Result<Vec<i64>, String> {
    let directory = tempfile::tempdir().map_err(|error| error.to_string())?;
    let out = directory.path().join("late");
    let arguments = [duration_s.to_string(), period_s.to_string(), out.display().to_string()];
    python(directory.path(), PYTHON_CAN, &arguments.each_ref().map(String::as_str))?.text()?;
    let text = std::fs::read_to_string(&out).map_err(|error| error.to_string())?;
    let late_ns: Vec<i64> = text.lines().filter_map(|line| line.parse().ok()).collect();
    if late_ns.len() < 3 { Err("too few frames".to_owned()) } else { Ok(late_ns) }
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
    let squares: f64 = residual_ns
        .iter()
        .enumerate()
        .map(|(index, &ns)| (ns - mean_ns - slope * (index as f64 - mean_index)).powi(2))
        .sum();
    let sigma = (squares / (count - 2.0).max(1.0) / spread).sqrt();
    (slope / SAMPLE_INTERVAL_NS as f64 * 1e6, sigma / SAMPLE_INTERVAL_NS as f64 * 1e6)
}

/// The emulator's INCREMENTS and the frames of `cangen -g 500`, by their time stamps of reception.
struct Bus(thread::JoinHandle<[Vec<f64>; 2]>);

impl Bus {
    fn start(interface: &str, duration_s: f64) -> Result<Bus> {
        let fail = |error| format!("--can {interface}: {error}");
        let socket = CanSocket::open(interface).map_err(fail)?;
        let ids = [CanIdMap::default().base(), CANGEN_ID];
        socket.set_filters(&ids.map(|id| CanFilter::new(id.into(), 0x7FF))).map_err(fail)?;
        socket.set_recv_timestamp(true).map_err(fail)?;
        socket.set_read_timeout(Duration::from_secs(1)).map_err(fail)?;
        let mut cangen = Command::new("cangen")
            .args([interface, "-g", "500", "-I", &format!("{CANGEN_ID:X}"), "-L", "8"])
            .stdin(Stdio::null())
            .spawn()
            .map_err(|error| format!("cangen: {error}; expected Debian's can-utils"))?;
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

    fn report(self) {
        let stamps_ns = self.0.join().expect("no panic");
        println!("by reception on the bus");
        for (name, stamps_ns) in ["geu run", "cangen -g 500"].iter().zip(&stamps_ns) {
            if stamps_ns.len() < 3 {
                println!("  {name:<22} {} frames: too few", stamps_ns.len());
                continue;
            }
            let first_ns = stamps_ns[0];
            let residual_ns: Vec<f64> = (0..)
                .zip(stamps_ns)
                .map(|(index, ns)| ns - first_ns - f64::from(index) * SAMPLE_INTERVAL_NS as f64)
                .collect();
            let (ppm, sigma) = slope_ppm(&residual_ns);
            let min_ns = residual_ns.iter().copied().fold(f64::INFINITY, f64::min);
            let errors_ns = stamps_ns.windows(2).map(|pair| pair[1] - pair[0] - SAMPLE_INTERVAL_NS as f64);
            println!("  {name:<22} interval off by {}", histogram(errors_ns.map(|ns| ns.abs() as i64)));
            let behind = DurationNs((residual_ns[residual_ns.len() - 1] - min_ns).max(0.0) as u64);
            println!("  {:<22} period {ppm:+.4} ± {sigma:.4} ppm, behind by {behind} at the end", "");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slope_and_sigma_of_a_straight_line_are_found() {
        let line: Vec<f64> = (0..1200).map(|index| 7.0 + 50.0 * f64::from(index)).collect();
        let (ppm, sigma) = slope_ppm(&line);
        assert!((ppm - 0.1).abs() < 1e-9 && sigma < 1e-9, "{ppm} {sigma}");
        // 100 ns of alternating noise: sigma is 100 ns / (period × sqrt(n³/12)) by the textbook.
        let noise: Vec<f64> = (0..1200).map(|index| if index % 2 == 0 { 100.0 } else { -100.0 }).collect();
        let expected = 100.0 / (1200f64.powi(3) / 12.0).sqrt() / 5e8 * 1e6;
        assert!((slope_ppm(&noise).1 / expected - 1.0).abs() < 0.01);
    }
}
