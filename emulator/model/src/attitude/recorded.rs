//! True attitude from a file: accumulated rotation about the control axes at given instants, joined by a cubic spline.
//!
//! The spline goes through every accumulated angle and is smooth to the second derivative, so increments between the
//! instants of the file are exact, and those between its instants err by h⁴/384 of the fourth derivative: 0.0013″ for a
//! limit cycle of 4″/s and 5 s on rows each 0.5 s. Straight lines would err by 0.16″.

#[cfg(test)]
mod tests;

use std::sync::Arc;

use super::MotionState;
use super::spline::second_derivatives;
use crate::units::{ARCSEC_PER_RAD, SUN_RATE_RAD_S};

/// One row: what happened since the row before, where there is one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AttitudeRow {
    /// End of the row's interval, on the truth's time scale.
    pub t_s: f64,
    /// Rotation about the control axes since the row before.
    pub angle_control_arcsec: [f64; 3],
    /// θ and ψ where they are known.
    pub theta_psi_rad: Option<(f64, f64)>,
}

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AttitudeRowsError {
    /// Fewer than three after the start.
    #[error("expected at least 3 rows after the first, got {0}")]
    TooFew(usize),
    /// Time that does not rise.
    #[error("expected time to rise, got {t_s} s since the first row after a row at {before_s} s")]
    NotRising {
        index: usize,
        t_s: f64,
        /// The time before.
        before_s: f64,
    },
    /// A hole in which the motion is not known.
    #[error(
        "expected rows every {spacing_s} s or so, got a gap of {gap_s} s before {t_s} s since the first row; cut the file there"
    )]
    Gap {
        /// Index of the row after it.
        index: usize,
        t_s: f64,
        gap_s: f64,
        spacing_s: f64,
    },
    /// Not finite, or too large for a motion.
    #[error(
        "expected finite numbers, turns within {MAX_ARCSEC:e} arcsec from row to row, the sun within {MAX_RAD} rad; got {value:e}"
    )]
    NotFinite { index: usize, value: f64 },
}

impl AttitudeRowsError {
    pub fn index(&self) -> Option<usize> {
        match *self {
            AttitudeRowsError::TooFew(_) => None,
            AttitudeRowsError::NotRising { index, .. }
            | AttitudeRowsError::Gap { index, .. }
            | AttitudeRowsError::NotFinite { index, .. } => Some(index),
        }
    }
}

/// Turn from row to row beyond which it is none: far more than any spacecraft makes, and few enough digits to add up.
const MAX_ARCSEC: f64 = 1e9;
/// Limit of θ and ψ.
const MAX_RAD: f64 = 1e4;
/// A hole longer than this many median spacings is a gap.
pub const GAP_SPACINGS: f64 = 1.9;

