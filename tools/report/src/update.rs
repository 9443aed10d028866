//! An update of the Z gyros between checkouts, as a table for a terminal.

use std::fmt::Write;

use geu_calibration::CalibrationUpdate;
use geu_calibration::compare::MIN_PROBABILITY;
use geu_calibration::update::{
    BEYOND_SIGMAS, DRIFT_PER_FORTNIGHT, GYROS, ParameterUpdate, SCALE_FACTOR_PER_FORTNIGHT, SCALE_FACTOR_PER_HALF_HOUR,
};
use geu_model::units::S_PER_DAY;

use crate::calendar::utc;
use crate::text_table::text_table;

/// Decimals of a value, and factor and unit of its changes: scale factors are ratios with changes in ppm, drifts in arcsec/h.
fn scale(change: &ParameterUpdate) -> (usize, f64, &'static str) {
    if change.parameter.index == 0 { (7, 1e6, "ppm") } else { (6, 7200.0, "arcsec/h") }
}

/// The result for a terminal.
pub fn table(update: &CalibrationUpdate) -> String {
    let rows = update.changes.iter().map(|change| {
        let (decimals, size, unit) = scale(change);
        let verdict = if change.is_beyond_stability() {
            "more than stability allows"
        } else if !change.is_observable() {
            "not observable by the scans"
        } else if change.is_significant() {
            "changed"
        } else {
            "the same within 3 sigma"
        };
        [
            change.parameter.label(),
            format!("{:.decimals$}", change.old),
            format!("{:.decimals$}", change.new),
            format!("{:.3}", change.old_sigma * size),
            format!("{:.3}", change.new_sigma * size),
            format!("{:+.3}", change.change() * size),
            format!("{:.3}", change.allowed * size),
            unit.to_owned(),
            format!("{:+.1}", change.change() / change.new_sigma),
            format!("{:+.1}", change.beyond_stability()),
            verdict.to_owned(),
        ]
    });
    let header = [
        "parameter",
        "old",
        "new",
        "old sigma",
        "new sigma",
        "change",
        "allowed",
        "unit",
        "change/σ",
        "surprise/σ",
        "verdict",
    ];
    let mut text = text_table("<20 >12 >12 >10 >10 >8 >8  <9 >8 >10  <0", header, rows);
    let _ = writeln!(
        text,
        "old sigma: that of the calibration, increased by the stability figures and the configured random walk; drifts in arcsec \
         per sample, new at the end of the scans; surprise: the change over the expected sigma"
    );
    used(&mut text, update);
    let _ = writeln!(
        text,
        "χ² {:.1} of {} equations, probability {:.2}; electronics over the scans {:+.1} K from the calibration's",
        update.chi2,
        update.degrees_of_freedom,
        update.probability(),
        update.electronics_above_k
    );
    for (index, gyro) in GYROS.iter().enumerate() {
        let rho = update.correlation[(2 * index, 2 * index + 1)];
        let drift = &update.changes[2 * index + 1];
        if !drift.is_observable() {
            let _ = writeln!(
                text,
                "{}: the scans do not separate drift and scale factor (correlation {rho:+.2}); the drift stays near its prior \
                 value. Rests of {:.0} s or more would separate them",
                gyro.name(),
                geu_calibration::update::SHORTEST_S
            );
        }
    }
    due(&mut text, update);
    if update.probability() < MIN_PROBABILITY && !update.needs_checkout() {
        let _ = writeln!(
            text,
            "the scans contradict each other or the prior calibration; the unit has an effect that the configuration lacks, or counts or fixes are wrong"
        );
    }
    text.truncate(text.trim_end().len());
    text
}

