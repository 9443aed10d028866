//! Simulated checkouts as tables for a terminal.

use std::fmt::Write;

use geu_calibration::Comparison;
use geu_calibration::checkout::{MonteCarlo, PrecautionResult};
use geu_calibration::solve::{CalibrationParameter, Solution, UNKNOWNS};
use geu_protocol::Gyro;

use crate::calibration::sigma_unit;
use crate::text_table::text_table;

/// Two checkouts of one unit against the truth, and their combination.
pub fn twice_table(truth: &[f64; UNKNOWNS], [one, two]: [&Solution; 2], comparison: &Comparison) -> String {
    let (firsts, seconds, both) = (one.values(), two.values(), comparison.combined.values());
    let sigmas = [one.sigmas(), two.sigmas(), comparison.combined.sigmas()];
    let rows = CalibrationParameter::all().enumerate().map(|(index, parameter)| {
        let size = sigma_unit(parameter).0;
        let error = |value: f64, sigma: f64| format!("{:+.2} ± {:.2}", (value - truth[index]) * size, sigma * size);
        [
            parameter.label(),
            format!("{:.6}", truth[index]),
            error(firsts[index], sigmas[0][index]),
            error(seconds[index], sigmas[1][index]),
            format!("{:.2}", comparison.chi2[index]),
            error(both[index], sigmas[2][index]),
            format!("{:+.1}", (both[index] - truth[index]) / sigmas[2][index]),
        ]
    });
    let header = ["parameter", "truth", "first − truth", "second − truth", "χ²", "both − truth", "in sigma"];
    let mut text = text_table("<22 >12  >16 >16 >7  >16 >8", header, rows);
    let _ = write!(
        text,
        "scale factors in ppm, drifts in arcsec/h, misalignments in arcsec\n\
         spare equations: χ² {:.1} of {} and {:.1} of {}; the two differ by χ² {:.1} of {UNKNOWNS}, probability {:.2}: {}",
        one.chi2,
        one.degrees_of_freedom,
        two.chi2,
        two.degrees_of_freedom,
        comparison.joint_chi2,
        comparison.joint_probability(),
        if comparison.is_compatible() { "compatible" } else { "not compatible" },
    );
    text
}

/// A campaign for a terminal.
pub fn campaign_table(campaign: &MonteCarlo) -> String {
    let rows = campaign.scatter.iter().enumerate().map(|(index, found)| {
        let (size, unit) = sigma_unit(found.parameter);
        [
            found.parameter.label(),
            unit.to_owned(),
            format!("{:.2}", found.rms_error * size),
            format!("{:.2}", found.sigma * size),
            format!("{:.3}", found.rms_error / found.sigma),
            format!("{:+.1}", found.mean_error / found.sigma * (campaign.runs as f64).sqrt()),
            format!("{:.1}%", found.coverage * 100.0),
            campaign.first_order_rms_error.map_or_else(|| "–".to_owned(), |hand| format!("{:.2}", hand[index] * size)),
        ]
    });
    let header = ["parameter", "unit", "rms error", "predicted", "ratio", "mean/σ√N", "coverage", "hand rms error"];
    let mut text = text_table("<22 >8 >10 >10 >8 >10 >10   >14", header, rows);
    let min = campaign.scatter.iter().map(|found| found.coverage).fold(1.0, f64::min);
    let max = campaign.scatter.iter().map(|found| found.coverage).fold(0.0, f64::max);
    let _ = write!(
        text,
        "{} runs; one sigma holds {:.1}…{:.1} % of the errors (68.3 expected); mean of the reduced χ² {:.3}",
        campaign.runs,
        min * 100.0,
        max * 100.0,
        campaign.mean_reduced_chi2
    );
    text
}

/// The precautions for a terminal.
pub fn precautions_table(outcomes: &[PrecautionResult]) -> String {
    let mut text = String::from("largest error of an equation with the true parameters, arcsec, and its manoeuvre\n");
    let names = Gyro::ALL.map(|gyro| format!("{:>16}", gyro.name())).join("");
    text += &format!("{:<46} {:>6} {names}\n", "", "hours");
    for outcome in outcomes {
        let errors =
            outcome.equation_arcsec.each_ref().map(|(arcsec, name)| format!("{arcsec:>+8.1} {name:<7}")).join("");
        text += &format!("{:<46} {:>6.1} {errors}\n", outcome.what, outcome.length_s / 3600.0);
    }
    text += "\nerror of the parameters: scale factors in ppm, drifts in arcsec/h, misalignments in arcsec\n";
    let row = |name: &str, cell: &dyn Fn(usize, &PrecautionResult) -> String, last: Option<String>| {
        let cells = outcomes.iter().enumerate().map(|(index, outcome)| cell(index, outcome));
        let cells = cells.chain(last).map(|cell| format!(" {cell:>9}"));
        format!("{name:<22}{}\n", cells.collect::<String>())
    };
    text += &row("", &|index, _| format!("({})", index + 1), Some("sigma".to_owned()));
    for (index, parameter) in CalibrationParameter::all().enumerate() {
        let size = sigma_unit(parameter).0;
        let sigma = outcomes.first().map_or(f64::NAN, |outcome| outcome.sigmas[index]);
        let error = |_, outcome: &PrecautionResult| format!("{:+.2}", outcome.errors[index] * size);
        text += &row(&parameter.label(), &error, Some(format!("{:.2}", sigma * size)));
    }
    text += &row("χ²", &|_, outcome| format!("{:.1}", outcome.chi2.0), None);
    text += &row("spare equations", &|_, outcome| outcome.chi2.1.to_string(), None);
    for (index, outcome) in outcomes.iter().enumerate() {
        text += &format!("({}) {}\n", index + 1, outcome.what);
    }
    text.truncate(text.trim_end().len());
    text
}
