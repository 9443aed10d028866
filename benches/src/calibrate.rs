//! `geu-bench calibrate`: time of the evaluation of a recording.

use std::time::Instant;

use clap::Args;
use geu_calibration::GyroSet;
use geu_calibration::checkout::{AttitudeSourceKind, Precautions, before_checkout, sequence, simulate};
use geu_calibration::filter::{FilterNoise, SurveyDay, checkout_calibration, reconstruct};
use geu_model::Configuration;

use crate::Result;
use crate::process::{on_one_thread, python};
use crate::rounds::{Contender, Rounds, Spread};
use crate::table::Table;

/// Arguments of `geu-bench calibrate`.
#[derive(Args)]
pub struct Arguments {
    #[command(flatten)]
    rounds: Rounds,
    /// Leave out numpy and filterpy
    #[arg(long)]
    alone: bool,
}

/// Equal sizes in Python.
const PYTHON: &str = include_str!("calibrate.py");

/// Samples of a day.
const DAY: usize = 172_800;

/// Measures and prints.
///
/// # Errors
/// A calibration fails.
pub fn run(arguments: &Arguments) -> Result {
    on_one_thread()?;
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
    let (fixes, directory) = (day.fixes.len(), tempfile::tempdir()?);
    let scripts = directory.path();
    let filter = Contender::ours(format!("filter and smoother, {DAY} samples, {fixes} fixes"), || {
        timed(|| {
            reconstruct(&day.counts, &calibrations, GyroSet::WithZa, &noise, &day.fixes, |_, own| {
                std::hint::black_box(own);
            })
        })
    });
    let mut contenders = vec![
        by(AttitudeSourceKind::Reference, "reference"),
        by(AttitudeSourceKind::Sensors, "star and sun sensor"),
        filter,
    ];
    let mut other = |name: String, tool: &'static str, samples: usize| {
        contenders.push(Contender::other(name, move || {
            let text = python(scripts, PYTHON, &[tool, &samples.to_string(), &fixes.to_string()])?.text()?;
            text.trim().parse::<f64>().map(|time_s| time_s * 1e3).map_err(|_| format!("expected seconds, got {text}"))
        }));
    };
    if !arguments.alone {
        other(format!("numpy, `lstsq` of {samples} samples"), "numpy", samples);
        other(format!("filterpy, filter and smoother, {DAY} samples, {fixes} fixes"), "filterpy", DAY);
    }
    println!("one core; {}", arguments.rounds);
    let results = arguments.rounds.measure(contenders)?;
    let runs_of = |index: usize| results.get(index).and_then(|one| one.runs.as_ref().ok());
    let mut table = Table::new("calibrate", &["one core", "ms, median (min…max)", "target", ""]);
    // Each other tool beside the part of GEU that does the same.
    for (index, (result, target_ms)) in results.iter().zip([50.0, 50.0, 1000.0, 0.0, 0.0]).enumerate() {
        let runs = match &result.runs {
            Ok(runs) => runs,
            Err(reason) => {
                table.row([result.name.clone(), format!("skipped: {reason}")]);
                continue;
            }
        };
        let took_ms = Spread::new(runs.iter().copied());
        let target = match took_ms.median <= target_ms {
            _ if target_ms == 0.0 => String::new(),
            true => format!("{target_ms}: met"),
            false => format!("{target_ms}: missed"),
        };
        let ratio = match index.checked_sub(3).and_then(|other| runs_of([0, 2][other])) {
            Some(ours) => format!("GEU is {:.1} times as fast", Spread::of_ratios(runs, ours)),
            None => String::new(),
        };
        table.row([result.name.clone(), format!("{took_ms:.1}"), target, ratio]);
    }
    println!("{table}");
    Ok(())
}

/// Time of `work`, ms.
fn timed<T, E: std::fmt::Display>(work: impl FnOnce() -> Result<T, E>) -> Result<f64, String> {
    let start = Instant::now();
    std::hint::black_box(work().map_err(|error| error.to_string())?);
    Ok(start.elapsed().as_secs_f64() * 1e3)
}
