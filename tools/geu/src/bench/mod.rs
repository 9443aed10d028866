//! `geu bench`: figures any user can measure again.

mod cadence;
mod calibrate;
mod control;
mod decode;
mod diagnose;
mod model;
mod rounds;

use clap::{Args, Subcommand};

use crate::failure::CommandError;

/// Arguments of `geu bench`.
#[derive(Args)]
pub struct Arguments {
    #[command(subcommand)]
    benchmark: Benchmark,
}

#[derive(Subcommand)]
enum Benchmark {
    /// How late samples leave, beside tokio's interval, and beside cangen on a CAN interface.
    Cadence(cadence::Arguments),
    /// How long the evaluation of a recording takes: filter and smoother over a day.
    Calibrate(calibrate::Arguments),
    /// What watching and asking over HTTP cost the cadence.
    Control(control::Arguments),
    /// Throughput of the decoder, beside python-can, cantools and log2asc on the same file.
    Decode(decode::Arguments),
    /// The whole diagnosis as a user has it: time, memory and names found, beside statsmodels and pysindy.
    Diagnose(diagnose::Arguments),
    /// Samples per second of the model, beside the same gyros in numpy.
    Model(model::Arguments),
}

/// Runs a benchmark.
pub fn run(arguments: Arguments) -> Result<(), CommandError> {
    match arguments.benchmark {
        Benchmark::Cadence(arguments) => cadence::run(&arguments),
        Benchmark::Calibrate(arguments) => calibrate::run(&arguments),
        Benchmark::Control(arguments) => control::run(&arguments),
        Benchmark::Decode(arguments) => decode::run(arguments),
        Benchmark::Diagnose(arguments) => diagnose::run(&arguments),
        Benchmark::Model(arguments) => model::run(&arguments),
    }
}
