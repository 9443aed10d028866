//! `geu-bench calibrate`: time of the evaluation of a recording.

use std::time::Instant;

use clap::Args;
use geu_calibration::GyroSet;
use geu_calibration::checkout::{AttitudeSourceKind, Precautions, before_checkout, sequence, simulate};
use geu_calibration::filter::{FilterNoise, SurveyDay, checkout_calibration, reconstruct};
use geu_model::Configuration;

use crate::Result;
use crate::rounds::{Contender, Rounds, Spread};

/// Arguments of `geu-bench calibrate`.
#[derive(Args)]
pub struct Arguments {
    #[command(flatten)]
    rounds: Rounds,
}

/// Samples of a day.
const DAY: usize = 172_800;

/// Measures and prints.
///
/// # Errors
/// A calibration fails.
pub fn run(arguments: &Arguments) -> Result {
    let configuration = Configuration::reference();
    let unit = sequence(&configuration, Precautions::ALL);
    let (flight, believed) = (simulate(&unit), before_checkout(&unit));
    let day = SurveyDay::simulate(&configuration, DAY);
    let (calibrations, noise) =
        (checkout_calibration(&configuration), FilterNoise::from_configuration(&configuration, GyroSet::WithZa));
    let samples = flight.counts.len();
    let by = |by: AttitudeSourceKind, name: &str| {
        let (flight, believed) = (&flight, &believed);
        Contender::ours(format!("a checkout of {samples} samples, by {name}"), move || {
            timed(|| flight.calibrate(believed, by))
        })
    };
    let filter = format!("filter and smoother, {DAY} samples, {} fixes", day.fixes.len());
    let filter = Contender::ours(filter, || {
        timed(|| reconstruct(&day.counts, &calibrations, GyroSet::WithZa, &noise, &day.fixes))
    });
    let contenders = vec![
        by(AttitudeSourceKind::Reference, "reference"),
        by(AttitudeSourceKind::Sensors, "star and sun sensor"),
        filter,
    ];
    println!("one core; ms; {}", arguments.rounds);
    for (result, target_ms) in arguments.rounds.measure(contenders)?.iter().zip([50, 50, 1000]) {
        let took_ms = Spread::new(result.runs.iter().flatten().copied());
        println!("{:<58} {took_ms:>26.1}   target {target_ms}", result.name);
    }
    Ok(())
}

/// Time of `work`, ms.
fn timed<T, E: std::fmt::Display>(work: impl FnOnce() -> Result<T, E>) -> Result<f64, String> {
    let start = Instant::now();
    std::hint::black_box(work().map_err(|error| error.to_string())?);
    Ok(start.elapsed().as_secs_f64() * 1e3)
}
