//! `geu bench calibrate`: how long the evaluation of a recording takes.

use std::time::Instant;

use clap::Args;
use geu_calibration::InUse;
use geu_calibration::checkout::{By, Precautions, believed_before, fly, sequence};
use geu_calibration::filter::{Day, Noise, checkout_calibration, reconstruct};
use geu_model::Configuration;

use crate::failure::{Failure, say};

/// Arguments of `geu bench calibrate`.
#[derive(Args)]
pub struct Arguments {
    /// Runs of each measurement; the fastest counts
    #[arg(long, value_name = "N", default_value_t = 3)]
    runs: u32,
}

/// Half seconds of a day.
const DAY: usize = 172_800;

/// Measures and prints.
///
/// # Errors
/// Output that cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let configuration = Configuration::reference();
    let unit = sequence(&configuration, Precautions::ALL);
    let (flight, believed) = (fly(&unit), believed_before(&unit));
    say!("one core, fastest of {} runs", arguments.runs.max(1))?;
    for (by, name) in [(By::Reference, "reference"), (By::Sensors, "star and sun sensor")] {
        let took_s = fastest(arguments.runs, || flight.calibrate(&believed, by).map_err(Failure::failed))?;
        let name = format!("a checkout of {} half seconds, by {name}", flight.counts.len());
        say!("{name:<58} {:>7.1} ms   target 50 ms", took_s * 1e3)?;
    }
    let day = Day::simulate(&configuration, DAY);
    let (calibrations, noise) = (checkout_calibration(&configuration), Noise::of(&configuration, InUse::WithZa));
    let took_s = fastest(arguments.runs, || {
        reconstruct(&day.counts, &calibrations, InUse::WithZa, &noise, &day.fixes).map_err(Failure::failed)
    })?;
    let name = format!("filter and smoother, {DAY} half seconds, {} fixes", day.fixes.len());
    say!("{name:<58} {:>7.1} ms   target 1000 ms", took_s * 1e3)
}

/// Time of the fastest run.
fn fastest<T>(runs: u32, mut work: impl FnMut() -> Result<T, Failure>) -> Result<f64, Failure> {
    let mut best_s = f64::INFINITY;
    for _ in 0..runs.max(1) {
        let start = Instant::now();
        std::hint::black_box(work()?);
        best_s = best_s.min(start.elapsed().as_secs_f64());
    }
    Ok(best_s)
}
