//! An update of the Z gyros between checkouts, as a table for a terminal.

use geu_calibration::CalibrationUpdate;
use geu_calibration::compare::MIN_PROBABILITY;
use geu_calibration::update::{
    BEYOND_SIGMAS, DRIFT_PER_FORTNIGHT, GYROS, SCALE_FACTOR_PER_FORTNIGHT, SCALE_FACTOR_PER_HALF_HOUR,
};
use geu_model::units::S_PER_DAY;
use geu_protocol::map;
use geu_protocol::template::{Value, engine, filled};

use crate::calendar::utc;
use crate::calibration::sigma_unit;
use crate::text_table::text_table;

/// The result for a terminal.
pub fn table(update: &CalibrationUpdate) -> String {
    let rows = update.changes.iter().map(|change| {
        let (size, unit) = sigma_unit(change.parameter);
        let decimals = if change.parameter.index == 0 { 7 } else { 6 };
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
    let table = text_table("<20 >12 >12 >10 >10 >8 >8  <9 >8 >10  <0", header, rows);
    let inseparable = GYROS.iter().enumerate().filter(|(index, _)| !update.changes[2 * index + 1].is_observable());
    let inseparable = inseparable
        .map(|(index, gyro)| map! { gyro: gyro.name(), rho: update.correlation[(2 * index, 2 * index + 1)] });
    let values = map! {
        table: table,
        scans: used(update, true),
        rests: used(update, false),
        chi2: update.chi2,
        freedom: update.degrees_of_freedom as u32,
        probability: update.probability(),
        electronics: update.electronics_above_k,
        inseparable: inseparable.collect::<Value>(),
        shortest_s: geu_calibration::update::SHORTEST_S,
        scale_factor_ppm: SCALE_FACTOR_PER_FORTNIGHT * 1e6,
        drift: DRIFT_PER_FORTNIGHT * 7200.0,
        short_ppm: SCALE_FACTOR_PER_HALF_HOUR * 1e6,
        due: due(update),
        max_sigmas: BEYOND_SIGMAS,
        is_contradictory: update.probability() < MIN_PROBABILITY && !update.needs_checkout(),
    };
    filled(&engine(), include_str!("update.txt"), &values).trim_end().to_owned()
}

/// The intervals that were used, scans or rests.
fn used(update: &CalibrationUpdate, is_scan: bool) -> Value {
    let own: Vec<_> = update.used.iter().filter(|used| used.is_scan() == is_scan).collect();
    let length_s: f64 = own.iter().map(|used| used.end_s - used.start_s).sum();
    let rates = own.iter().map(|used| used.rate_z_arcsec_s);
    let (min, max) = (rates.clone().fold(f64::INFINITY, f64::min), rates.fold(f64::NEG_INFINITY, f64::max));
    map! { count: own.len() as u32, is_one: own.len() == 1, length_h: length_s / 3600.0, min: min, max: max }
}

/// Due times of a redetermination.
fn due(update: &CalibrationUpdate) -> Value {
    let in_days = |due_in_s: f64| match due_in_s {
        due_in_s if due_in_s > 0.0 => {
            format!("in {:.1} d, {}", due_in_s / S_PER_DAY, utc(update.at_s + due_in_s))
        }
        _ => "now, more scans are needed".to_owned(),
    };
    let known = |kind: usize| -> Value {
        let own = update.changes.iter().filter(|change| change.parameter.index == kind).map(|change| {
            let (size, unit) = sigma_unit(change.parameter);
            map! { gyro: change.parameter.gyro.name(), sigma: change.new_sigma * size, unit: unit,
            due: in_days(change.due_in_s) }
        });
        own.collect()
    };
    let short = GYROS.iter().zip(&update.short_term).filter(|(_, short)| short.pairs > 0).map(|(gyro, short)| {
        map! { gyro: gyro.name(), is_exceeded: short.is_exceeded(), rms: short.rms * 1e6,
        expected: short.expected_rms * 1e6, excess: short.excess() * 1e6 }
    });
    let beyond = update.changes.iter().filter(|change| change.is_beyond_stability()).map(|change| {
        let (size, unit) = sigma_unit(change.parameter);
        map! { label: change.parameter.label(), change: change.change() * size, unit: unit,
        beyond: change.beyond_stability().abs(), allowed: change.allowed * size }
    });
    map! {
        end: utc(update.at_s),
        scale_factors: known(0),
        drifts: known(1),
        short: short.collect::<Value>(),
        next: in_days(update.due_in_s()),
        beyond: beyond.collect::<Value>(),
    }
}
