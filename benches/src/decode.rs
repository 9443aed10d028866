//! `geu-bench decode`: throughput of the decoder on one core, and beside other tools on the same samples.

use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

mod device;
mod inputs;

use clap::Args;
use geu_protocol::capture::{CaptureRecord, Format};
use geu_protocol::{CanIdMap, describe};
use geu_recording::{DecoderOptions, Defect, InputReader, ReceivedSample, Sink, Stop};
use geu_report::rows::{TextFormat, write_row};

use crate::Result;
use crate::process::{finish, geu, on_one_thread};
use crate::rounds::{Contender, Results, Rounds, Spread};
use crate::table::{Table, compared};

/// Arguments of `geu-bench decode`.
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
const RECORDS: &str = "candump log to records";
const SAMPLES: &str = "candump log to samples";
const SOCKETCAN: &str = "candump log to records, crate socketcan";

/// Measures and prints.
///
/// # Errors
/// A temporary file cannot be written, or our decoder fails.
pub fn run(arguments: &Arguments) -> Result {
    if arguments.lines < 3 {
        return Err(format!("--lines: expected 3 or more, got {}", arguments.lines).into());
    }
    on_one_thread()?;
    let directory = tempfile::tempdir()?;
    let inputs = Inputs::new(directory.path(), arguments.lines)?;
    println!("{} lines of candump log, {:.0} MB; {}", arguments.lines, inputs.length(LOG) / MEGABYTE, arguments.rounds);
    println!("{}", in_process(arguments, &inputs)?);
    if !arguments.alone {
        println!("{}", beside_others(arguments, &inputs)?);
    }
    Ok(())
}

/// Throughput without a process around it, on one core, beside the reader of another crate.
fn in_process(arguments: &Arguments, inputs: &Inputs) -> Result<Table> {
    let (log, bin) = (&inputs.path(LOG), &inputs.path(BIN));
    let (lines, rows) = (arguments.lines as f64, decode(log, false)?.1 as f64);
    let units = device::inputs(&inputs.directory, arguments.lines)?;
    let mut own = vec![
        (RECORDS.to_owned(), (lines / 1e6, "M lines/s", 0.0)),
        (SOCKETCAN.to_owned(), (lines / 1e6, "M lines/s", 0.0)),
        (SAMPLES.to_owned(), (lines / 1e6, "M lines/s", 8.0)),
        ("candump log to CSV".to_owned(), (rows / 1e6, "M rows/s", 2.0)),
        ("raw serial to samples".to_owned(), (inputs.length(BIN) / MEGABYTE, "MB/s", 500.0)),
    ];
    let mut contenders: Vec<Contender<f64>> = vec![
        Contender::ours(RECORDS, move || read_records(log)),
        Contender::ours(SOCKETCAN, move || read_socketcan(log)),
        Contender::ours(SAMPLES, move || decode(log, false).map(|(time_s, _)| time_s)),
        Contender::ours(&own[3].0, move || decode(log, true).map(|(time_s, _)| time_s)),
        Contender::ours(&own[4].0, move || decode(bin, false).map(|(time_s, _)| time_s)),
    ];
    for unit in &units {
        let name = format!("`{}` to samples", unit.name);
        contenders.push(Contender::ours(&name, move || unit.decode()));
        own.push((name, unit.work));
    }
    let results = arguments.rounds.measure(contenders)?;
    let times = |name: &str| -> Vec<f64> {
        results.iter().filter(|one| one.name == name).flat_map(|one| one.runs.iter().flatten().copied()).collect()
    };
    let mut table = Table::new("decode-core", &["one core", "median (min…max)", "target", ""]);
    for (Results { name, runs }, (_, (work, unit, target))) in results.iter().zip(&own) {
        let throughput = Spread::new(runs.iter().flatten().map(|time_s| work / time_s));
        let target = match throughput.median >= *target {
            _ if *target == 0.0 => String::new(),
            true => format!("{target}: met"),
            false => format!("{target}: missed"),
        };
        let ratio = match name == RECORDS || name == SAMPLES {
            true => {
                format!("{:.1} times the crate socketcan", Spread::of_ratios(&times(SOCKETCAN), &times(name)))
            }
            false => String::new(),
        };
        table.row([name.clone(), format!("{throughput:.1} {unit}"), target, ratio]);
    }
    Ok(table)
}

