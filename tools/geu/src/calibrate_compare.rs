//! `geu calibrate --compare`: this calibration beside earlier ones of the unit.

use std::fmt::Write;

use geu_calibration::compare::{LEAST_PROBABILITY, stability_per_day};
use geu_calibration::solve::{Parameter, Solution, UNKNOWNS};
use geu_calibration::{Calibrated, Comparison, Earlier, compare as compare_solutions, report};
use geu_report::calibration::{moved_words, sigma_unit};

use crate::failure::Failure;

/// JSON gives numbers back to the last bit or the one before; two recordings never agree so well.
const SAME: f64 = 1e-12;

/// Reads earlier results, and puts them in the order of time.
///
/// # Errors
/// A file that cannot be read, is no JSON, or lacks what a comparison needs.
pub fn read(names: &[String]) -> Result<Vec<Earlier>, Failure> {
    let one = |name: &String| {
        let expected = "expected JSON as `geu calibrate --json` writes it";
        let text = geu_recording::read_text(name.as_ref())
            .map_err(|error| Failure::input(format!("{name}: cannot be read: {error}; {expected}")))?;
        let json =
            serde_json::from_str(&text).map_err(|error| Failure::input(format!("{name}: {error}; {expected}")))?;
        report::earlier(name, &json).map_err(|error| Failure::input(format!("{name}: {error}")))
    };
    let mut earlier = names.iter().map(one).collect::<Result<Vec<_>, _>>()?;
    earlier.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    Ok(earlier)
}

/// Compares with them.
///
/// # Errors
/// Two results of one recording, covariances that are none.
pub fn compare(earlier: &[Earlier], calibrated: &Calibrated) -> Result<Option<Comparison>, Failure> {
    let present = ("this calibration", &calibrated.solution);
    let all: Vec<(&str, &Solution)> =
        earlier.iter().map(|one| (one.name.as_str(), &one.solution)).chain([present]).collect();
    for (index, (name, solution)) in all.iter().enumerate() {
        if let Some((other, _)) = all[..index].iter().find(|(_, other)| is_same(other, solution)) {
            return Err(Failure::input(format!(
                "--compare: expected calibrations of recordings of their own, got the same in {other} and {name}"
            )));
        }
    }
    let later: Vec<&Solution> = all[1..].iter().map(|(_, solution)| *solution).collect();
    compare_solutions(all[0].1, &later).map_err(|error| Failure::input(format!("--compare: {error}")))
}

fn is_same(one: &Solution, other: &Solution) -> bool {
    one.values().into_iter().zip(other.values()).all(|(a, b)| (a - b).abs() <= SAME * b.abs())
}

/// The comparison for a terminal.
pub fn table(earlier: &[Earlier], comparison: &Comparison) -> String {
    let names: Vec<&str> = earlier.iter().map(|one| one.name.as_str()).collect();
    let mut text = format!("less the mean of {}\n", names.join(", "));
    let _ = writeln!(
        text,
        "{:<26} {:>12} {:>12} {:<9} {:>9} {:>8} {:>12}  {:>22}",
        "parameter", "change", "sigma", "", "change/σ", "χ²", "probability", "stability a fortnight"
    );
    for (index, parameter) in Parameter::all().enumerate() {
        let (size, unit) = sigma_unit(parameter);
        let allowed = stability_per_day(parameter)
            .map_or_else(|| "–".to_owned(), |rate| format!("{:.1} {unit}", rate * 14.0 * size));
        let _ = writeln!(
            text,
            "{:<26} {:>+12.3} {:>12.3} {unit:<9} {:>+9.1} {:>8.1} {:>12.4}  {allowed:>22}",
            parameter.words(),
            comparison.change[index] * size,
            comparison.sigmas[index] * size,
            comparison.change[index] / comparison.sigmas[index],
            comparison.chi2[index],
            comparison.probability(index),
        );
    }
    let verdict = if comparison.is_compatible() {
        "compatible, merged".to_owned()
    } else {
        format!("not compatible, not merged: {}", moved_words(comparison))
    };
    let _ = write!(
        text,
        "\nχ² {:.1} of {}, probability {:.2} (least {LEAST_PROBABILITY}): {verdict}",
        comparison.together,
        UNKNOWNS * comparison.pairs,
        comparison.together_probability()
    );
    text
}
