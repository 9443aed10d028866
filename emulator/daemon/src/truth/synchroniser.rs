//! Synchronises the unit with a source whose samples are on time, late, missing, or jump.
//!
//! The samples of the source are nodes of a curve of accumulated rotation S over on-board time: linear between samples, at
//! the last rate for [`HELD_S`] after the last one, then at rest. A unit sample counts the curve as known when it ends, and
//! compensates evenly the error of the samples before (S as known now less the used rotation). A late sample thus acts as a
//! rate, and no angle is lost.

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;

use geu_model::attitude::{Knot, SampleQuality, StreamedAttitude, Sun, TruthNumbers, turn_between_arcsec};
use geu_model::units::{ARCSEC_PER_DEG, RAD_PER_DEG};

/// Time without samples after which a source is missing; the last rate is held until then, s.
pub(crate) const HELD_S: f64 = 5.0;
/// Maximum time between two samples; a longer one is a jump, s.
const MAX_STEP_S: f64 = 5.0;
/// Maximum step back in time of a sample out of order, s; datagrams may overtake each other.
const OUT_OF_ORDER_S: f64 = 0.5;
/// Minimum distance of a sample from the one before the last; a closer one replaces the last, which bounds memory, s.
const MIN_DISTANCE_S: f64 = 0.001;
/// Tolerance of times, s.
const TIME_TOLERANCE_S: f64 = 1e-6;
/// Consecutive samples for which a source sends but is missing because of its lag, before its lag is compensated.
const MAX_BEHIND: u32 = 4;
/// Length of the curve kept while the source runs before the unit, s: more than a source sends ahead.
const KEPT_S: f64 = 1.0;
/// Knots per sample: the sub-steps of the model.
const KNOTS: usize = 5;

/// A sample of a source.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TruthSample {
    /// On the source's time scale.
    pub t_s: f64,
    pub motion: MotionValue,
    /// Direction to the sun in the inertial frame, of unit length.
    pub sun: Option<[f64; 3]>,
}

/// Motion of the unit, as reported.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum MotionValue {
    /// Attitude, control frame to inertial, real part first, of unit length.
    Attitude([f64; 4]),
    /// Mean rates about the control axes since the previous sample.
    Rate([f64; 3]),
}

/// Statistics of a source.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TruthStatistics {
    /// Samples received.
    pub received: u64,
    /// Unit samples that ended before the source's samples of their end were received.
    pub late: u64,
    /// Unit samples in which the source was missing.
    pub missing: u64,
    /// Jumps of time or attitude.
    pub jumps: u64,
    /// Samples received after a later one; not used.
    pub out_of_order: u64,
    /// Invalid lines or messages.
    pub bad_lines: u64,
    /// Reports sent to a source that subscribed.
    pub reports: u64,
    /// Reports dropped because the source did not read.
    pub reports_dropped: u64,
}

impl fmt::Display for TruthStatistics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let TruthStatistics { received, late, missing, jumps, out_of_order, bad_lines, reports, reports_dropped } =
            self;
        write!(
            f,
            "received {received}, late intervals {late}, missing {missing}, jumps {jumps}, out of order {out_of_order}, bad lines {bad_lines}"
        )?;
        match (reports, reports_dropped) {
            (0, 0) => Ok(()),
            _ => write!(f, ", reports {reports} sent, {reports_dropped} dropped"),
        }
    }
}

/// A point of the curve.
#[derive(Debug, Clone, Copy)]
struct Point {
    /// On-board time.
    t_s: f64,
    /// Accumulated rotation.
    angle: [f64; 3],
    /// The sun at this point, if the source sends it.
    sun: Option<Sun>,
}

