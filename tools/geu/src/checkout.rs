//! `geu checkout`: the in-orbit checkout flown in simulation, calibrated, compared with the truth.

use std::path::Path;

use clap::{Args, ValueEnum};
use geu_calibration::checkout::{
    self, AttitudeSourceKind, Precautions, believed_before, fly, sequence, true_calibrations,
};
use geu_calibration::combine;
use geu_calibration::compare::LEAST_PROBABILITY;
use geu_calibration::solve::{Solution, values};
use geu_daemon::recorder::{Destination, FILES, Recorder};
use geu_daemon::simulate::simulate;
use geu_model::configuration::LinkLogFormat;
use geu_model::{Configuration, Truth};
use geu_report::checkout::{campaign_table, precautions_table, twice_table};

use crate::failure::{CommandError, note, say};
use crate::outputs::OutputDirectory;
use crate::overwriting::Force;
use crate::settings::{ConfigArgs, NamedSettings, seed};

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
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let out = arguments.out.as_ref().map(|out| out.prepare(arguments.force, FILES)).transpose()?;
    let settings = ConfigArgs::from(&arguments.unit);
    let mut unit = if arguments.precautions && settings.config.is_none() {
        let overrides = GUARDED_AGAINST.into_iter().map(str::to_owned).chain(settings.overrides.clone());
        Configuration::reference_with(&overrides.collect::<Vec<_>>()).map_err(CommandError::input)?
    } else {
        settings.read()?
    };
    unit.seed = arguments.seed.unwrap_or(unit.seed);
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global().map_err(CommandError::failed)?;
    }
    let by = match arguments.attitude {
        Sensors::Absolute => AttitudeSourceKind::Sensors,
        Sensors::Reference => AttitudeSourceKind::Reference,
    };
    match arguments.runs {
        Some(runs) => {
            let bar = indicatif::ProgressBar::new(runs.into());
            let campaign = checkout::campaign(&unit, unit.seed, runs as usize, by, || bar.inc(1));
            bar.finish_and_clear();
            say!("{}", campaign_table(&campaign))?;
            match campaign.failed.first() {
                Some((run, why)) => Err(CommandError::failed(format!("run {run}: {why}"))),
                None => Ok(()),
            }
        }
        None if arguments.precautions => {
            say!("{}", precautions_table(&checkout::precautions(&unit).map_err(CommandError::failed)?))
        }
        None => twice(&unit, by, out, arguments.force),
    }
}

/// Flies the sequence twice, compares and combines.
fn twice(unit: &Configuration, by: AttitudeSourceKind, out: Option<&Path>, force: Force) -> Result<(), CommandError> {
    let first = sequence(unit, Precautions::ALL);
    // Flown at once by the same unit, with other noise, at another ψ₀ and with other phases of the limit cycle.
    let mut second = sequence(&checkout::drawn(unit, unit.seed, 0), Precautions::ALL);
    second.gyros = first.gyros.clone();
    if let Some(directory) = out {
        let destination = Destination::new(directory, force.force);
        let mut recorder = Recorder::create(&destination, &first, &Truth::Scenario, LinkLogFormat::Can, &[])?;
        let samples = fly_length(&first);
        simulate(&first, &Truth::Scenario, samples, &mut recorder, |_| true).map_err(CommandError::failed)?;
        recorder.finish().map_err(CommandError::failed)?;
    }
    let solve = |configuration: &Configuration| -> Result<Solution, CommandError> {
        let calibrated =
            fly(configuration).calibrate(&believed_before(configuration), by).map_err(CommandError::failed)?;
        Ok(calibrated.solution)
    };
    let (one, two) = (solve(&first)?, solve(&second)?);
    let comparison = combine(&one, &two).map_err(CommandError::failed)?;
    say!("{}", twice_table(&values(&true_calibrations(&first)), [&one, &two], &comparison))?;
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
    geu_model::attitude::AttitudeProfile::length_s(&configuration.scenario)
        .map_or(0, |length_s| (length_s * 2.0).ceil() as u64)
}