/// The intervals that were used.
fn used(text: &mut String, update: &CalibrationUpdate) {
    let summary = |is_scan: bool| {
        let own: Vec<_> = update.used.iter().filter(|used| used.is_scan() == is_scan).collect();
        let length_s: f64 = own.iter().map(|used| used.end_s - used.start_s).sum();
        let rates = own.iter().map(|used| used.rate_z_arcsec_s);
        let (min, max) = (rates.clone().fold(f64::INFINITY, f64::min), rates.fold(f64::NEG_INFINITY, f64::max));
        (own.len(), length_s / 3600.0, format!("{min:.1}…{max:.1} arcsec/s"))
    };
    let (scans, length_h, rates) = summary(true);
    let _ = write!(
        text,
        "used: {scans} scan{} of {length_h:.2} h in all at {rates} about Z",
        if scans == 1 { "" } else { "s" }
    );
    let (rests, length_h, rates) = summary(false);
    let _ = match rests {
        0 => writeln!(text, "; no rest or slower interval"),
        1 => writeln!(text, "; 1 slower interval of {length_h:.2} h at {rates}"),
        _ => writeln!(text, "; {rests} slower intervals of {length_h:.2} h at {rates}"),
    };
}

/// Due times of a redetermination, a line for each of the paper's figures.
fn due(text: &mut String, update: &CalibrationUpdate) {
    let in_days = |due_in_s: f64| match due_in_s {
        due_in_s if due_in_s > 0.0 => {
            format!("in {:.1} d, {}", due_in_s / S_PER_DAY, utc(update.at_s + due_in_s))
        }
        _ => "now, more scans are needed".to_owned(),
    };
    let _ = writeln!(text, "\nredetermination due, counted from the end of the scans, {}:", utc(update.at_s));
    let labels = [
        format!("long-term scale factor (0.004 %/month, {:.1} ppm in a fortnight)", SCALE_FACTOR_PER_FORTNIGHT * 1e6),
        format!("drift ({:.0} arcsec/h in a fortnight)", DRIFT_PER_FORTNIGHT * 7200.0),
    ];
    for (kind, label) in labels.iter().enumerate() {
        let own = update.changes.iter().filter(|change| change.parameter.index == kind).map(|change| {
            let (_, size, unit) = scale(change);
            let (gyro, sigma) = (change.parameter.gyro.name(), change.new_sigma * size);
            format!("{gyro}, known to {sigma:.1} {unit}, {}", in_days(change.due_in_s))
        });
        let _ = writeln!(text, "  {label}: {}", own.collect::<Vec<_>>().join("; "));
    }
    let short = GYROS.iter().zip(&update.short_term).filter(|(_, short)| short.pairs > 0).map(|(gyro, short)| {
        let verdict = if short.is_exceeded() { "exceeded" } else { "kept" };
        let (rms, expected_rms) = (short.rms * 1e6, short.expected_rms * 1e6);
        format!(
            "{} {verdict}, {rms:.1} ppm rms between successive scans, noise explains {expected_rms:.1}",
            gyro.name()
        )
    });
    let short = short.collect::<Vec<_>>().join("; ");
    if !short.is_empty() {
        let allowed = SCALE_FACTOR_PER_HALF_HOUR * 1e6;
        let _ = writeln!(text, "  short-term scale factor (0.002 %, {allowed:.0} ppm, per 30 min): {short}");
    }
    let _ = writeln!(text, "  next update (once every two weeks, Casteren §3.2): {}", in_days(update.due_in_s()));
    for change in update.changes.iter().filter(|change| change.is_beyond_stability()) {
        let (_, size, unit) = scale(change);
        let _ = writeln!(
            text,
            "a full checkout is due now: {} changed by {:+.1} {unit}, {:.1} sigma of the stability figures ({:.1} allowed \
             since the calibration); more than {BEYOND_SIGMAS:.0} means that the gyro has changed",
            change.parameter.label(),
            change.change() * size,
            change.beyond_stability().abs(),
            change.allowed * size
        );
    }
    for (gyro, short) in GYROS.iter().zip(&update.short_term).filter(|(_, short)| short.is_exceeded()) {
        let _ = writeln!(
            text,
            "a full checkout is due now: {} does not hold its scale factor from scan to scan, {:.1} ppm beyond noise",
            gyro.name(),
            short.excess() * 1e6
        );
    }
}
