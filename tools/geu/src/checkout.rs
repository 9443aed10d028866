//! `geu checkout`: the in-orbit checkout flown in simulation, calibrated, compared with the truth.

use std::fmt::Write;
use std::path::Path;

use clap::{Args, ValueEnum};
use geu_calibration::checkout::{
    self, By, Campaign, Outcome, Precautions, believed_before, fly, sequence, true_calibrations,
};
use geu_calibration::combine;
use geu_calibration::compare::LEAST_PROBABILITY;
use geu_calibration::solve::{Parameter, Solution, UNKNOWNS, values};
use geu_daemon::recorder::{Destination, FILES, Recorder};
use geu_daemon::simulate::simulate;
use geu_model::configuration::WireForm;
use geu_model::{Configuration, Truth};
use geu_protocol::Gyro;

use crate::failure::{Failure, note, say};
use crate::outputs::OutputDirectory;
use crate::overwriting::Force;
use crate::settings::{NamedSettings, Settings, seed};

/// Flies the in-orbit checkout in simulation, calibrates it and compares with the truth.
///
/// The sequence is that of configs/checkout.toml, about fourteen hours; it is flown twice, and the two results are
/// compared and combined. None of the sixteen parameters is believed beforehand; the unit's noise and its other
/// effects are.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    unit: NamedSettings,
    /// What tells the rotations
    #[arg(long, value_enum, default_value_t = Sensors::Absolute)]
    attitude: Sensors,
    /// Fly so many, each with a unit, ψ₀ and limit cycle of its own, and compare scatter with prediction
    #[arg(long, value_name = "N", conflicts_with_all = ["precautions", "out"], value_parser = clap::value_parser!(u32).range(1..))]
    runs: Option<u32>,
    /// Print what each precaution of Casteren §5 buys; without --config to the reference unit with pivots of 14 arcsec and
    /// a thermal misalignment of 0.5 arcsec/deg
    #[arg(long, conflicts_with = "out")]
    precautions: bool,
    /// Directory to write the recording of the first flight into, as `geu simulate` does
    #[arg(long, value_name = "DIRECTORY")]
    out: Option<OutputDirectory>,
    #[command(flatten)]
    force: Force,
    /// Seed, in place of the configuration's
    #[arg(long, allow_negative_numbers = true, value_parser = seed)]
    seed: Option<u64>,
    /// Threads [default: one for each core]; the result is the same
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

#[derive(ValueEnum, Debug, Clone, Copy)]
enum Sensors {
    /// FSS and SSE
    Absolute,
    /// The true attitude
    Reference,
}

/// What the precautions are for, at the paper's values (model.md, Effects).
const GUARDED_AGAINST: [&str; 5] = [
    "unit.misalignment-thermal={ arcsec_per_deg = 0.5, time_constant_s = 300.0 }",
    "gyro.GYRX.pivot-clearance.clearance_arcsec=14",
    "gyro.GYRY.pivot-clearance.clearance_arcsec=14",
    "gyro.GYRZA.pivot-clearance.clearance_arcsec=14",
    "gyro.GYRZB.pivot-clearance.clearance_arcsec=14",
];

/// Carries it out.
///
/// # Errors
/// A configuration that cannot be read, a checkout that cannot be calibrated, files that cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let out = arguments.out.as_ref().map(|out| out.prepare(arguments.force, FILES)).transpose()?;
    let settings = Settings::from(&arguments.unit);
    let mut unit = if arguments.precautions && settings.config.is_none() {
        let overrides = GUARDED_AGAINST.into_iter().map(str::to_owned).chain(settings.overrides.clone());
        Configuration::reference_with(&overrides.collect::<Vec<_>>()).map_err(Failure::input)?
    } else {
        settings.read()?
    };
    unit.seed = arguments.seed.unwrap_or(unit.seed);
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global().map_err(Failure::failed)?;
    }
    let by = match arguments.attitude {
        Sensors::Absolute => By::Sensors,
        Sensors::Reference => By::Reference,
    };
    match arguments.runs {
        Some(runs) => {
            let bar = indicatif::ProgressBar::new(runs.into());
            let campaign = checkout::campaign(&unit, unit.seed, runs as usize, by, || bar.inc(1));
            bar.finish_and_clear();
            say!("{}", scatter(&campaign))?;
            match campaign.failed.first() {
                Some((run, why)) => Err(Failure::failed(format!("run {run}: {why}"))),
                None => Ok(()),
            }
        }
        None if arguments.precautions => {
            say!("{}", what_they_buy(&checkout::precautions(&unit).map_err(Failure::failed)?))
        }
        None => twice(&unit, by, out, arguments.force),
    }
}

