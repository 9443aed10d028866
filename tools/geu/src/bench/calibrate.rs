//! `geu bench calibrate`: how long the evaluation of a recording takes.

use std::time::Instant;

use clap::Args;
use geu_calibration::GyroSet;
use geu_calibration::checkout::{AttitudeSourceKind, Precautions, believed_before, fly, sequence};
use geu_calibration::filter::{FilterNoise, SurveyDay, checkout_calibration, reconstruct};
use geu_model::Configuration;

use super::rounds::{Contender, Rounds, Spread};
use crate::failure::{CommandError, say};

/// Arguments of `geu bench calibrate`.
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
/// Output that cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let configuration = Configuration::reference();
    let unit = sequence(&configuration, Precautions::ALL);
    let (flight, believed) = (fly(&unit), believed_before(&unit));
    let day = SurveyDay::simulate(&configuration, DAY);
    let (calibrations, noise) =
        (checkout_calibration(&configuration), FilterNoise::of(&configuration, GyroSet::WithZa));
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
    say!("one core; ms; {}", arguments.rounds)?;
    for (result, target_ms) in arguments.rounds.measure(contenders)?.iter().zip([50, 50, 1000]) {
        let took_ms = Spread::of(result.runs.iter().flatten().copied());
        say!("{:<58} {took_ms:>26.1}   target {target_ms}", result.name)?;
    }
    Ok(())
}

/// How long this takes, ms.
fn timed<T, E: std::fmt::Display>(work: impl FnOnce() -> Result<T, E>) -> Result<f64, String> {
    let start = Instant::now();
    std::hint::black_box(work().map_err(|error| error.to_string())?);
    Ok(start.elapsed().as_secs_f64() * 1e3)
}
