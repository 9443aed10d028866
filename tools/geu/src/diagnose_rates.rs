//! `geu diagnose --gyro-csv`: rates of any gyros against an independent rate.

mod windows;

use std::path::Path;

use geu_diagnosis::Finding;
use geu_diagnosis::rates::{Verdict, diagnose};
use geu_recording::{GyroCsv, GyroCsvSpec, RateTable, read_text};
use geu_report::rates;

use crate::failure::{CommandError, say};
use crate::outputs::OutputFile;

/// What it takes.
#[derive(Debug, Clone, Copy)]
pub struct RatesArguments<'a> {
    /// The description.
    pub gyro_csv: &'a Path,
    /// CSV of gyros; several are read one by one, each a group of its own.
    pub link: &'a [String],
    /// Independent rates: CSV with t_s and rates, or the table that the description tells.
    pub reference: &'a String,
    /// Seed of the noise from which thresholds are made.
    pub seed: u64,
    /// Where the result goes as JSON.
    pub json: Option<&'a OutputFile>,
}

/// Carries it out.
///
/// # Errors
/// Input that cannot be read or does not suffice, a file that cannot be written, an end unexplained.
pub fn run(arguments: &RatesArguments) -> Result<(), CommandError> {
    let name = arguments.gyro_csv.display().to_string();
    let text = read_text(arguments.gyro_csv).map_err(|error| {
        CommandError::input(format!(
            "{name}: cannot be read: {error}; expected a description, such as configs/suchai3.toml"
        ))
    })?;
    let description = GyroCsvSpec::parse(&name, &text).map_err(CommandError::input)?;
    let read = |link: &String| GyroCsv::read(link, description.clone()).map_err(CommandError::input);
    let links = arguments.link.iter().map(read).collect::<Result<Vec<_>, _>>()?;
    let findings: Vec<Finding> =
        arguments.link.iter().zip(&links).flat_map(|(link, read)| of_link(link, read)).collect();
    let table = RateTable::read(arguments.reference, description.reference.as_ref()).map_err(CommandError::input)?;
    let windows = windows::windows(arguments, &description, &links, &table)?;
    let failed = |error| CommandError::input(format!("{}: {error}", arguments.reference));
    let diagnosis = diagnose(&windows, arguments.seed).map_err(failed)?;
    if let Some(file) = arguments.json {
        file.write(format!("{:#}\n", rates::json(&diagnosis, &findings)))?;
    }
    // Said of the table described; rows with times are another reference.
    let is_described = table.rows.iter().all(|row| row.t_s.is_none());
    let described = description.reference.as_ref().filter(|_| is_described);
    let caveat = described.and_then(|reference| reference.caveat.as_deref());
    say!("{}", rates::text(&diagnosis, &findings, caveat))?;
    match diagnosis.verdict {
        Verdict::Unexplained => Err(CommandError::unexplained()),
        _ => Ok(()),
    }
}

/// What is wrong with a file of gyros.
fn of_link(link: &str, read: &GyroCsv) -> Vec<Finding> {
    let finding = |defect: &geu_recording::GyroCsvDefect| Finding {
        kind: defect.kind.name().to_owned(),
        place: format!("{link}: line {}", defect.line),
        text: defect.kind.to_string(),
    };
    read.defects.iter().map(finding).collect()
}