/// Synchronises the truth with one source.
#[derive(Debug, Default)]
pub(crate) struct TruthSynchroniser {
    truth: Arc<StreamedAttitude>,
    numbers: TruthNumbers,
    /// Source time of on-board time 0; `None` before the first sample.
    zero_s: Option<f64>,
    /// The curve, from the last sample at or before `used_s`.
    curve: VecDeque<Point>,
    /// The attitude of the last sample, if it had one, and the rate until then.
    attitude: Option<[f64; 4]>,
    rate_arcsec_s: [f64; 3],
    /// The last direction to the sun; `None` if the first sample had none.
    sun_inertial: Option<[f64; 3]>,
    /// The message that a later sun is not used was returned.
    has_reported_sun: bool,
    /// On-board time up to which the truth is final, and the rotation used until then.
    used_s: f64,
    used_arcsec: [f64; 3],
    /// The source is missing, and the unit is held at rest.
    pub is_missing: bool,
    /// Consecutive unit samples in which the source was missing but sent samples, and its last time before.
    behind: u32,
    previous_last_s: f64,
    pub counts: TruthStatistics,
}

impl TruthSynchroniser {
    /// A synchroniser without samples, which appends to `truth`.
    pub fn new(truth: Arc<StreamedAttitude>, numbers: TruthNumbers) -> TruthSynchroniser {
        TruthSynchroniser { truth, numbers, ..TruthSynchroniser::default() }
    }

    /// True after the first sample.
    pub fn has_begun(&self) -> bool {
        self.zero_s.is_some()
    }

    /// True if the source sends the sun: its first sample has it.
    pub fn has_sun(&self) -> bool {
        self.sun_inertial.is_some()
    }

    /// Source time of an on-board time; `None` before the first sample.
    pub fn source_s(&self, t_s: f64) -> Option<f64> {
        self.zero_s.map(|zero_s| zero_s + t_s)
    }

    /// On-board time of the last sample.
    pub fn last_s(&self) -> f64 {
        self.curve.back().map_or(f64::NEG_INFINITY, |last| last.t_s)
    }

    /// True if samples cover `t_s`.
    pub fn covers(&self, t_s: f64) -> bool {
        self.last_s() >= t_s - TIME_TOLERANCE_S
    }

    /// Adds a sample; returns a message for the user, if any.
    pub fn push(&mut self, sample: TruthSample) -> Option<String> {
        self.counts.received += 1;
        let (Some(zero_s), Some(&Point { t_s: last_s, angle, .. })) = (self.zero_s, self.curve.back()) else {
            self.zero_s = Some(sample.t_s - self.used_s);
            self.sun_inertial = sample.sun;
            let sun = self.sun_of(&sample);
            self.curve.push_back(Point { t_s: self.used_s, angle: self.used_arcsec, sun });
            self.attitude = attitude_of(sample.motion);
            return None;
        };
        let (t_s, passed_s) = (sample.t_s - zero_s, sample.t_s - zero_s - last_s);
        if (-OUT_OF_ORDER_S..=0.0).contains(&passed_s) {
            self.counts.out_of_order += 1;
            return None;
        }
        let before = std::mem::replace(&mut self.attitude, attitude_of(sample.motion));
        let sun = self.sun_of(&sample);
        if !(0.0..=MAX_STEP_S).contains(&passed_s) {
            self.counts.jumps += 1;
            // If the source still agrees with on-board time, its time is kept; otherwise the sample is of now.
            let agrees = passed_s > 0.0 && (t_s - self.used_s).abs() <= MAX_STEP_S;
            let now_s = if agrees { t_s } else { self.used_s.max(last_s + TIME_TOLERANCE_S) };
            self.zero_s = Some(sample.t_s - now_s);
            self.push_point(Point { t_s: now_s, angle: self.at(now_s), sun });
            self.rate_arcsec_s = [0.0; 3];
            return Some(format!("its time jumped by {passed_s:+.3} s; the rotation in that time is not counted"));
        }
        let turn = match sample.motion {
            MotionValue::Rate(rate_arcsec_s) => Some(rate_arcsec_s.map(|rate| rate * passed_s)),
            MotionValue::Attitude(attitude) => before.map(|before| turn_between_arcsec(before, attitude)),
        };
        let rate = turn.map(|turn| turn.map(|turn| turn / passed_s));
        let fastest_arcsec_s = rate.map_or(0.0, |rate| rate.iter().map(|rate| rate * rate).sum::<f64>().sqrt());
        if let (Some(turn), Some(rate)) = (turn, rate)
            && fastest_arcsec_s <= self.numbers.max_rate_deg_s * ARCSEC_PER_DEG
        {
            self.rate_arcsec_s = rate;
            self.push_point(Point { t_s, angle: std::array::from_fn(|axis| angle[axis] + turn[axis]), sun });
            let is_unused = sample.sun.is_some() && !self.has_sun();
            return (is_unused && !std::mem::replace(&mut self.has_reported_sun, true)).then(|| {
                "it sends the sun, which its first sample did not; theta and psi stay unavailable in this run"
                    .to_owned()
            });
        }
        // Without a valid rate the last one is held.
        self.push_point(Point { t_s, angle: self.at(t_s), sun });
        turn?;
        self.counts.jumps += 1;
        let (fastest_deg_s, limit_deg_s) = (fastest_arcsec_s / ARCSEC_PER_DEG, self.numbers.max_rate_deg_s);
        Some(format!(
            "its attitude jumped, by {fastest_deg_s:.1}°/s for {passed_s:.3} s; expected {limit_deg_s}°/s at most (truth.max_rate_deg_s); that is not counted"
        ))
    }

