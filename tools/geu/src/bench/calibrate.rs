//! `geu bench calibrate`: how long the evaluation of a recording takes.

use std::time::Instant;

use clap::Args;
use geu_calibration::InUse;
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
    let day = Day::simulate(&configuration, DAY);
    let (calibrations, noise) = (checkout_calibration(&configuration), Noise::of(&configuration, InUse::WithZa));
    let mut best_s = f64::INFINITY;
    for _ in 0..arguments.runs.max(1) {
        let start = Instant::now();
        let told =
            reconstruct(&day.counts, &calibrations, InUse::WithZa, &noise, &day.fixes).map_err(Failure::failed)?;
        best_s = best_s.min(start.elapsed().as_secs_f64());
        std::hint::black_box(told);
    }
    let fixes = day.fixes.len();
    say!("one core, fastest of {} runs", arguments.runs.max(1))?;
    say!("filter and smoother, {DAY} half seconds, {fixes} fixes   {best_s:>7.3} s   target 1 s")
}
