//! `geu bench decode`: how fast recordings are decoded, on one core, beside other tools on the same file.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use clap::Args;
use geu_protocol::serial::data_frame;
use geu_protocol::{CLOCK_PER_HALF_SECOND, CanPlan, HalfSecond};
use geu_recording::{Defect, InputReader, Options, Row, Sink, Stop};

use crate::failure::{Failure, say};
use crate::rows::{Flags, Form, write_row};

/// Arguments of `geu bench decode`.
#[derive(Args)]
pub struct Arguments {
    /// Lines of the candump log.
    #[arg(long, value_name = "N", default_value_t = 1_000_000)]
    lines: u64,
    /// Runs of each of our own measurements; the fastest counts.
    #[arg(long, value_name = "N", default_value_t = 5)]
    runs: u32,
    /// CAN database for cantools.
    #[arg(long, value_name = "FILE", default_value = "protocol/geu.dbc")]
    dbc: PathBuf,
    /// Leave out the other tools.
    #[arg(long)]
    alone: bool,
}

const MEGABYTE: f64 = 1e6;

/// Measures and prints.
pub fn run(arguments: Arguments) -> Result<(), Failure> {
    if arguments.lines < 3 {
        return Err(Failure::input(format!("--lines: expected at least 3, got {}", arguments.lines)));
    }
    let directory = tempfile::tempdir().map_err(|error| Failure::failed(format!("temporary directory: {error}")))?;
    let (log, bin) = (directory.path().join("bench.log"), directory.path().join("bench.bin"));
    write_inputs(&log, &bin, arguments.lines)
        .map_err(|error| Failure::failed(format!("{}: {error}", directory.path().display())))?;
    let bytes = |path: &Path| fs::metadata(path).map_or(0, |metadata| metadata.len()) as f64;
    let lines = arguments.lines as f64;
    say!(
        "{} lines of candump log, {:.0} MB; one core, fastest of {} runs",
        lines,
        bytes(&log) / MEGABYTE,
        arguments.runs
    )?;
    say!("{:<36} {:>9} {:>16} {:>12}", "", "time_s", "throughput", "target")?;

    let fastest = |path: &Path, write: bool| -> Result<(f64, u64), Failure> {
        let mut best = (f64::INFINITY, 0);
        for _ in 0..arguments.runs.max(1) {
            let (time_s, rows) = decode(path, write)?;
            best = (best.0.min(time_s), rows);
        }
        Ok(best)
    };
    let (reading_s, _) = fastest(&log, false)?;
    report("candump log, no output", reading_s, lines / reading_s / 1e6, "M lines/s", 8.0)?;
    let (csv_s, rows) = fastest(&log, true)?;
    report("candump log to CSV", csv_s, rows as f64 / csv_s / 1e6, "M rows/s", 2.0)?;
    let (serial_s, _) = fastest(&bin, false)?;
    report("raw serial, no output", serial_s, bytes(&bin) / serial_s / MEGABYTE, "MB/s", 500.0)?;
    if !arguments.alone {
        say!()?;
        others(&log, &arguments.dbc, lines, reading_s, csv_s)?;
    }
    Ok(())
}

fn report(name: &str, time_s: f64, throughput: f64, unit: &str, target: f64) -> Result<(), Failure> {
    let verdict = if throughput >= target { "met" } else { "MISSED" };
    say!("{name:<36} {time_s:>9.4} {throughput:>7.1} {unit:<9} {target:>5} {verdict}")
}

/// A log of half seconds as the unit sends them, and the same half seconds as serial frames.
fn write_inputs(log: &Path, bin: &Path, lines: u64) -> io::Result<()> {
    let (mut log, mut bin) = (BufWriter::new(File::create(log)?), BufWriter::new(File::create(bin)?));
    let plan = CanPlan::default();
    let mut line = 0;
    for index in 0u64.. {
        let rate = |phase: u64| ((index * 7 + phase * 1_013) % 4_001) as i16 - 2_000;
        let half_second = HalfSecond {
            sequence: index as u16,
            increments: [rate(0), rate(1), rate(2), rate(3)],
            gyro_flags: 0x0F,
            unit_flags: 0x07,
            electronics_centi_c: 2_000 + (index / 50 % 200) as i16,
            clock_count: (index + 1) * CLOCK_PER_HALF_SECOND,
            sensor_centi_c: 7_000,
        };
        bin.write_all(&data_frame(&half_second))?;
        for (offset_us, frame) in [900, 1_150, 1_400].into_iter().zip(plan.frames(&half_second)) {
            if line == lines {
                log.flush()?;
                return bin.flush();
            }
            let t_us = 1_795_020_000_500_000 + index * 500_000 + offset_us;
            write!(log, "({}.{:06}) can0 {:03X}#", t_us / 1_000_000, t_us % 1_000_000, frame.id())?;
            for byte in frame.data() {
                write!(log, "{byte:02X}")?;
            }
            log.write_all(b"\n")?;
            line += 1;
        }
    }
    Ok(())
}