    /// The sun at a sample; unchanged if that has no attitude.
    fn sun_of(&mut self, sample: &TruthSample) -> Option<Sun> {
        self.sun_inertial = sample.sun.filter(|_| self.has_sun()).or(self.sun_inertial);
        let (sun, obliquity_rad) = (self.sun_inertial?, self.numbers.obliquity_deg * RAD_PER_DEG);
        match sample.motion {
            MotionValue::Attitude(attitude) => Some(Sun::seen(attitude, sun, obliquity_rad)),
            MotionValue::Rate(_) => self.curve.back()?.sun,
        }
    }

    /// Before the first unit sample: moves time 0 to [`KEPT_S`] before the last sample of the source.
    pub fn reset_origin(&mut self) {
        let start_s = self.last_s() - KEPT_S;
        if let Some(zero_s) = self.zero_s.as_mut().filter(|_| start_s > 0.0 && self.used_s == 0.0) {
            *zero_s += start_s;
            let (start, sun) = (self.at(start_s), self.sun_at(start_s));
            self.curve.retain(|point| point.t_s > start_s);
            self.curve.push_front(Point { t_s: start_s, angle: start, sun });
            for point in &mut self.curve {
                point.t_s -= start_s;
                point.angle = std::array::from_fn(|axis| point.angle[axis] - start[axis]);
            }
        }
    }

