//! `geu bench decode`: how fast recordings are decoded, on one core, beside other tools on the same file.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

use clap::Args;
use geu_protocol::serial::data_frame;
use geu_protocol::{CLOCK_PER_SAMPLE, CanIdMap, Sample, describe};
use geu_recording::{DecoderOptions, Defect, InputReader, ReceivedSample, Sink, Stop};
use geu_report::rows::{TextFormat, write_row};

use super::rounds::{Contender, Results, Rounds, Spread};
use crate::failure::{CommandError, say};

/// Arguments of `geu bench decode`.
#[derive(Args)]
pub struct Arguments {
    /// Lines of the candump log.
    #[arg(long, value_name = "N", default_value_t = 1_000_000)]
    lines: u64,
    #[command(flatten)]
    rounds: Rounds,
    /// Leave out the other tools.
    #[arg(long)]
    alone: bool,
}

const MEGABYTE: f64 = 1e6;

/// Measures and prints.
pub fn run(arguments: Arguments) -> Result<(), CommandError> {
    if arguments.lines < 3 {
        return Err(CommandError::input(format!("--lines: expected at least 3, got {}", arguments.lines)));
    }
    let directory =
        tempfile::tempdir().map_err(|error| CommandError::failed(format!("temporary directory: {error}")))?;
    let [log, bin, dbc] = ["bench.log", "bench.bin", "bench.dbc"].map(|name| directory.path().join(name));
    write_inputs(&log, &bin, arguments.lines)
        .map_err(|error| CommandError::failed(format!("{}: {error}", directory.path().display())))?;
    let bytes = |path: &Path| fs::metadata(path).map_or(0, |metadata| metadata.len()) as f64;
    let lines = arguments.lines as f64;
    say!("{lines} lines of candump log, {:.0} MB; time in s; {}", bytes(&log) / MEGABYTE, arguments.rounds)?;
    // Of our own the decoder alone, in this process: what it does in a second, and what is asked of it.
    let rows = decode(&log, false).map_err(CommandError::failed)?.1 as f64;
    let own = [
        ("candump log, no output", &log, false, (lines / 1e6, "M lines/s", 8.0)),
        ("candump log to CSV", &log, true, (rows / 1e6, "M rows/s", 2.0)),
        ("raw serial, no output", &bin, false, (bytes(&bin) / MEGABYTE, "MB/s", 500.0)),
    ];
    let mut contenders: Vec<Contender<f64>> = own
        .iter()
        .map(|&(name, path, write, _)| {
            let run = move || decode(path, write).map(|(time_s, _)| time_s);
            Contender::ours(name, run)
        })
        .collect();
    if !arguments.alone {
        fs::write(&dbc, describe::dbc(CanIdMap::default())).map_err(CommandError::failed)?;
        contenders.extend(processes(&log, &dbc)?);
    }
    let results = arguments.rounds.measure(contenders)?;
    for (Results { name, runs }, (.., (work, unit, target))) in results.iter().zip(own) {
        let throughput = Spread::of(runs.iter().flatten().map(|time_s| work / time_s));
        let verdict = if throughput.median >= target { "met" } else { "MISSED" };
        say!("{name:<32} {throughput:>24.1} {unit:<9} target {target}: {verdict}")?;
    }
    if results.len() > own.len() {
        say!("as processes, their own start included")?;
    }
    let of =
        |name: &str| results.iter().find(|result| result.name == name).and_then(|result| result.runs.as_ref().ok());
    for Results { name, runs } in &results[own.len()..] {
        // Who only reads is beside our summary, who writes or decodes beside our CSV.
        let beside = if name == "python-can" { GEU_SUMMARY } else { GEU_CSV };
        match (runs, of(beside)) {
            (Ok(runs), Some(ours)) if ![GEU_SUMMARY, GEU_CSV].contains(&name.as_str()) => {
                let (time_s, ratio) = (Spread::of(runs.iter().copied()), Spread::of_ratios(runs, ours));
                say!("{name:<32} {time_s:>24.3} s         {beside} is {ratio:.1} times as fast")?;
            }
            (Ok(runs), _) => say!("{name:<32} {:>24.3} s", Spread::of(runs.iter().copied()))?,
            (Err(reason), _) => say!("{name:<32} skipped: {reason}")?,
        }
    }
    Ok(())
}

