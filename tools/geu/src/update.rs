//! `geu calibrate --update`: scale factor and drift of the Z gyros between checkouts.

use std::path::PathBuf;

use clap::Args;
use geu_calibration::solve::{CalibrationParameter, values};
use geu_calibration::update::{FORTNIGHT_S, PARAMETERS, summary};
use geu_calibration::window::ManoeuvreWindow;
use geu_calibration::{AccumulatedCounts, AttitudeSource, PriorAccuracy, PriorCalibration, report, update};
use geu_model::Configuration;
use geu_report::update::table;

use crate::calibrate_compare::EXPECTED_JSON;
use crate::command_error::{CommandError, note, say};
use crate::outputs::{OutputFile, write_all};
use crate::settings::{ConfigArgs, read_text};

/// Options of an update.
#[derive(Args, Debug)]
pub struct Update {
    /// Refine scale factor and drift of the Z gyros by survey scans, and report when a redetermination is due
    #[arg(long, conflicts_with_all = ["html", "compare"])]
    pub update: bool,
    /// With --update: time of the prior calibration [default: that of --known, else a fortnight before]
    #[arg(long, value_name = "UNIX_SECONDS", allow_negative_numbers = true, requires = "update", value_parser = crate::settings::start)]
    calibrated: Option<f64>,
    /// With --update: JSON of the prior calibration or update, for its sigmas
    #[arg(long, value_name = "FILE", requires = "update")]
    known: Option<PathBuf>,
}

/// Runs the update, and writes its result as JSON and as a configuration.
///
/// # Errors
/// The recording has no suitable scans, a file cannot be read or written.
pub fn run(
    arguments: &Update,
    (settings, configuration): (&ConfigArgs, &Configuration),
    counts: &AccumulatedCounts,
    legs: Option<&[ManoeuvreWindow]>,
    attitude: &AttitudeSource,
    (json, out): (Option<&OutputFile>, Option<&OutputFile>),
) -> Result<(), CommandError> {
    let known = known(arguments, counts)?;
    let updated = update(configuration, &known, counts, legs, attitude).map_err(CommandError::input)?;
    for line in summary(&updated.left_out) {
        note(format_args!("geu: left out: {line}\n"));
    }
    let mut outputs: Vec<_> = json.map(|file| (file, format!("{:#}\n", updated.json()))).into_iter().collect();
    if let Some(file) = out {
        outputs.push((file, settings.edited(report::overrides(PARAMETERS, &updated.calibrations))?));
    }
    write_all(outputs)?;
    say!("{}", table(&updated))
}

/// Accuracy and time of the prior calibration; assumed values are printed.
fn known(arguments: &Update, counts: &AccumulatedCounts) -> Result<PriorAccuracy, CommandError> {
    let start_s = counts.start_ns as f64 * 1e-9;
    let mut known = PriorAccuracy::after_checkout(start_s - FORTNIGHT_S);
    let mut at_s = arguments.calibrated;
    if let Some(path) = &arguments.known {
        let name = path.display();
        let text = read_text(path, EXPECTED_JSON)?;
        let prior = PriorCalibration::parse(&name.to_string(), &text, &[]).map_err(CommandError::input)?;
        known.sigmas = values(&prior.sigmas);
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
            "geu: assumed accuracy of the calibration: scale factors {:.0} ppm, drifts {:.0} arcsec/h, misalignments \
             {:.0} arcsec, as after a checkout; --known FILE gives its sigmas\n",
            PriorAccuracy::AFTER_CHECKOUT[0] * 1e6,
            PriorAccuracy::AFTER_CHECKOUT[1] * 7200.0,
            PriorAccuracy::AFTER_CHECKOUT[2]
        ));
    }
    match at_s {
        Some(at_s) => known.at_s = at_s,
        None => note(format_args!(
            "geu: assumed time of the calibration: a fortnight before the recording, at {:.0} s; --calibrated UNIX_SECONDS \
             sets it\n",
            known.at_s
        )),
    }
    Ok(known)
}