/// Counts rows, and writes them as CSV to where nothing is kept.
struct Counter {
    rows: u64,
    out: Option<(File, Vec<u8>)>,
}

impl Sink for Counter {
    #[inline]
    fn row(&mut self, row: &Row) {
        self.rows += 1;
        if let Some((file, buffer)) = &mut self.out {
            write_row(Form::Csv, Flags::Integers, row, buffer);
            if buffer.len() > 1 << 18 {
                let _ = file.write_all(buffer);
                buffer.clear();
            }
        }
    }

    fn defect(&mut self, _defect: &Defect) {}
}

fn decode(path: &Path, write: bool) -> Result<(f64, u64), Failure> {
    let failed = |error: io::Error| Failure::failed(format!("/dev/null: {error}"));
    let out = write.then(|| File::create("/dev/null")).transpose().map_err(failed)?;
    let mut counter = Counter { rows: 0, out: out.map(|file| (file, Vec::new())) };
    let start = Instant::now();
    let mut reader = InputReader::new(Options::default(), Stop::default());
    let result = reader.read(&path.to_string_lossy(), &mut counter);
    let (_summary, ending) = reader.finish(&mut counter);
    let time_s = start.elapsed().as_secs_f64();
    result.and(ending).map_err(Failure::failed)?;
    Ok((time_s, counter.rows))
}

const PYTHON_CAN: &str = "
import can, sys
for message in can.CanutilsLogReader(sys.argv[1]):
    pass
";
const CANTOOLS: &str = "
import can, cantools, sys
database = cantools.database.load_file(sys.argv[2])
for message in can.CanutilsLogReader(sys.argv[1]):
    database.decode_message(message.arbitration_id, message.data)
";

fn others(log: &Path, dbc: &Path, lines: f64, reading_s: f64, csv_s: f64) -> Result<(), Failure> {
    say!("other tools, started once each, their own start included")?;
    let file = log.as_os_str();
    if python_has("can") {
        compare(
            "python-can",
            Command::new("python3").arg("-c").arg(PYTHON_CAN).arg(file),
            lines,
            reading_s,
            "reading",
        )?;
    } else {
        say!("{:<36} skipped: python3 with python-can is not installed", "python-can")?;
    }
    let name = "python-can + cantools";
    if !(python_has("can") && python_has("cantools")) {
        say!("{name:<36} skipped: python3 with python-can and cantools is not installed")?;
    } else if !dbc.exists() {
        say!("{name:<36} skipped: {} does not exist here (--dbc names it)", dbc.display())?;
    } else {
        compare(name, Command::new("python3").arg("-c").arg(CANTOOLS).arg(file).arg(dbc), lines, csv_s, "to CSV")?;
    }
    compare("log2asc", Command::new("log2asc").arg("-I").arg(file).arg("can0"), lines, csv_s, "to CSV")
}

fn python_has(module: &str) -> bool {
    let mut command = Command::new("python3");
    command.args(["-c", &format!("import {module}")]).stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}

/// Runs another tool and says how many times longer it takes than ours.
fn compare(name: &str, command: &mut Command, lines: f64, our_time_s: f64, what: &str) -> Result<(), Failure> {
    let start = Instant::now();
    match command.stdout(Stdio::null()).stderr(Stdio::null()).status() {
        Ok(status) if status.success() => {
            let time_s = start.elapsed().as_secs_f64();
            let (rate, ratio) = (lines / time_s / 1e6, time_s / our_time_s);
            say!("{name:<36} {time_s:>9.3} {rate:>7.3} M lines/s; geu {what} is {ratio:.0} times as fast")
        }
        Ok(status) => say!("{name:<36} skipped: it ended with {status}"),
        Err(error) => say!("{name:<36} skipped: it cannot be started: {error}"),
    }
}