/// Counts rows, and writes them as CSV to `/dev/null`.
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

/// Time to decode in this process, s, and the number of rows.
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

/// Time to read the records of a candump log, s. Parts of the file are read into one buffer, as the other reader does.
fn read_records(path: &Path) -> Result<f64, String> {
    let failed = |error: io::Error| error.to_string();
    let start = Instant::now();
    let mut file = File::open(path).map_err(failed)?;
    let mut reader =
        Format::from_name("candump").and_then(Format::reader).ok_or("expected a reader of candump logs")?;
    let (mut buffer, mut filled, mut sum) = (vec![0; 1 << 18], 0, 0u64);
    loop {
        let length = file.read(&mut buffer[filled..]).map_err(failed)?;
        filled += length;
        let used = reader.read(&buffer[..filled], length == 0, &mut |_, record| {
            if let CaptureRecord::Frame(frame) = record {
                sum += u64::from(frame.id) + frame.data.iter().map(|&byte| u64::from(byte)).sum::<u64>();
            }
        });
        if length == 0 {
            break;
        }
        buffer.copy_within(used..filled, 0);
        filled -= used;
    }
    std::hint::black_box(sum);
    Ok(start.elapsed().as_secs_f64())
}

/// Time of the reader of the crate socketcan, s.
fn read_socketcan(path: &Path) -> Result<f64, String> {
    use socketcan::{CanAnyFrame, EmbeddedFrame, Frame};
    let start = Instant::now();
    let reader = socketcan::dump::Reader::from_file(path).map_err(|error| error.to_string())?;
    let mut sum = 0u64;
    for record in reader {
        if let CanAnyFrame::Normal(frame) = record.map_err(|error| error.to_string())?.frame {
            sum += u64::from(frame.raw_id()) + frame.data().iter().map(|&byte| u64::from(byte)).sum::<u64>();
        }
    }
    std::hint::black_box(sum);
    Ok(start.elapsed().as_secs_f64())
}

const LOG: &str = "bench.log";
const BIN: &str = "bench.bin";
const PCAPNG: &str = "bench.pcapng";
const BLF: &str = "bench.blf";
const MF4: &str = "bench.mf4";
const DBC: &str = "bench.dbc";

const PYTHON_CAN: &str = "
import can, sys
for message in can.LogReader(sys.argv[1]):
    pass
";
const CANTOOLS: &str = "
import can, cantools, sys
database = cantools.database.load_file(sys.argv[2])
for message in can.LogReader(sys.argv[1]):
    database.decode_message(message.arbitration_id, message.data)
";
const ASAMMDF: &str = "
import sys
from asammdf import MDF
with MDF(sys.argv[1]) as mdf:
    signals = mdf.extract_bus_logging({'CAN': [(sys.argv[2], 0)]})
    for channel in ('gyrx', 'clock_count'):
        assert len(signals.get(channel)) > 0
";
/// The log in other formats, which only Python writes.
const CONVERT: &str = "
import can, sys
log, *others = sys.argv[1:]
for other in others:
    with can.LogReader(log) as reader, can.Logger(other) as writer:
        for message in reader:
            message.channel = 0
            writer(message)
";

/// Files with the same samples.
struct Inputs {
    directory: PathBuf,
}

impl Inputs {
    fn new(directory: &Path, lines: u64) -> io::Result<Inputs> {
        let inputs = Inputs { directory: directory.to_owned() };
        inputs::write(&inputs.path(LOG), &inputs.path(BIN), &inputs.path(PCAPNG), lines)?;
        fs::write(inputs.path(DBC), describe::dbc(CanIdMap::default()))?;
        // Else they are written to the disk while they are read.
        for name in [LOG, BIN, PCAPNG] {
            File::open(inputs.path(name))?.sync_all()?;
        }
        Ok(inputs)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.directory.join(name)
    }

    fn length(&self, name: &str) -> f64 {
        fs::metadata(self.path(name)).map_or(0, |metadata| metadata.len()) as f64
    }