/// Flies the sequence twice, compares and combines.
fn twice(unit: &Configuration, by: By, out: Option<&Path>, force: Force) -> Result<(), Failure> {
    let first = sequence(unit, Precautions::ALL);
    // Flown at once by the same unit, with other noise, at another ψ₀ and with other phases of the limit cycle.
    let mut second = sequence(&checkout::drawn(unit, unit.seed, 0), Precautions::ALL);
    second.gyros = first.gyros.clone();
    if let Some(directory) = out {
        let destination = Destination::new(directory, force.force);
        let mut recorder = Recorder::create(&destination, &first, &Truth::Scenario, WireForm::Can, &[])?;
        let half_seconds = fly_length(&first);
        simulate(&first, &Truth::Scenario, half_seconds, &mut recorder, |_| true).map_err(Failure::failed)?;
        recorder.finish().map_err(Failure::failed)?;
    }
    let solve = |configuration: &Configuration| -> Result<Solution, Failure> {
        let calibrated = fly(configuration).calibrate(&believed_before(configuration), by).map_err(Failure::failed)?;
        Ok(calibrated.solution)
    };
    let (one, two) = (solve(&first)?, solve(&second)?);
    let comparison = combine(&one, &two).map_err(Failure::failed)?;
    let truth = values(&true_calibrations(&first));
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{:<22} {:>12}  {:>16} {:>16} {:>7}  {:>16} {:>8}",
        "parameter", "truth", "first − truth", "second − truth", "χ²", "both − truth", "in sigma"
    );
    let (firsts, seconds, both) = (one.values(), two.values(), comparison.combined.values());
    let sigmas = [one.sigmas(), two.sigmas(), comparison.combined.sigmas()];
    for (index, parameter) in Parameter::all().enumerate() {
        let error = |value: f64, sigma: f64| {
            let (size, digits, unit) = scale(parameter);
            format!("{:+.digits$} ± {:.digits$}{unit}", (value - truth[index]) * size, sigma * size)
        };
        let _ = writeln!(
            text,
            "{:<22} {:>12.6}  {:>16} {:>16} {:>7.2}  {:>16} {:>+8.1}",
            parameter.words(),
            truth[index],
            error(firsts[index], sigmas[0][index]),
            error(seconds[index], sigmas[1][index]),
            comparison.chi2[index],
            error(both[index], sigmas[2][index]),
            (both[index] - truth[index]) / sigmas[2][index],
        );
    }
    let _ = write!(
        text,
        "scale factors in ppm, drifts in arcsec/h, misalignments in arcsec\n\
         spare equations: χ² {:.1} of {} and {:.1} of {}; the two differ by χ² {:.1} of {UNKNOWNS}, probability {:.2}: {}",
        one.chi2,
        one.degrees_of_freedom,
        two.chi2,
        two.degrees_of_freedom,
        comparison.together,
        comparison.together_probability(),
        if comparison.is_compatible() { "compatible" } else { "not compatible" },
    );
    say!("{text}")?;
    for (which, solution) in [("first", &one), ("second", &two)] {
        if solution.probability() < LEAST_PROBABILITY {
            note(format_args!(
                "geu: the sixteen parameters do not explain the {which} flight, probability {:.1e}: its sigmas are too small\n",
                solution.probability()
            ));
        }
    }
    Ok(())
}

fn fly_length(configuration: &Configuration) -> u64 {
    geu_model::attitude::Plan::length_s(&configuration.scenario).map_or(0, |length_s| (length_s * 2.0).ceil() as u64)
}