/// Median spacing of times; `None` for fewer than two.
pub fn median_spacing_s(mut t_s: impl Iterator<Item = f64>) -> Option<f64> {
    let mut before_s = t_s.next()?;
    let mut spacings: Vec<f64> = t_s.map(|t_s| t_s - std::mem::replace(&mut before_s, t_s)).collect();
    let middle = spacings.len() / 2;
    (!spacings.is_empty()).then(|| *spacings.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Indices of the times after a gap.
fn gaps(t_s: &[f64]) -> Vec<usize> {
    let limit_s = median_spacing_s(t_s.iter().copied()).map_or(f64::INFINITY, |spacing_s| GAP_SPACINGS * spacing_s);
    (1..t_s.len()).filter(|&row| t_s[row] - t_s[row - 1] > limit_s).collect()
}

/// A truth read from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedAttitude {
    t_s: Vec<f64>,
    /// Accumulated rotation at each, with its second derivatives. Copies that start at other times share them.
    angle_control_arcsec: Arc<[Vec<f64>; 3]>,
    bend: Arc<[Vec<f64>; 3]>,
    /// θ and ψ at each; empty where they are not known.
    theta_psi_rad: Vec<(f64, f64)>,
    /// Turn of ψ from each to the next.
    turn_psi_rad: Vec<f64>,
    /// Rotation about X and Y, since the row after the start, beyond that of θ and ψ; empty if they are unknown.
    departure_arcsec: Vec<[f64; 2]>,
    /// Rows after a gap.
    gaps: Vec<usize>,
    /// The part of these before which the turn is not known either.
    unknown: Vec<usize>,
}

impl RecordedAttitude {
    /// Reads rows in order of time; the first one is the start of the motion.
    ///
    /// # Errors
    /// Rows that overlap, leave a gap, or are too few.
    pub fn new(rows: Vec<AttitudeRow>) -> Result<RecordedAttitude, AttitudeRowsError> {
        RecordedAttitude::with_gaps(rows)?.without_gaps()
    }

    /// Refuses gaps between the rows.
    ///
    /// # Errors
    /// The first gap.
    pub fn without_gaps(self) -> Result<RecordedAttitude, AttitudeRowsError> {
        let Some(&index) = self.gaps.first() else { return Ok(self) };
        let (before_s, t_s) = (self.t_s[index - 1], self.t_s[index]);
        let spacing_s = median_spacing_s(self.t_s.iter().copied()).unwrap_or_default();
        Err(AttitudeRowsError::Gap { index, t_s, gap_s: t_s - before_s, spacing_s })
    }

    /// Reads rows that may leave gaps, in which the motion is not known.
    ///
    /// # Errors
    /// Rows that overlap or are too few.
    pub fn with_gaps(rows: Vec<AttitudeRow>) -> Result<RecordedAttitude, AttitudeRowsError> {
        RecordedAttitude::read(rows, |t_s, angles| angles.each_ref().map(|own| second_derivatives(t_s, own)))
    }

    /// The motion with the second derivatives that `bend` makes of times and angles. The rows, which take more memory, end before.
    fn read(
        rows: Vec<AttitudeRow>,
        bend: impl FnOnce(&[f64], &[Vec<f64>; 3]) -> [Vec<f64>; 3],
    ) -> Result<RecordedAttitude, AttitudeRowsError> {
        let intervals = rows.len().saturating_sub(1);
        if intervals < 3 {
            return Err(AttitudeRowsError::TooFew(intervals));
        }
        for (index, row) in rows.iter().enumerate() {
            let is_beyond = |number: &f64, most: f64| !number.is_finite() || number.abs() > most;
            let turn = row.angle_control_arcsec.into_iter().find(|number| is_beyond(number, MAX_ARCSEC));
            let sun = row.theta_psi_rad.map(|(theta_rad, psi_rad)| [theta_rad, psi_rad]);
            let sun = sun.into_iter().flatten().find(|number| is_beyond(number, MAX_RAD));
            let time = Some(row.t_s).filter(|t_s| !t_s.is_finite());
            if let Some(value) = turn.or(sun).or(time) {
                return Err(AttitudeRowsError::NotFinite { index, value });
            }
        }
        for (index, pair) in rows.windows(2).enumerate() {
            let (index, before_s, t_s) = (index + 1, pair[0].t_s, pair[1].t_s);
            if t_s <= before_s {
                return Err(AttitudeRowsError::NotRising { index, t_s, before_s });
            }
        }
        let t_s: Vec<f64> = rows.iter().map(|row| row.t_s).collect();
        let angle_control_arcsec: [Vec<f64>; 3] = std::array::from_fn(|axis| {
            let mut sum = 0.0;
            std::iter::once(0.0)
                .chain(rows[1..].iter().map(|row| {
                    sum += row.angle_control_arcsec[axis];
                    sum
                }))
                .collect()
        });
        let theta_psi_rad: Vec<(f64, f64)> =
            rows.iter().map(|row| row.theta_psi_rad).collect::<Option<_>>().unwrap_or_default();
        drop(rows);
        let turn_psi_rad = theta_psi_rad.windows(2).map(|pair| shorter_way(pair[1].1 - pair[0].1)).collect();
        let departure_arcsec = departure(&t_s, &angle_control_arcsec, &theta_psi_rad);
        let (gaps, bend) = (gaps(&t_s), bend(&t_s, &angle_control_arcsec));
        Ok(RecordedAttitude {
            t_s,
            angle_control_arcsec: Arc::new(angle_control_arcsec),
            bend: Arc::new(bend),
            theta_psi_rad,
            turn_psi_rad,
            departure_arcsec,
            gaps,
            unknown: Vec::new(),
        })
    }

    /// Reads rows, in rising order `unknown`, before which neither motion nor turn is known: the angle stays there, and the rows between two
    /// such gaps have a spline of their own, as have those between two `jumps` of the rate. Attitudes have gaps between distant rows too. Of
    /// rates and turns the spline does not bend at rows without a turn, in which the unit rests.
    ///
    /// # Errors
    /// Rows that overlap or are too few.
    pub fn with_unknown_turns(
        rows: Vec<AttitudeRow>,
        unknown: Vec<usize>,
        jumps: &[usize],
        is_attitude: bool,
    ) -> Result<RecordedAttitude, AttitudeRowsError> {
        let is_rest = |row: &usize| rows[*row].angle_control_arcsec == [0.0; 3] && unknown.binary_search(row).is_err();
        let rests: Vec<usize> = (1..rows.len()).filter(|row| !is_attitude && is_rest(row)).collect();
        // A jump is the end of one spline and the start of the next.
        let of_jump = jumps.iter().map(|&row| (row + 1, row));
        let mut ends: Vec<(usize, usize)> = unknown.iter().map(|&row| (row, row)).chain(of_jump).collect();
        ends.sort_unstable();
        let starts = [0].into_iter().chain(ends.iter().map(|own| own.1));
        let splines: Vec<_> = starts.zip(ends.iter().map(|own| own.0).chain([rows.len()])).collect();
        let bend_of = |t_s: &[f64], angles: &Vec<f64>| {
            let mut bend = vec![0.0; angles.len()];
            for own in splines.iter().map(|&(from, to)| from..to).filter(|own| own.len() >= 3) {
                bend[own.clone()].copy_from_slice(&second_derivatives(&t_s[own.clone()], &angles[own]));
            }
            jumps.iter().for_each(|&row| bend[row] = 0.0);
            rests.iter().for_each(|&row| bend[row - 1..=row].fill(0.0));
            bend
        };
        let read = RecordedAttitude::read(rows, |t_s, angles| angles.each_ref().map(|own| bend_of(t_s, own)))?;
        let mut gaps = if is_attitude { read.gaps } else { Vec::new() };
        gaps.extend(&unknown);
        gaps.sort_unstable();
        gaps.dedup();
        Ok(RecordedAttitude { gaps, unknown, ..read })
    }

    /// A motion with these accumulated angles at the rows, and the same gaps.
    ///
    /// # Errors
    /// Numbers that are no motion.
    pub fn with_angles(&self, angle_control_arcsec: &[[f64; 3]]) -> Result<RecordedAttitude, AttitudeRowsError> {
        let row = |index: usize| {
            let [before, own] = [index.saturating_sub(1), index].map(|row| angle_control_arcsec[row]);
            AttitudeRow {
                t_s: self.t_s[index],
                angle_control_arcsec: std::array::from_fn(|axis| own[axis] - before[axis]),
                theta_psi_rad: self.theta_psi_rad.get(index).copied(),
            }
        };
        let rows = (0..self.t_s.len()).map(row).collect();
        RecordedAttitude::with_unknown_turns(rows, self.unknown.clone(), &[], true)
    }

    /// The first row's time.
    pub fn start_s(&self) -> f64 {
        self.t_s[0]
    }

    /// Moves the truth in time to start at `start_s`.
    #[must_use]
    pub fn starting_at(mut self, start_s: f64) -> RecordedAttitude {
        let first_s = self.start_s();
        // The difference first: it is exact or nearly so where the truth's own times are large.
        self.t_s.iter_mut().for_each(|t_s| *t_s = *t_s - first_s + start_s);
        self
    }

    /// Time of each row and the rotation accumulated since the first, arcsec.
    pub fn rows(&self) -> impl Iterator<Item = (f64, [f64; 3])> + '_ {
        let angle = |row: usize| self.angle_control_arcsec.each_ref().map(|axis| axis[row]);
        self.t_s.iter().enumerate().map(move |(row, &t_s)| (t_s, angle(row)))
    }

    /// Start and end of each gap between rows, s.
    pub fn gaps_s(&self) -> Vec<[f64; 2]> {
        self.gaps.iter().map(|&row| [self.t_s[row - 1], self.t_s[row]]).collect()
    }

    /// Start and end of each gap of which the turn is not known, s.
    pub fn unknown_s(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        self.unknown.iter().map(|&row| [self.t_s[row - 1], self.t_s[row]])
    }

    /// False within a gap.
    pub fn is_known(&self, t_s: f64) -> bool {
        let next = self.gaps.partition_point(|&row| self.t_s[row] <= t_s);
        self.gaps.get(next).is_none_or(|&row| self.t_s[row - 1] >= t_s)
    }

    /// End of the last row's interval.
    pub fn end_s(&self) -> f64 {
        self.t_s[self.t_s.len() - 1]
    }

    /// True if θ and ψ are known.
    pub fn knows_sun(&self) -> bool {
        !self.theta_psi_rad.is_empty()
    }

    /// Rotation about X and Y from the attitude that θ and ψ define, linear between rows. `near` is the interval that
    /// [`RecordedAttitude::at`] found for `t_s`.
    pub fn departure_control_arcsec(&self, t_s: f64, near: usize) -> [f64; 2] {
        let Some(&[from, to]) = self.departure_arcsec.get(near..near + 2) else { return [0.0; 2] };
        let share = ((t_s - self.t_s[near]) / (self.t_s[near + 1] - self.t_s[near])).clamp(0.0, 1.0);
        [0, 1].map(|axis| from[axis] + (to[axis] - from[axis]) * share)
    }

    /// Accumulated rotation, rates and attitude at `t_s`; at rest before the start and after the end. `near` is the
    /// interval found last, from which the search goes forward.
    #[inline]
    pub fn at(&self, t_s: f64, near: &mut usize) -> ([f64; 3], MotionState) {
        let (first, last) = (self.start_s(), self.end_s());
        let inside = t_s.clamp(first, last);
        while *near + 2 < self.t_s.len() && self.t_s[*near + 1] < inside {
            *near += 1;
        }
        while *near > 0 && self.t_s[*near] > inside {
            *near -= 1;
        }
        let (i, length_s) = (*near, self.t_s[*near + 1] - self.t_s[*near]);
        let b = (inside - self.t_s[i]) / length_s;
        let a = 1.0 - b;
        let mut moment = MotionState { t_s, ..MotionState::default() };
        let is_unknown = !self.unknown.is_empty() && self.unknown.binary_search(&(i + 1)).is_ok();
        let bent_s = if is_unknown { 0.0 } else { length_s };
        let sixth = bent_s * bent_s / 6.0;
        let angle = std::array::from_fn(|axis| {
            let (y, m) = (&self.angle_control_arcsec[axis], &self.bend[axis]);
            a * y[i] + b * y[i + 1] + ((a * a * a - a) * m[i] + (b * b * b - b) * m[i + 1]) * sixth
        });
        if t_s == inside {
            moment.rate_control_arcsec_s = std::array::from_fn(|axis| {
                let (y, m) = (&self.angle_control_arcsec[axis], &self.bend[axis]);
                (y[i + 1] - y[i]) / length_s
                    + ((3.0 * b * b - 1.0) * m[i + 1] - (3.0 * a * a - 1.0) * m[i]) * bent_s / 6.0
            });
        }
        // Where θ is not known the package is taken at rest at 90°, where nothing turns it.
        (moment.theta_rad, moment.psi_rad) = match self.theta_psi_rad.get(i..i + 2) {
            Some(&[from, to]) => (a * from.0 + b * to.0, from.1 + b * self.turn_psi_rad[i]),
            _ => (std::f64::consts::FRAC_PI_2, 0.0),
        };
        (angle, moment)
    }
}

