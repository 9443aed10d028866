//! `geu-bench decode`: throughput of the decoder on one core, beside other tools on the same file.

use std::error::Error;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

mod device;

use clap::Args;
use geu_protocol::serial::data_frame;
use geu_protocol::{CLOCK_PER_SAMPLE, CanIdMap, Sample, describe};
use geu_recording::{DecoderOptions, Defect, InputReader, ReceivedSample, Sink, Stop};
use geu_report::rows::{TextFormat, write_row};

use crate::Result;
use crate::process::{finish, geu};
use crate::rounds::{Contender, Results, Rounds, Spread};

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

/// Measures and prints.
///
/// # Errors
/// A temporary file cannot be written, or our decoder fails.
pub fn run(arguments: &Arguments) -> Result {
    if arguments.lines < 3 {
        return Err(format!("--lines: expected 3 or more, got {}", arguments.lines).into());
    }
    let directory = tempfile::tempdir()?;
    let [log, bin, dbc] = ["bench.log", "bench.bin", "bench.dbc"].map(|name| directory.path().join(name));
    write_inputs(&log, &bin, arguments.lines)?;
    let bytes = |path: &Path| fs::metadata(path).map_or(0, |metadata| metadata.len()) as f64;
    let lines = arguments.lines as f64;
    println!("{lines} lines of candump log, {:.0} MB; time in s; {}", bytes(&log) / MEGABYTE, arguments.rounds);
    // Our decoder without the process around it: throughput and target.
    let rows = decode(&log, false)?.1 as f64;
    let units = device::inputs(directory.path(), arguments.lines)?;
    let mut own = vec![
        ("candump log, no output".to_owned(), (lines / 1e6, "M lines/s", 8.0)),
        ("candump log to CSV".to_owned(), (rows / 1e6, "M rows/s", 2.0)),
        ("raw serial, no output".to_owned(), (bytes(&bin) / MEGABYTE, "MB/s", 500.0)),
    ];
    let (log_path, bin_path) = (&log, &bin);
    let mut contenders: Vec<Contender<f64>> = vec![
        Contender::ours(&own[0].0, move || decode(log_path, false).map(|(time_s, _)| time_s)),
        Contender::ours(&own[1].0, move || decode(log_path, true).map(|(time_s, _)| time_s)),
        Contender::ours(&own[2].0, move || decode(bin_path, false).map(|(time_s, _)| time_s)),
    ];
    for unit in &units {
        let name = format!("{}, no output", unit.name);
        contenders.push(Contender::ours(&name, move || unit.decode()));
        own.push((name, unit.work));
    }
    if !arguments.alone {
        fs::write(&dbc, describe::dbc(CanIdMap::default()))?;
        contenders.extend(processes(&log, &dbc)?);
    }
    let results = arguments.rounds.measure(contenders)?;
    for (Results { name, runs }, (_, (work, unit, target))) in results.iter().zip(&own) {
        let throughput = Spread::new(runs.iter().flatten().map(|time_s| work / time_s));
        let verdict = if throughput.median >= *target { "met" } else { "MISSED" };
        println!("{name:<32} {throughput:>24.1} {unit:<9} target {target}: {verdict}");
    }
    if results.len() > own.len() {
        println!("as processes, their own start included");
    }
    let runs_of =
        |name: &str| results.iter().find(|result| result.name == name).and_then(|result| result.runs.as_ref().ok());
    for Results { name, runs } in &results[own.len()..] {
        // A tool that only reads is compared with our summary, others with our CSV.
        let compared = if name == "python-can" { GEU_SUMMARY } else { GEU_CSV };
        match (runs, runs_of(compared)) {
            (Ok(runs), Some(ours)) if ![GEU_SUMMARY, GEU_CSV].contains(&name.as_str()) => {
                let (time_s, ratio) = (Spread::new(runs.iter().copied()), Spread::of_ratios(runs, ours));
                println!("{name:<32} {time_s:>24.3} s         {compared} is {ratio:.1} times as fast");
            }
            (Ok(runs), _) => println!("{name:<32} {:>24.3} s", Spread::new(runs.iter().copied())),
            (Err(reason), _) => println!("{name:<32} skipped: {reason}"),
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

/// Our and other tools, each as a whole process with its output thrown away.
fn processes<'a>(log: &'a Path, dbc: &'a Path) -> Result<Vec<Contender<'a, f64>>> {
    let command = |program: &str, arguments: &[&str], files: &[&Path]| {
        let mut command = if program == "geu" { geu()? } else { Command::new(program) };
        command.args(arguments).args(files);
        Ok::<_, Box<dyn Error>>(move || {
            let finished = finish(&mut command, Stdio::null())?;
            finished.text().map(|_| finished.time_s)
        })
    };
    Ok(vec![
        Contender::ours(GEU_SUMMARY, command("geu", &["decode", "--format", "summary"], &[log])?),
        Contender::ours(GEU_CSV, command("geu", &["decode", "--format", "csv"], &[log])?),
        Contender::other("python-can", command("python3", &["-c", PYTHON_CAN], &[log])?),
        Contender::other("python-can + cantools", command("python3", &["-c", CANTOOLS], &[log, dbc])?),
        Contender::other("log2asc", command("log2asc", &["-I"], &[log, Path::new("can0")])?),
    ])
}
