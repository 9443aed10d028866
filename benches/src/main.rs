//! Benchmarks of GEU for its developers: one file per benchmark, with its arguments and output.
//!
//! `process` starts the program `geu` of the same build profile, which is not built with this one: `cargo build --release`
//! comes first.

mod cadence;
mod calibrate;
mod control;
mod decode;
mod diagnose;
mod growth;
mod matrix;
mod model;
mod next_manoeuvre;
mod process;
mod report;
mod rounds;
mod table;
mod watch;
mod year;

use std::error::Error;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Result of a benchmark; the message of an error is printed.
type Result<T = (), E = Box<dyn Error>> = std::result::Result<T, E>;

/// Benchmarks of GEU.
#[derive(Parser)]
#[command(name = "geu-bench")]
struct Arguments {
    #[command(subcommand)]
    benchmark: Benchmark,
}

#[derive(Subcommand)]
enum Benchmark {
    /// Lateness of samples, beside tokio's interval and python-can, and beside cangen on a CAN interface.
    Cadence(cadence::Arguments),
    /// Time of the evaluation of a recording, beside numpy and filterpy.
    Calibrate(calibrate::Arguments),
    /// Effect of clients of the HTTP interface on the cadence.
    Control(control::Arguments),
    /// Throughput of the decoder, beside the crate socketcan, python-can, cantools, log2asc and asammdf on the same samples.
    Decode(decode::Arguments),
    /// The whole diagnosis: time, memory and effects found, beside statsmodels and pysindy.
    Diagnose(diagnose::Arguments),
    /// The diagnosis of the independent model's recordings, over motions and references.
    Matrix(matrix::Arguments),
    /// Samples per second of the model, beside the same gyros in numpy, Basilisk and gnss-ins-sim.
    Model(model::Arguments),
    /// Cost and memory of simulation, decoding and calibration by the length of a recording.
    Growth(growth::Arguments),
    /// The manoeuvres that diagnoses propose for ambiguous pairs.
    NextManoeuvre(next_manoeuvre::Arguments),
    /// All parts of docs/benchmarks.md, and the page.
    Report(report::Arguments),
    /// False alarms of the watch, and its delay by fault.
    Watch(watch::Arguments),
    /// A year, decoded, calibrated by fortnight and diagnosed by day; it takes hours, and continues where it was stopped.
    Year(year::Arguments),
}

fn main() -> ExitCode {
    let result = match Arguments::parse().benchmark {
        Benchmark::Cadence(arguments) => cadence::run(&arguments),
        Benchmark::Calibrate(arguments) => calibrate::run(&arguments),
        Benchmark::Control(arguments) => control::run(&arguments),
        Benchmark::Decode(arguments) => decode::run(&arguments),
        Benchmark::Diagnose(arguments) => diagnose::run(&arguments),
        Benchmark::Growth(arguments) => growth::run(&arguments),
        Benchmark::Matrix(arguments) => matrix::run(&arguments),
        Benchmark::Model(arguments) => model::run(&arguments),
        Benchmark::NextManoeuvre(arguments) => next_manoeuvre::run(&arguments),
        Benchmark::Report(arguments) => report::run(&arguments),
        Benchmark::Watch(arguments) => watch::run(&arguments),
        Benchmark::Year(arguments) => year::run(&arguments),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("geu-bench: {error}");
            ExitCode::FAILURE
        }
    }
}