    /// Makes the truth final up to `end_s`, as known now; returns a message for the user, if any.
    pub fn finish(&mut self, end_s: f64) -> Option<String> {
        let (start_s, length_s) = (self.used_s, end_s - self.used_s);
        if length_s <= 0.0 {
            return None;
        }
        let silent_s = end_s - self.last_s();
        let basis = match silent_s {
            ..=TIME_TOLERANCE_S => SampleQuality::Received,
            ..=HELD_S => SampleQuality::Held,
            _ => SampleQuality::Missing,
        };
        self.counts.late += u64::from(basis == SampleQuality::Held);
        self.counts.missing += u64::from(basis == SampleQuality::Missing);
        let known = self.at(start_s);
        let owed: [f64; 3] = std::array::from_fn(|axis| known[axis] - self.used_arcsec[axis]);
        for knot in 1..=KNOTS {
            let share = knot as f64 / KNOTS as f64;
            let t_s = if knot == KNOTS { end_s } else { start_s + length_s * share };
            let angle = self.at(t_s);
            self.used_arcsec = std::array::from_fn(|axis| angle[axis] - owed[axis] * (1.0 - share));
            let sun = self.sun_at(t_s);
            self.truth.append(Knot { t_s, angle_control_arcsec: self.used_arcsec, basis, sun });
        }
        self.used_s = end_s;
        while self.curve.get(1).is_some_and(|next| next.t_s <= end_s) {
            self.curve.pop_front();
        }
        let last_s = self.last_s();
        let is_alive = last_s > std::mem::replace(&mut self.previous_last_s, last_s);
        self.behind = if basis == SampleQuality::Missing && is_alive { self.behind + 1 } else { 0 };
        if self.behind == MAX_BEHIND {
            return Some(self.compensate_lag());
        }
        let was_missing = std::mem::replace(&mut self.is_missing, basis == SampleQuality::Missing);
        match (was_missing, self.is_missing) {
            (false, true) => Some(format!(
                "no sample for {HELD_S} s of on-board time; the unit is held at rest until the source is back"
            )),
            (true, false) => Some("it is back".to_owned()),
            _ => None,
        }
    }

    /// Shifts the time of a source that lags permanently to now. The curve moves in time alone, so no angle is lost.
    fn compensate_lag(&mut self) -> String {
        let lag_s = self.used_s - self.last_s();
        self.curve.iter_mut().for_each(|point| point.t_s += lag_s);
        self.zero_s = self.zero_s.map(|zero_s| zero_s - lag_s);
        (self.behind, self.is_missing, self.previous_last_s) = (0, false, self.last_s());
        self.counts.jumps += 1;
        format!("it is {lag_s:.3} s behind, and still sends; from here on its samples are taken as of now")
    }

    /// The curve at `t_s`.
    fn at(&self, t_s: f64) -> [f64; 3] {
        match self.around(t_s) {
            (Some(from), Some(to)) => {
                let share = (t_s - from.t_s) / (to.t_s - from.t_s);
                std::array::from_fn(|axis| from.angle[axis] + (to.angle[axis] - from.angle[axis]) * share)
            }
            (Some(last), None) => {
                let held_s = (t_s - last.t_s).min(HELD_S);
                std::array::from_fn(|axis| last.angle[axis] + self.rate_arcsec_s[axis] * held_s)
            }
            (None, first) => first.map_or(self.used_arcsec, |first| first.angle),
        }
    }

    /// The sun at `t_s`; after the last sample, that of the last sample.
    fn sun_at(&self, t_s: f64) -> Option<Sun> {
        match self.around(t_s) {
            (Some(Point { t_s: from_s, sun: Some(from), .. }), Some(Point { t_s: to_s, sun: Some(to), .. })) => {
                Some(from.towards(to, (t_s - from_s) / (to_s - from_s)))
            }
            (from, to) => from.or(to)?.sun,
        }
    }

    /// The last point before `t_s` and the first one at or after it. A point that is earlier by rounding alone counts as at it:
    /// a unit sample must not depend on whether a later sample was already received.
    fn around(&self, t_s: f64) -> (Option<&Point>, Option<&Point>) {
        let after = self.curve.partition_point(|point| point.t_s < t_s - TIME_TOLERANCE_S);
        (after.checked_sub(1).and_then(|index| self.curve.get(index)), self.curve.get(after))
    }

    fn push_point(&mut self, point: Point) {
        let count = self.curve.len();
        if count >= 2 && point.t_s - self.curve[count - 2].t_s < MIN_DISTANCE_S {
            self.curve.pop_back();
        }
        self.curve.push_back(point);
    }
}

fn attitude_of(motion: MotionValue) -> Option<[f64; 4]> {
    match motion {
        MotionValue::Attitude(attitude) => Some(attitude),
        MotionValue::Rate(_) => None,
    }
}

#[cfg(test)]
mod tests;
