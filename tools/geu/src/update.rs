//! `geu calibrate --update`: scale factor and drift of the Z gyros between checkouts.

use std::path::PathBuf;

use clap::Args;
use geu_calibration::solve::{CalibrationParameter, values};
use geu_calibration::upkeep::{FORTNIGHT_S, PARAMETERS, summary};
use geu_calibration::window::ManoeuvreWindow;
use geu_calibration::{AccumulatedCounts, AttitudeSource, PriorAccuracy, PriorCalibration, report, update};
use geu_model::Configuration;
use geu_report::update::table;

use crate::failure::{CommandError, note, say};
use crate::outputs::{OutputFile, write_all};
use crate::settings::ConfigArgs;

/// What an update takes beside a calibration.
#[derive(Args, Debug)]
pub struct Update {
    /// Refine scale factor and drift of the Z gyros by survey scans, and say when a redetermination is due
    #[arg(long, conflicts_with_all = ["html", "compare"])]
    pub update: bool,
    /// With --update: when the believed values were determined [default: what --known tells, else a fortnight before]
    #[arg(long, value_name = "UNIX_SECONDS", allow_negative_numbers = true, requires = "update", value_parser = crate::settings::start)]
    calibrated: Option<f64>,
    /// With --update: JSON of the calibration or update that gave the believed values, for their sigmas
    #[arg(long, value_name = "FILE", requires = "update")]
    known: Option<PathBuf>,
}

/// Where results go.
pub struct Results<'a> {
    /// JSON.
    pub json: Option<&'a OutputFile>,
    /// Configuration.
    pub out: Option<&'a OutputFile>,
}

/// Carries it out.
///
/// # Errors
/// A recording without suitable scans, files that cannot be read or written.
pub fn run(
    arguments: &Update,
    (settings, configuration): (&ConfigArgs, &Configuration),
    counts: &AccumulatedCounts,
    legs: Option<&[ManoeuvreWindow]>,
    attitude: &AttitudeSource,
    results: &Results,
) -> Result<(), CommandError> {
    let known = known(arguments, counts)?;
    let upkeep = update(configuration, &known, counts, legs, attitude).map_err(CommandError::input)?;
    for line in summary(&upkeep.left_out) {
        note(format_args!("geu: left out: {line}\n"));
    }
    let mut outputs: Vec<_> = results.json.map(|file| (file, format!("{:#}\n", upkeep.json()))).into_iter().collect();
    if let Some(file) = results.out {
        let (name, text) = settings.text()?;
        let mut values = settings.overrides.clone();
        values.extend(report::overrides_of(PARAMETERS, &upkeep.calibrations));
        outputs.push((file, Configuration::edited(&name, &text, &values).map_err(CommandError::input)?));
    }
    write_all(outputs)?;
    say!("{}", table(&upkeep))
}

/// How well the believed values are known, and since when; what is assumed is said.
fn known(arguments: &Update, counts: &AccumulatedCounts) -> Result<PriorAccuracy, CommandError> {
    let start_s = counts.start_ns as f64 * 1e-9;
    let mut known = PriorAccuracy::by_checkout(start_s - FORTNIGHT_S);
    let mut at_s = arguments.calibrated;
    if let Some(path) = &arguments.known {
        let name = path.display();
        let text = geu_recording::read_text(path).map_err(|error| {
            CommandError::input(format!(
                "{name}: cannot be read: {error}; expected JSON as `geu calibrate --json` writes it"
            ))
        })?;
        let told = PriorCalibration::parse(&name.to_string(), &text, &[]).map_err(CommandError::input)?;
        known.sigmas = values(&told.sigmas);
        if let Some((parameter, _)) = CalibrationParameter::all().zip(known.sigmas).find(|(_, sigma)| *sigma <= 0.0) {
            return Err(CommandError::input(format!(
                "{name}: {}: expected a sigma, as `geu calibrate --json` writes one, got none",
                parameter.label()
            )));
        }
        let json = serde_json::from_str::<serde_json::Value>(&text).ok();
        at_s = at_s.or_else(|| json?.get("time_s")?.as_f64());
    } else {
        note(format_args!(
            "geu: taken as known at the calibration: scale factors to {:.0} ppm, drifts to {:.0} arcsec/h, misalignments \
             to {:.0} arcsec, as a checkout gives them; --known FILE tells better\n",
            PriorAccuracy::BY_CHECKOUT[0] * 1e6,
            PriorAccuracy::BY_CHECKOUT[1] * 7200.0,
            PriorAccuracy::BY_CHECKOUT[2]
        ));
    }
    match at_s {
        Some(at_s) => known.at_s = at_s,
        None => note(format_args!(
            "geu: the calibration is taken as a fortnight older than the recording, at {:.0} s; --calibrated UNIX_SECONDS \
             tells better\n",
            known.at_s
        )),
    }
    Ok(known)
}