/// Rotation about X and Y beyond that of θ and ψ by eqs 5 and 6, accumulated since the row after the start; the
/// integrals over a row by Simpson's rule.
fn departure(t_s: &[f64], angle_control_arcsec: &[Vec<f64>; 3], theta_psi_rad: &[(f64, f64)]) -> Vec<[f64; 2]> {
    // Rates do not define θ and ψ at the start.
    let mut sum = [0.0; 2];
    let mut all: Vec<[f64; 2]> = theta_psi_rad.iter().take(2).map(|_| sum).collect();
    for k in 2..theta_psi_rad.len() {
        let (from, to) = (theta_psi_rad[k - 1], theta_psi_rad[k]);
        let (turn_theta, turn_psi) = (to.0 - from.0, shorter_way(to.1 - from.1));
        let sun = SUN_RATE_RAD_S * (t_s[k] - t_s[k - 1]);
        let mut meant = [0.0, turn_theta];
        for (share, weight) in [(0.0, 1.0 / 6.0), (0.5, 4.0 / 6.0), (1.0, 1.0 / 6.0)] {
            let (theta, psi) = (from.0 + share * turn_theta, from.1 + share * turn_psi);
            meant[0] += weight * (turn_psi * libm::cos(theta) + sun * libm::cos(psi) * libm::sin(theta));
            meant[1] -= weight * sun * libm::sin(psi);
        }
        for axis in 0..2 {
            let turned = angle_control_arcsec[axis][k] - angle_control_arcsec[axis][k - 1];
            sum[axis] += turned - meant[axis] * ARCSEC_PER_RAD;
        }
        all.push(sum);
    }
    all
}

pub(super) fn shorter_way(rad: f64) -> f64 {
    rad - std::f64::consts::TAU * (rad / std::f64::consts::TAU).round()
}
