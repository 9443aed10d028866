//! `geu calibrate --compare`: this calibration beside earlier ones of the unit.

use std::path::Path;

use geu_calibration::solve::Solution;
use geu_calibration::{Calibrated, Comparison, PreviousCalibration, compare as compare_solutions, report};

use crate::command_error::CommandError;
use crate::settings::read_text;

pub const EXPECTED_JSON: &str = "JSON as `geu calibrate --json` writes it";
/// Two results are the same if all values agree to this: JSON keeps all bits but the last, two recordings never agree so well.
const RELATIVE_TOLERANCE: f64 = 1e-12;

/// Reads earlier results, in the order of time.
///
/// # Errors
/// A file cannot be read, is not JSON, or lacks values for a comparison.
pub fn read(names: &[String]) -> Result<Vec<PreviousCalibration>, CommandError> {
    let read = |name: &String| {
        let text = read_text(Path::new(name), EXPECTED_JSON)?;
        let json = serde_json::from_str(&text)
            .map_err(|error| CommandError::input(format!("{name}: {error}; expected {EXPECTED_JSON}")))?;
        report::earlier(name, &json).map_err(|error| CommandError::input(format!("{name}: {error}")))
    };
    let mut earlier = names.iter().map(read).collect::<Result<Vec<_>, _>>()?;
    earlier.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    Ok(earlier)
}

/// Compares a calibration with earlier ones.
///
/// # Errors
/// Two results are of the same recording, or a covariance is not positive definite.
pub fn compare(earlier: &[PreviousCalibration], calibrated: &Calibrated) -> Result<Option<Comparison>, CommandError> {
    let present = ("this calibration", &calibrated.solution);
    let all: Vec<(&str, &Solution)> =
        earlier.iter().map(|one| (one.name.as_str(), &one.solution)).chain([present]).collect();
    for (index, (name, solution)) in all.iter().enumerate() {
        if let Some((other, _)) = all[..index].iter().find(|(_, other)| is_same(other, solution)) {
            return Err(CommandError::input(format!(
                "--compare: expected calibrations of different recordings, got the same in {other} and {name}"
            )));
        }
    }
    let later: Vec<&Solution> = all[1..].iter().map(|(_, solution)| *solution).collect();
    compare_solutions(all[0].1, &later).map_err(|error| CommandError::input(format!("--compare: {error}")))
}

fn is_same(one: &Solution, other: &Solution) -> bool {
    one.values().into_iter().zip(other.values()).all(|(a, b)| (a - b).abs() <= RELATIVE_TOLERANCE * b.abs())
}
