//! Jumps of the rate between rows of rates or turns: a rate table steps, and a cubic spline through such rows would overshoot on both
//! sides, of 60 deg/s and rows each 10 ms by 100″.

use geu_model::attitude::AttitudeRow;
use nalgebra::Vector3;

/// A jump, as a multiple of the largest change of rate from row to row on both sides: less may be an acceleration or noise.
const JUMP: f64 = 20.0;
/// Rows on each side that show how the rate changes without a jump.
const ROWS: usize = 3;
/// Jump over a row, arcsec, of which a spline makes less than a thousandth: no unit measures that.
const MIN_ARCSEC: f64 = 0.02;
/// Share of a row from its start or end within which a jump belongs to that end.
const AT_END: f64 = 1e-4;
const BEFORE_END: f64 = 1.0 - AT_END;
/// Shares of jumps at the start and end of a row, of which the rates beside it change.
const FIRST: f64 = -1.0 / JUMP;
const LAST: f64 = 1.0 - FIRST;

/// A jump in a row, after this share of it; 1 at its end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RateJump {
    pub row: usize,
    pub share: f64,
}

/// Jumps in order of their rows; none beside rows before which the turn is `unknown`.
pub fn rate_jumps(rows: &[AttitudeRow], unknown: &[usize]) -> Vec<RateJump> {
    let length_s = |row: usize| rows[row].t_s - rows[row - 1].t_s;
    let rate = |row: usize| Vector3::from(rows[row].angle_control_arcsec) / length_s(row);
    let change = |row: usize| (rate(row) - rate(row - 1)).norm();
    let is_known = |row: usize| {
        let next = unknown.partition_point(|&own| own + ROWS < row);
        unknown.get(next).is_none_or(|&own| own > row + ROWS)
    };
    let jump = |row: usize| {
        let (before, after) = (rate(row - 1), rate(row + 1));
        let step = after - before;
        let usual = (row + 1 - ROWS..row).chain(row + 2..row + 1 + ROWS).map(change).fold(0.0, f64::max);
        let is_jump = step.norm() * length_s(row) >= MIN_ARCSEC && step.norm() >= JUMP * usual && is_known(row);
        let share = (after - rate(row)).dot(&step) / step.norm_squared();
        match share {
            _ if !is_jump => None,
            // At the start, which is the end of the row before.
            FIRST..=AT_END => Some(RateJump { row: row - 1, share: 1.0 }),
            AT_END..BEFORE_END => Some(RateJump { row, share }),
            BEFORE_END..=LAST => Some(RateJump { row, share: 1.0 }),
            _ => None,
        }
    };
    let mut jumps: Vec<RateJump> = (ROWS + 1..rows.len().saturating_sub(ROWS)).filter_map(jump).collect();
    // A jump near the end of a row is seen from the next row too.
    jumps.dedup_by(|next, kept| {
        let is_same = next.row <= kept.row + 1;
        if next.row == kept.row && next.share < 1.0 {
            *kept = *next;
        }
        is_same
    });
    jumps
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Turns of rows each 10 ms by rates about X that change on both sides of a jump from 3600″/s to −7200″/s.
    fn rows(jump_s: f64, [before, after]: [f64; 2]) -> Vec<AttitudeRow> {
        let angle = |t_s: f64| {
            let since_s = t_s - jump_s;
            let [rate, change] = if since_s > 0.0 { [-7200.0, after] } else { [3600.0, before] };
            rate * since_s + 0.5 * change * since_s * since_s
        };
        let row = |row: i32| {
            let (before_s, t_s) = (f64::from(row - 1) * 0.01, f64::from(row) * 0.01);
            let turn = if row == 0 { 0.0 } else { angle(t_s) - angle(before_s) };
            AttitudeRow { t_s, angle_control_arcsec: [turn, 0.0, 0.0], theta_psi_rad: None }
        };
        (0..100).map(row).collect()
    }

    #[test]
    fn a_jump_is_found_once_at_its_time() {
        for changes in
            [[0.0, 0.0], [0.0, 1000.0], [1000.0, 1000.0], [-1000.0, -1000.0], [2000.0, -2000.0], [-2000.0, 2000.0]]
        {
            for jump_s in [0.5, 0.5002, 0.503, 0.509, 0.51] {
                let found = rate_jumps(&rows(jump_s, changes), &[]);
                let [RateJump { row, share }] = found[..] else { panic!("{jump_s} {changes:?}: {found:?}") };
                let found_s = 0.01 * (row as f64 - 1.0 + share);
                assert!((found_s - jump_s).abs() < 2.5e-4, "{jump_s} {changes:?}: {found_s}");
            }
        }
        assert!(rate_jumps(&rows(0.503, [0.0; 2]), &[49]).is_empty());
        assert!(rate_jumps(&rows(2.0, [0.0; 2]), &[]).is_empty(), "no jump");
    }
}
