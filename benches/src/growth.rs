//! `geu-bench growth`: cost per sample and memory by the length of a recording.

use std::path::Path;
use std::process::{Command, Stdio};

use clap::Args;
use geu_model::units::SAMPLE_INTERVAL_S;

use crate::Result;
use crate::process::{Finished, finish, geu};
use crate::rounds::{Contender, Rounds, Spread};
use crate::table::Table;

/// Arguments of `geu-bench growth`.
#[derive(Args)]
pub struct Arguments {
    /// Lengths of the recordings
    #[arg(long, value_name = "H,…", value_delimiter = ',', default_value = "1,24,720")]
    hours: Vec<f64>,
    #[command(flatten)]
    rounds: Rounds,
}

/// Length with the cost of a start alone.
const START_S: f64 = 1.0;
/// An hour costs milliseconds, so that it is measured more often than a run.
const SHORT_S: f64 = 7200.0;
const REPETITIONS: u32 = 20;

const COMMANDS: [(&str, &str); 3] = [
    ("simulate", "`geu simulate`, truth as Parquet"),
    ("decode", "`geu decode`, to CSV"),
    ("calibrate", "`geu calibrate`, by reference"),
];

/// CPU time of a run, s, and its largest memory, MB.
type Cost = (f64, f64);

/// Measures and prints. The recordings are removed as soon as they are measured.
///
/// # Errors
/// A recording cannot be written, or a command fails.
pub fn run(arguments: &Arguments) -> Result {
    println!("CPU time of all threads per sample, without that of a start; {}", arguments.rounds);
    let columns = ["", "length, h", "µs per sample, median (min…max)", "against the first length", "peak memory, MB"];
    let mut table = Table::new("growth", &columns);
    let mut first: [Option<Vec<f64>>; COMMANDS.len()] = Default::default();
    for &hours in &arguments.hours {
        let directory = tempfile::tempdir()?;
        let (path, duration_s) = (directory.path(), hours * 3600.0);
        for (name, duration_s) in [("start", START_S), ("whole", duration_s)] {
            simulate(&path.join(name), duration_s)?;
        }
        let contenders = COMMANDS.map(|(command, _)| {
            let run = move || {
                let repetitions = if duration_s <= SHORT_S { REPETITIONS } else { 1 };
                let (start_s, _) = cost(command, path, "start", START_S, REPETITIONS)?;
                let (cpu_s, peak_mb) = cost(command, path, "whole", duration_s, repetitions)?;
                Ok(((cpu_s - start_s) / (duration_s / SAMPLE_INTERVAL_S) * 1e6, peak_mb))
            };
            // An hour has too little motion to calibrate by.
            if command == "calibrate" { Contender::other(command, run) } else { Contender::ours(command, run) }
        });
        let results = arguments.rounds.measure(contenders.into())?;
        for ((result, (_, name)), first) in results.into_iter().zip(COMMANDS).zip(&mut first) {
            let runs: Vec<Cost> = match result.runs {
                Ok(runs) => runs,
                Err(reason) => {
                    table.row([name.to_owned(), hours.to_string(), format!("skipped: {reason}")]);
                    continue;
                }
            };
            let per_sample_us: Vec<f64> = runs.iter().map(|(us, _)| *us).collect();
            let ratio = Spread::of_ratios(&per_sample_us, first.get_or_insert_with(|| per_sample_us.clone()));
            let peak_mb = runs.iter().fold(0.0f64, |peak, (_, mb)| peak.max(*mb));
            let figures =
                [format!("{:.2}", Spread::new(per_sample_us)), format!("{ratio:.2}"), format!("{peak_mb:.0}")];
            table.row([name.to_owned(), hours.to_string()].into_iter().chain(figures));
        }
    }
    println!("{table}");
    Ok(())
}

fn simulate(out: &Path, duration_s: f64) -> Result<Finished, String> {
    let mut command = geu().map_err(|error| error.to_string())?;
    command.args(["simulate", "--force", "--start", "1790000000", "--format", "parquet", "--duration"]);
    completed(command.arg(duration_s.to_string()).arg("--out").arg(out))
}

/// Mean CPU time and largest memory of a command on a recording.
fn cost(command: &str, directory: &Path, name: &str, duration_s: f64, repetitions: u32) -> Result<Cost, String> {
    let recording = directory.join(name);
    let (mut cpu_s, mut peak_mb) = (0.0, 0.0f64);
    for _ in 0..repetitions {
        let finished = match command {
            "simulate" => simulate(&directory.join("again"), duration_s)?,
            "decode" => {
                let mut command = geu().map_err(|error| error.to_string())?;
                completed(command.args(["decode", "--quiet"]).arg(recording.join("link.log")))?
            }
            _ => {
                let mut command = geu().map_err(|error| error.to_string())?;
                command.arg("calibrate").arg("--link").arg(recording.join("link.log"));
                // A start has no motion to calibrate by, which it says.
                let command = command.arg("--reference").arg(recording.join("reference.csv"));
                if name == "start" { finish(command, Stdio::null())? } else { completed(command)? }
            }
        };
        (cpu_s, peak_mb) = (cpu_s + finished.cpu_s, peak_mb.max(finished.peak_mb));
    }
    Ok((cpu_s / f64::from(repetitions), peak_mb))
}

fn completed(command: &mut Command) -> Result<Finished, String> {
    let finished = finish(command, Stdio::null())?;
    finished.text().map(|_| finished)
}
