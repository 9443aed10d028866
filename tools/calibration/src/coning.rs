//! The motion between the attitudes of a reference.

use geu_model::attitude::{GAP_SPACINGS, RecordedAttitude};
use geu_model::units::ARCSEC_PER_RAD;
use nalgebra::Vector3;

/// The motion of which these rows are turns about one axis from each to the next, without their coning: a twelfth of the turn times the change of
/// the rate (Bortz, to third order). Rows beside a gap stay as they are.
pub fn without_coning(rows: RecordedAttitude) -> RecordedAttitude {
    let (times_s, turned): (Vec<f64>, Vec<[f64; 3]>) = rows.rows().unzip();
    let turned: Vec<Vector3<f64>> = turned.into_iter().map(Vector3::from).collect();
    let length_s = |row: usize| times_s[row] - times_s[row - 1];
    let rate = |row: usize| (turned[row] - turned[row - 1]) / length_s(row);
    let is_even = |row: usize| {
        let lengths_s = [row - 1, row, row + 1].map(length_s);
        let is_known = |own: usize| rows.is_known(0.5 * (times_s[own - 1] + times_s[own]));
        let shortest_s = lengths_s.iter().copied().fold(f64::INFINITY, f64::min);
        lengths_s.iter().all(|own| *own < GAP_SPACINGS * shortest_s) && (row - 1..=row + 1).all(is_known)
    };
    let mut sum = Vector3::zeros();
    let of_row = |row: usize| {
        if (2..times_s.len() - 1).contains(&row) && is_even(row) {
            let length_s = length_s(row);
            let between_s = 0.5 * (times_s[row + 1] + times_s[row] - times_s[row - 1] - times_s[row - 2]);
            let change = (rate(row + 1) - rate(row - 1)) * (length_s / between_s);
            sum += (turned[row] - turned[row - 1]).cross(&change) * (length_s / 12.0 / ARCSEC_PER_RAD);
        }
        turned[row] - sum
    };
    let angles: Vec<[f64; 3]> = (0..times_s.len()).map(of_row).map(Vector3::into).collect();
    rows.with_angles(&angles).unwrap_or(rows)
}
