//! `geu checkout`: simulates the in-orbit checkout, calibrates it and compares with the truth.

use std::path::Path;

use clap::Args;
use geu_calibration::checkout::{self, AttitudeSourceKind, Precautions, before_checkout, sequence, true_calibrations};
use geu_calibration::combine;
use geu_calibration::compare::MIN_PROBABILITY;
use geu_calibration::solve::{Solution, values};
use geu_model::Configuration;
use geu_model::attitude::AttitudeProfile;
use geu_recorder::{Destination, FILES, record};
use geu_report::checkout::{campaign_table, precautions_table, twice_table};

use crate::command_error::{CommandError, note, say};
use crate::output_guard::Force;
use crate::outputs::OutputDirectory;
use crate::settings::{ConfigArgs, NamedConfigArgs, choice, seed};

/// Simulates the in-orbit checkout, calibrates it and compares with the truth.
///
/// The sequence is that of configs/checkout.toml, about fourteen hours; it is simulated twice, and the two results are
/// compared and combined. The calibration parameters have no prior values; the unit's noise and other effects are known.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    unit: NamedConfigArgs,
    /// Source of the attitude
    #[arg(long, default_value = "absolute", value_parser = choice(ATTITUDES))]
    attitude: AttitudeSourceKind,
    /// Simulate N checkouts with different units, ψ₀ and limit cycles, and compare scatter with prediction
    #[arg(long, value_name = "N", conflicts_with_all = ["precautions", "out"], value_parser = clap::value_parser!(u32).range(1..))]
    runs: Option<u32>,
    /// Print the benefit of each precaution of Casteren §5 [default unit: the reference unit with pivots of 14 arcsec and
    /// a thermal misalignment of 0.5 arcsec/deg]
    #[arg(long, conflicts_with = "out")]
    precautions: bool,
    /// Directory for the recording of the first checkout, as `geu simulate` writes it
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

const ATTITUDES: &[(&str, AttitudeSourceKind, &str)] = &[
    ("absolute", AttitudeSourceKind::Sensors, "FSS and SSE"),
    ("reference", AttitudeSourceKind::Reference, "The true attitude"),
];

/// The effects that the precautions reduce, at the paper's values.
const PRECAUTION_EFFECTS: [&str; 5] = [
    "unit.misalignment-thermal={ arcsec_per_deg = 0.5, time_constant_s = 300.0 }",
    "gyro.GYRX.pivot-clearance.clearance_arcsec=14",
    "gyro.GYRY.pivot-clearance.clearance_arcsec=14",
    "gyro.GYRZA.pivot-clearance.clearance_arcsec=14",
    "gyro.GYRZB.pivot-clearance.clearance_arcsec=14",
];

/// Runs `geu checkout`.
///
/// # Errors
/// The configuration cannot be read, a checkout cannot be calibrated, a file cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let out = arguments.out.as_ref().map(|out| out.prepare(arguments.force, FILES)).transpose()?;
    let settings = ConfigArgs::from(&arguments.unit);
    let mut unit = if arguments.precautions && settings.config.is_none() {
        let overrides = PRECAUTION_EFFECTS.into_iter().map(str::to_owned).chain(settings.overrides.clone());
        Configuration::reference_with(&overrides.collect::<Vec<_>>()).map_err(CommandError::input)?
    } else {
        settings.read()?
    };
    unit.seed = arguments.seed.unwrap_or(unit.seed);
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global().map_err(CommandError::failed)?;
    }
    let by = arguments.attitude;
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

/// Simulates the sequence twice, compares and combines the results.
fn twice(unit: &Configuration, by: AttitudeSourceKind, out: Option<&Path>, force: Force) -> Result<(), CommandError> {
    let first = sequence(unit, Precautions::ALL);
    // The same unit with other noise, another ψ₀ and other phases of the limit cycle.
    let mut second = sequence(&checkout::drawn(unit, unit.seed, 0), Precautions::ALL);
    second.gyros = first.gyros.clone();
    if let Some(directory) = out {
        let samples = AttitudeProfile::length_s(&first.scenario).map_or(0, |length_s| (length_s * 2.0).ceil() as u64);
        record(&Destination::new(directory, force.force), &first, samples)?;
    }
    let solve = |configuration: &Configuration| -> Result<Solution, CommandError> {
        let calibrated = checkout::simulate(configuration)
            .calibrate(&before_checkout(configuration), by)
            .map_err(CommandError::failed)?;
        Ok(calibrated.solution)
    };
    let (one, two) = (solve(&first)?, solve(&second)?);
    let comparison = combine(&one, &two).map_err(CommandError::failed)?;
    say!("{}", twice_table(&values(&true_calibrations(&first)), [&one, &two], &comparison))?;
    for (which, solution) in [("first", &one), ("second", &two)] {
        if solution.probability() < MIN_PROBABILITY {
            note(format_args!(
                "geu: the calibration parameters do not explain the {which} checkout, probability {:.1e}: its sigmas are too small\n",
                solution.probability()
            ));
        }
    }
    Ok(())
}
