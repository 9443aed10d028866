//! `geu diagnose --gyro-csv`: rates of any gyros against an independent rate.

mod windows;

use std::path::Path;

use geu_checks::Finding;
use geu_rates::{Verdict, diagnose};
use geu_recording::{GyroCsv, RateTable};
use geu_report::rates;

use crate::command_error::{CommandError, say};
use crate::gyro_csv;
use crate::outputs::OutputFile;

/// Arguments of `geu diagnose --gyro-csv`.
#[derive(Debug, Clone, Copy)]
pub struct RatesArguments<'a> {
    /// The description.
    pub gyro_csv: &'a Path,
    /// CSV of gyros; each is a separate group.
    pub link: &'a [String],
    /// Independent rates: CSV with t_s and rates, or the table of the description.
    pub reference: &'a String,
    /// Seed of the noise that sets the thresholds.
    pub seed: u64,
    /// Result as JSON.
    pub json: Option<&'a OutputFile>,
}

/// Runs the diagnosis of rates.
///
/// # Errors
/// An input cannot be read or is too short, a file cannot be written, the residual is not explained.
pub fn run(arguments: &RatesArguments) -> Result<(), CommandError> {
    let description = gyro_csv::description(arguments.gyro_csv)?;
    let read = |link: &String| GyroCsv::read(link, description.clone()).map_err(CommandError::input);
    let links = arguments.link.iter().map(read).collect::<Result<Vec<_>, _>>()?;
    let findings: Vec<Finding> =
        arguments.link.iter().zip(&links).flat_map(|(link, read)| findings(link, read)).collect();
    let table = RateTable::read(arguments.reference, description.reference.as_ref()).map_err(CommandError::input)?;
    let windows = windows::windows(arguments, &description, &links, &table)?;
    let failed = |error| CommandError::input(format!("{}: {error}", arguments.reference));
    let diagnosis = diagnose(&windows, arguments.seed).map_err(failed)?;
    if let Some(file) = arguments.json {
        file.write(format!("{:#}\n", rates::json(&diagnosis, &findings)))?;
    }
    // The caveat is on the described table; rows with times are another reference.
    let is_described = table.rows.iter().all(|row| row.t_s.is_none());
    let described = description.reference.as_ref().filter(|_| is_described);
    let caveat = described.and_then(|reference| reference.caveat.as_deref());
    say!("{}", rates::text(&diagnosis, &findings, caveat))?;
    match diagnosis.verdict {
        Verdict::Unexplained => Err(CommandError::unexplained()),
        _ => Ok(()),
    }
}

/// Defects of a file of gyros as findings.
fn findings(link: &str, read: &GyroCsv) -> Vec<Finding> {
    let finding = |defect: &geu_recording::GyroCsvDefect| Finding {
        kind: defect.kind.name().to_owned(),
        place: format!("{link}: line {}", defect.line),
        text: defect.kind.to_string(),
    };
    read.defects.iter().map(finding).collect()
}
