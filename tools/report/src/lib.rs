//! Results as output: HTML pages of `calibrate` and `diagnose`, figures of a unit as SVG, rows as CSV and JSON lines, and the
//! text of evaluations.

mod calendar;
pub mod calibration;
pub mod checkout;
pub mod diagnosis;
pub mod figures;
pub mod magnitudes;
mod page;
pub mod rows;
mod text_table;
pub mod update;

pub use page::Provenance;

/// Smallest and largest value, with a `margin` as a share of the range; one unit if all are equal.
fn extent(values: impl Iterator<Item = f64>, margin: f64) -> (f64, f64) {
    let (min, max) = values.fold((f64::MAX, f64::MIN), |(min, max), value| (min.min(value), max.max(value)));
    let margin = if max > min { margin * (max - min) } else { 0.5 };
    if min > max { (0.0, 1.0) } else { (min - margin, max + margin) }
}