/// Factor, digits and unit in which errors of a parameter are told.
fn scale(parameter: Parameter) -> (f64, usize, &'static str) {
    match parameter.index {
        0 => (1e6, 2, ""),
        1 => (7200.0, 2, ""),
        _ => (1.0, 2, ""),
    }
}

/// A campaign for a terminal.
fn scatter(campaign: &Campaign) -> String {
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{:<22} {:>8} {:>10} {:>10} {:>8} {:>10} {:>10}   {:>14}",
        "parameter", "unit", "rms error", "predicted", "ratio", "mean/σ√N", "coverage", "hand rms error"
    );
    for (index, found) in campaign.scatter.iter().enumerate() {
        let (size, digits, _) = scale(found.parameter);
        let hand =
            campaign.hand_rms_error.map_or_else(|| "–".to_owned(), |hand| format!("{:.digits$}", hand[index] * size));
        let _ = writeln!(
            text,
            "{:<22} {:>8} {:>10.digits$} {:>10.digits$} {:>8.3} {:>+10.1} {:>9.1}%   {hand:>14}",
            found.parameter.words(),
            ["ppm", "arcsec/h", "arcsec"][found.parameter.index.min(2)],
            found.rms_error * size,
            found.sigma * size,
            found.rms_error / found.sigma,
            found.mean_error / found.sigma * (campaign.runs as f64).sqrt(),
            found.coverage * 100.0,
        );
    }
    let least = campaign.scatter.iter().map(|found| found.coverage).fold(1.0, f64::min);
    let most = campaign.scatter.iter().map(|found| found.coverage).fold(0.0, f64::max);
    let _ = write!(
        text,
        "{} runs; one sigma holds {:.1}…{:.1} % of the errors (68.3 expected); mean of the reduced χ² {:.3}",
        campaign.runs,
        least * 100.0,
        most * 100.0,
        campaign.mean_reduced_chi2
    );
    text
}

/// The precautions for a terminal.
fn what_they_buy(outcomes: &[Outcome]) -> String {
    let mut text = String::from("largest error of an equation with the true parameters, arcsec, and its manoeuvre\n");
    let names = Gyro::ALL.map(|gyro| format!("{:>16}", gyro.name())).join("");
    let _ = writeln!(text, "{:<46} {:>6} {names}", "", "hours");
    for outcome in outcomes {
        let errors =
            outcome.equation_arcsec.each_ref().map(|(arcsec, name)| format!("{arcsec:>+8.1} {name:<7}")).join("");
        let _ = writeln!(text, "{:<46} {:>6.1} {errors}", outcome.what, outcome.length_s / 3600.0);
    }
    let _ = write!(
        text,
        "\nerror of the parameters: scale factors in ppm, drifts in arcsec/h, misalignments in arcsec\n{:<22}",
        ""
    );
    for index in 0..outcomes.len() {
        let _ = write!(text, " {:>9}", format!("({})", index + 1));
    }
    let _ = writeln!(text, " {:>9}", "sigma");
    for (index, parameter) in Parameter::all().enumerate() {
        let (size, digits, _) = scale(parameter);
        let _ = write!(text, "{:<22}", parameter.words());
        for outcome in outcomes {
            let _ = write!(text, " {:>+9.digits$}", outcome.errors[index] * size);
        }
        let sigma = outcomes.first().map_or(f64::NAN, |outcome| outcome.sigmas[index]);
        let _ = writeln!(text, " {:>9.digits$}", sigma * size);
    }
    let _ = write!(text, "{:<22}", "χ²");
    for outcome in outcomes {
        let _ = write!(text, " {:>9.1}", outcome.chi2.0);
    }
    let _ = write!(text, "\n{:<22}", "spare equations");
    for outcome in outcomes {
        let _ = write!(text, " {:>9}", outcome.chi2.1);
    }
    let _ = writeln!(text);
    for (index, outcome) in outcomes.iter().enumerate() {
        let _ = writeln!(text, "({}) {}", index + 1, outcome.what);
    }
    text.truncate(text.trim_end().len());
    text
}