/// A log of samples as the unit sends them, and the same samples as serial frames.
fn write_inputs(log: &Path, bin: &Path, lines: u64) -> io::Result<()> {
    let (mut log, mut bin) = (BufWriter::new(File::create(log)?), BufWriter::new(File::create(bin)?));
    let plan = CanIdMap::default();
    let mut line = 0;
    for index in 0u64.. {
        let rate = |phase: u64| ((index * 7 + phase * 1_013) % 4_001) as i16 - 2_000;
        let sample = Sample {
            sequence: index as u16,
            increments: [rate(0), rate(1), rate(2), rate(3)],
            gyro_flags: 0x0F,
            unit_flags: 0x07,
            electronics_centi_c: 2_000 + (index / 50 % 200) as i16,
            clock_count: (index + 1) * CLOCK_PER_SAMPLE,
            sensor_centi_c: 7_000,
        };
        bin.write_all(&data_frame(&sample))?;
        for (offset_us, frame) in [900, 1_150, 1_400].into_iter().zip(plan.frames(&sample)) {
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
    fn row(&mut self, row: &ReceivedSample) {
        self.rows += 1;
        if let Some((file, buffer)) = &mut self.out {
            write_row(TextFormat::Csv, false, row, buffer);
            if buffer.len() > 1 << 18 {
                let _ = file.write_all(buffer);
                buffer.clear();
            }
        }
    }

    fn defect(&mut self, _defect: &Defect) {}
}

/// How long decoding takes in this process, s, and its rows.
fn decode(path: &Path, write: bool) -> Result<(f64, u64), String> {
    let failed = |error: io::Error| format!("/dev/null: {error}");
    let out = write.then(|| File::create("/dev/null")).transpose().map_err(failed)?;
    let mut counter = Counter { rows: 0, out: out.map(|file| (file, Vec::new())) };
    let start = Instant::now();
    let mut reader = InputReader::new(DecoderOptions::default(), Stop::default());
    let result = reader.read(&path.to_string_lossy(), &mut counter);
    let (_summary, ending) = reader.finish(&mut counter);
    let time_s = start.elapsed().as_secs_f64();
    result.and(ending).map_err(|error| error.to_string())?;
    Ok((time_s, counter.rows))
}

const GEU_SUMMARY: &str = "geu decode --format summary";
const GEU_CSV: &str = "geu decode --format csv";
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

/// Ours and other tools, each as a process from its start to its end, its output thrown away.
fn processes<'a>(log: &'a Path, dbc: &'a Path) -> Result<Vec<Contender<'a, f64>>, CommandError> {
    let geu = std::env::current_exe().map_err(CommandError::failed)?;
    let of_geu = |format: &'static str| {
        let geu = geu.clone();
        move || process(Command::new(&geu).args(["decode", "--format", format]).arg(log))
    };
    Ok(vec![
        Contender::ours(GEU_SUMMARY, of_geu("summary")),
        Contender::ours(GEU_CSV, of_geu("csv")),
        Contender::other("python-can", move || process(Command::new("python3").args(["-c", PYTHON_CAN]).arg(log))),
        Contender::other("python-can + cantools", move || {
            process(Command::new("python3").args(["-c", CANTOOLS]).arg(log).arg(dbc))
        }),
        Contender::other("log2asc", move || process(Command::new("log2asc").arg("-I").arg(log).arg("can0"))),
    ])
}

/// How long a command takes, s; or why it does not work here.
fn process(command: &mut Command) -> Result<f64, String> {
    let start = Instant::now();
    let output = command.stdin(Stdio::null()).stdout(Stdio::null()).output();
    let time_s = start.elapsed().as_secs_f64();
    let output = output.map_err(|error| format!("it cannot be started: {error}"))?;
    match output.status.success() {
        true => Ok(time_s),
        false => Err(String::from_utf8_lossy(&output.stderr).lines().last().unwrap_or("it failed").to_owned()),
    }
}
