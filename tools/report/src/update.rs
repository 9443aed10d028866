//! An update of the Z gyros between checkouts, as a table for a terminal.

use std::fmt::Write;

use geu_calibration::CalibrationUpdate;
use geu_calibration::compare::LEAST_PROBABILITY;
use geu_calibration::upkeep::{
    BEYOND_SIGMAS, DRIFT_PER_FORTNIGHT, GYROS, ParameterUpdate, SCALE_FACTOR_PER_FORTNIGHT, SCALE_FACTOR_PER_HALF_HOUR,
};
use geu_model::units::S_PER_DAY;

use crate::calendar::utc;

/// A value's unit and digits: scale factors relative with changes in ppm, drifts in arcsec/h.
fn told(change: &ParameterUpdate) -> (String, f64, &'static str) {
    match change.parameter.index {
        0 => (format!("{:>12.7} {:>12.7}", change.old, change.new), 1e6, "ppm"),
        _ => (format!("{:>12.6} {:>12.6}", change.old, change.new), 7200.0, "arcsec/h"),
    }
}

/// The result for a terminal.
pub fn table(upkeep: &CalibrationUpdate) -> String {
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{:<20} {:>12} {:>12} {:>10} {:>10} {:>8} {:>8}  {:<9} {:>8} {:>10}  verdict",
        "parameter", "old", "new", "old sigma", "new sigma", "change", "allowed", "unit", "change/σ", "surprise/σ"
    );
    for change in &upkeep.changes {
        let (values, size, unit) = told(change);
        let verdict = if change.is_beyond_stability() {
            "more than stability allows"
        } else if !change.is_observable() {
            "the scans tell little of it"
        } else if change.is_significant() {
            "changed"
        } else {
            "the same within 3 sigma"
        };
        let _ = writeln!(
            text,
            "{:<20} {values} {:>10.3} {:>10.3} {:>+8.3} {:>8.3}  {unit:<9} {:>+8.1} {:>+10.1}  {verdict}",
            change.parameter.label(),
            change.old_sigma * size,
            change.new_sigma * size,
            change.change() * size,
            change.allowed * size,
            change.change() / change.new_sigma,
            change.beyond_stability(),
        );
    }
    let _ = writeln!(
        text,
        "old sigma: the calibration's, aged by the stability figures and the configured walk; values of drifts in arcsec per half \
         second, new at the end of the scans; surprise: the change over what those sigmas explain"
    );
    used(&mut text, upkeep);
    let _ = writeln!(
        text,
        "χ² {:.1} of {} equations, probability {:.2}; electronics over the scans {:+.1} K from the calibration's",
        upkeep.chi2,
        upkeep.degrees_of_freedom,
        upkeep.probability(),
        upkeep.electronics_above_k
    );
    for (index, gyro) in GYROS.iter().enumerate() {
        let rho = upkeep.correlation[(2 * index, 2 * index + 1)];
        let [scale_factor, drift] = [0, 1].map(|of| &upkeep.changes[2 * index + of]);
        debug_assert!([scale_factor, drift].iter().all(|change| change.parameter.gyro == *gyro));
        if !drift.is_observable() {
            let _ = writeln!(
                text,
                "{}: the scans do not tell drift and scale factor apart (correlation {rho:+.2}); the drift is held near what \
                 was known. Rests of {:.0} s or more would part them",
                gyro.name(),
                geu_calibration::upkeep::SHORTEST_S
            );
        }
    }
    due(&mut text, upkeep);
    if upkeep.probability() < LEAST_PROBABILITY && !upkeep.needs_checkout() {
        let _ = writeln!(
            text,
            "the scans contradict each other or what was known; the unit has an effect that the configuration has not, or counts or fixes are wrong"
        );
    }
    text.truncate(text.trim_end().len());
    text
}

/// Which stretches were used.
fn used(text: &mut String, upkeep: &CalibrationUpdate) {
    let of = |is_scan: bool| {
        let own: Vec<_> = upkeep.used.iter().filter(|used| used.is_scan() == is_scan).collect();
        let length_s: f64 = own.iter().map(|used| used.end_s - used.start_s).sum();
        let rates = own.iter().map(|used| used.rate_z_arcsec_s);
        let (least, most) = (rates.clone().fold(f64::INFINITY, f64::min), rates.fold(f64::NEG_INFINITY, f64::max));
        (own.len(), length_s, least, most)
    };
    let (scans, length_s, least, most) = of(true);
    let _ = write!(
        text,
        "used: {scans} scan{} of {:.2} h in all at {least:.1}…{most:.1} arcsec/s about Z",
        if scans == 1 { "" } else { "s" },
        length_s / 3600.0
    );
    let (rests, length_s, least, most) = of(false);
    let _ = match rests {
        0 => writeln!(text, "; no rest or slower stretch"),
        _ => {
            writeln!(
                text,
                "; {rests} slower stretch{} of {:.2} h at {least:.1}…{most:.1} arcsec/s",
                if rests == 1 { "" } else { "es" },
                length_s / 3600.0
            )
        }
    };
}

/// When a redetermination is due, a line for each of the paper's figures.
fn due(text: &mut String, upkeep: &CalibrationUpdate) {
    let in_days = |due_in_s: f64| match due_in_s {
        due_in_s if due_in_s > 0.0 => {
            format!("in {:.1} d, {}", due_in_s / S_PER_DAY, utc(upkeep.at_s + due_in_s))
        }
        _ => "now, more scans are needed".to_owned(),
    };
    let _ = writeln!(text, "\nredetermination due, counted from the end of the scans, {}:", utc(upkeep.at_s));
    let words = [
        format!("long-term scale factor (0.004 %/month, {:.1} ppm in a fortnight)", SCALE_FACTOR_PER_FORTNIGHT * 1e6),
        format!("drift ({:.0} arcsec/h in a fortnight)", DRIFT_PER_FORTNIGHT * 7200.0),
    ];
    for (kind, what) in words.iter().enumerate() {
        let own = upkeep.changes.iter().filter(|change| change.parameter.index == kind).map(|change| {
            let (_, size, unit) = told(change);
            let (gyro, sigma) = (change.parameter.gyro.name(), change.new_sigma * size);
            format!("{gyro}, known to {sigma:.1} {unit}, {}", in_days(change.due_in_s))
        });
        let _ = writeln!(text, "  {what}: {}", own.collect::<Vec<_>>().join("; "));
    }
    let short = GYROS.iter().zip(&upkeep.short_term).filter(|(_, short)| short.pairs > 0).map(|(gyro, short)| {
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
    let _ = writeln!(text, "  next update (once every two weeks, Casteren §3.2): {}", in_days(upkeep.due_in_s()));
    for change in upkeep.changes.iter().filter(|change| change.is_beyond_stability()) {
        let (_, size, unit) = told(change);
        let _ = writeln!(
            text,
            "a full checkout is due now: {} changed by {:+.1} {unit}, {:.1} sigma of what stability explains ({:.1} allowed \
             since the calibration); more than {BEYOND_SIGMAS:.0} is another gyro than was calibrated",
            change.parameter.label(),
            change.change() * size,
            change.beyond_stability().abs(),
            change.allowed * size
        );
    }
    for (gyro, short) in GYROS.iter().zip(&upkeep.short_term).filter(|(_, short)| short.is_exceeded()) {
        let _ = writeln!(
            text,
            "a full checkout is due now: {} does not hold its scale factor from scan to scan, {:.1} ppm beyond noise",
            gyro.name(),
            short.excess() * 1e6
        );
    }
}
