//! `geu calibrate --compare`: this calibration beside earlier ones of the unit.

use geu_calibration::solve::Solution;
use geu_calibration::{Calibrated, Comparison, PreviousCalibration, compare as compare_solutions, report};

use crate::failure::CommandError;

/// JSON gives numbers back to the last bit or the one before; two recordings never agree so well.
const SAME: f64 = 1e-12;

/// Reads earlier results, and puts them in the order of time.
///
/// # Errors
/// A file that cannot be read, is no JSON, or lacks what a comparison needs.
pub fn read(names: &[String]) -> Result<Vec<PreviousCalibration>, CommandError> {
    let one = |name: &String| {
        let expected = "expected JSON as `geu calibrate --json` writes it";
        let text = geu_recording::read_text(name.as_ref())
            .map_err(|error| CommandError::input(format!("{name}: cannot be read: {error}; {expected}")))?;
        let json =
            serde_json::from_str(&text).map_err(|error| CommandError::input(format!("{name}: {error}; {expected}")))?;
        report::earlier(name, &json).map_err(|error| CommandError::input(format!("{name}: {error}")))
    };
    let mut earlier = names.iter().map(one).collect::<Result<Vec<_>, _>>()?;
    earlier.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    Ok(earlier)
}

/// Compares with them.
///
/// # Errors
/// Two results of one recording, covariances that are none.
pub fn compare(earlier: &[PreviousCalibration], calibrated: &Calibrated) -> Result<Option<Comparison>, CommandError> {
    let present = ("this calibration", &calibrated.solution);
    let all: Vec<(&str, &Solution)> =
        earlier.iter().map(|one| (one.name.as_str(), &one.solution)).chain([present]).collect();
    for (index, (name, solution)) in all.iter().enumerate() {
        if let Some((other, _)) = all[..index].iter().find(|(_, other)| is_same(other, solution)) {
            return Err(CommandError::input(format!(
                "--compare: expected calibrations of recordings of their own, got the same in {other} and {name}"
            )));
        }
    }
    let later: Vec<&Solution> = all[1..].iter().map(|(_, solution)| *solution).collect();
    compare_solutions(all[0].1, &later).map_err(|error| CommandError::input(format!("--compare: {error}")))
}

fn is_same(one: &Solution, other: &Solution) -> bool {
    one.values().into_iter().zip(other.values()).all(|(a, b)| (a - b).abs() <= SAME * b.abs())
}
