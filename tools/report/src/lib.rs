//! Results as pages, figures and tables: what `calibrate` and `diagnose` write as HTML, the figures of a unit as SVG, and rows
//! as CSV and JSON lines, and what evaluations print.

mod calendar;
pub mod calibration;
pub mod checkout;
pub mod diagnosis;
pub mod figures;
mod page;
pub mod rates;
pub mod rows;
pub mod update;

pub use page::Provenance;

/// Smallest and largest value, and a share of room beyond them; one unit where all are equal.
fn extent(values: impl Iterator<Item = f64>, room: f64) -> (f64, f64) {
    let (min, max) = values.fold((f64::MAX, f64::MIN), |(min, max), value| (min.min(value), max.max(value)));
    let room = if max > min { room * (max - min) } else { 0.5 };
    if min > max { (0.0, 1.0) } else { (min - room, max + room) }
}