    /// A command as a whole process with its output thrown away; it fails where a file is missing.
    fn command<'a>(&'a self, program: &str, arguments: &[&str], files: &[&str], is_alone: bool) -> Run<'a> {
        let mut command = if program == "geu" { geu()? } else { Command::new(program) };
        let files: Vec<PathBuf> = files.iter().map(|file| self.path(file)).collect();
        command.args(arguments).args(&files);
        if !is_alone {
            command.env_remove("RAYON_NUM_THREADS");
        }
        Ok(Box::new(move || {
            let finished = finish(&mut command, Stdio::null())?;
            finished.text().map(|_| finished.time_s)
        }))
    }
}

type Run<'a> = Result<Box<dyn FnMut() -> Result<f64, String> + 'a>>;

/// Whole processes, their start included; ours on one thread and on all.
fn beside_others(arguments: &Arguments, inputs: &Inputs) -> Result<Table> {
    // Each row with the own row that it is compared to.
    let mut rows: Vec<(String, &str)> = Vec::new();
    let mut contenders = Vec::new();
    let all = "all cores, ";
    for (file, format) in [
        (LOG, "summary"),
        (LOG, "csv"),
        (LOG, "jsonl"),
        (LOG, "parquet"),
        (PCAPNG, "csv"),
        (BLF, "csv"),
        (BIN, "csv"),
        (BIN, "parquet"),
    ] {
        for prefix in ["", all] {
            let name = format!("{prefix}{}", own_name(file, format));
            let run = inputs.command("geu", &["decode", "--quiet", "--format", format], &[file], prefix.is_empty())?;
            // A BLF exists only if Python wrote it.
            contenders.push(if file == BLF { Contender::other(&name, run) } else { Contender::ours(&name, run) });
            rows.push((name, ""));
        }
    }
    let converted = finish(
        Command::new("python3").args(["-c", CONVERT]).args([LOG, BLF, MF4].map(|name| inputs.path(name))),
        Stdio::piped(),
    );
    if let Err(reason) = converted.and_then(|finished| finished.text()) {
        println!("no {BLF} and {MF4}: {reason}");
    }
    let log_csv = "candump log to CSV";
    for (name, program, arguments, files, own) in [
        ("python-can, candump log", "python3", vec!["-c", PYTHON_CAN], vec![LOG], "candump log to a summary"),
        ("python-can with cantools, candump log", "python3", vec!["-c", CANTOOLS], vec![LOG, DBC], log_csv),
        ("log2asc, candump log", "log2asc", vec!["-I"], vec![LOG], log_csv),
        ("python-can with cantools, BLF", "python3", vec!["-c", CANTOOLS], vec![BLF, DBC], "BLF to CSV"),
        ("asammdf, MDF to columns", "python3", vec!["-c", ASAMMDF], vec![MF4, DBC], "candump log to Parquet"),
    ] {
        let mut run = inputs.command(program, &arguments, &files, true)?;
        if program == "log2asc" {
            let mut command = Command::new(program);
            command.arg("-I").arg(inputs.path(LOG)).arg("can0");
            run = Box::new(move || {
                let finished = finish(&mut command, Stdio::null())?;
                finished.text().map(|_| finished.time_s)
            });
        }
        contenders.push(Contender::other(name, run));
        rows.push((name.to_owned(), own));
    }
    let results = arguments.rounds.measure(contenders)?;
    let mut table = Table::new("decode-processes", &["", "s, median (min…max)", "within each round"]);
    for (name, own) in &rows {
        let on_all = format!("{all}{own}");
        let ours: &[(&str, &str)] =
            if own.is_empty() { &[] } else { &[(own, "GEU on one core"), (&on_all, "on all cores")] };
        compared(&mut table, &results, name, ours, 3);
    }
    Ok(table)
}

fn own_name(file: &str, format: &str) -> String {
    let from = match file {
        LOG => "candump log",
        PCAPNG => "pcapng",
        BLF => "BLF",
        _ => "raw serial",
    };
    let to = match format {
        "csv" => "CSV",
        "jsonl" => "JSON lines",
        "parquet" => "Parquet",
        other => return format!("{from} to a {other}"),
    };
    format!("{from} to {to}")
}
