//! The rules by which a unit follows a source: what is used when samples are on time, late, missing, or jump.
//!
//! The source's samples make a curve of accumulated rotation S over on-board time: straight from sample to sample, beyond the
//! last at the last rate for [`HELD_S`], then at rest. When a sample must end, what it counts is the curve as it is then
//! known, and what the samples before counted too much or too little (S as it is known now less what was used) is made up
//! evenly over this one. So a late sample is felt as a rate, and no angle is lost.

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;

use geu_model::attitude::{Knot, SampleQuality, StreamedAttitude, Sun, TruthNumbers, turn_between_arcsec};
use geu_model::units::{ARCSEC_PER_DEG, RAD_PER_DEG};

/// A source that told nothing for so long is missing; the last rate is held until then, s.
pub(crate) const HELD_S: f64 = 5.0;
/// Between two samples no more time than this passes, or it is a jump, s.
const LEAP_S: f64 = 5.0;
/// Time that goes back by less is a sample out of order, s; datagrams may overtake each other.
const OUT_OF_ORDER_S: f64 = 0.5;
/// Samples nearer than this to the one before the last take the last one's place, so that memory is bounded, s.
const NEAR_S: f64 = 0.001;
/// Times are rounded by so much, s.
const GRAIN_S: f64 = 1e-6;
/// A source that goes on, but is missing for its lag in so many samples on end, is behind for good.
const BEHIND: u32 = 4;
/// Of a source that runs before the unit does, so much is kept, s: more than anybody tells ahead.
const KEPT_S: f64 = 1.0;
/// Pieces that a sample becomes: the model's own sub-steps.
const PIECES: usize = 5;

/// What a source tells of an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TruthSample {
    /// On the source's time scale.
    pub t_s: f64,
    pub motion: MotionValue,
    /// Direction to the sun, in the frame that an attitude is against, of unit length.
    pub sun: Option<[f64; 3]>,
}

/// How the unit moves, as it was told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum MotionValue {
    /// The attitude, control frame to inertial, real part first, of unit length.
    Attitude([f64; 4]),
    /// The mean rates about the control axes since the sample before.
    Rate([f64; 3]),
}

/// What became of a source's samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TruthStatistics {
    /// Samples that came.
    pub received: u64,
    /// Samples that ended before the samples of their end were there.
    pub late: u64,
    /// Samples in which the source was missing.
    pub missing: u64,
    /// Times that time or attitude jumped.
    pub jumps: u64,
    /// Samples that came after a later one, and were not used.
    pub out_of_order: u64,
    /// Lines or messages that could not be read.
    pub bad_lines: u64,
    /// Ends of samples that were reported to a source that asked for them.
    pub reports: u64,
    /// The same that had no room, because it did not read.
    pub reports_dropped: u64,
}

impl fmt::Display for TruthStatistics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let TruthStatistics { received, late, missing, jumps, out_of_order, bad_lines, reports, reports_dropped } =
            self;
        write!(
            f,
            "received {received}, late samples {late}, missing {missing}, jumps {jumps}, out of order {out_of_order}, bad lines {bad_lines}"
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
    /// The sun there, where the source tells it.
    sun: Option<Sun>,
}

/// Follows one source.
#[derive(Debug)]
pub(crate) struct TruthSynchroniser {
    truth: Arc<StreamedAttitude>,
    numbers: TruthNumbers,
    /// Source time of on-board time 0; none before the first sample.
    zero_s: Option<f64>,
    /// The curve, from the last sample that is not after what was used.
    curve: VecDeque<Point>,
    /// The attitude at the last sample, where it told one, and the rate up to it.
    attitude: Option<[f64; 4]>,
    rate_arcsec_s: [f64; 3],
    /// Direction to the sun as it was told last; none where the first sample did not tell it.
    sun_inertial: Option<[f64; 3]>,
    /// It was said that a sun which is told later is not used.
    has_said_sun: bool,
    /// How far the truth is final, and the rotation used by then.
    used_s: f64,
    used_arcsec: [f64; 3],
    is_missing: bool,
    /// Samples on end in which the source was missing though it went on, and how far it had come by the last.
    behind: u32,
    told_before_s: f64,
    pub counts: TruthStatistics,
}

impl TruthSynchroniser {
    /// One that has heard nothing yet, and appends to `truth`.
    pub fn new(truth: Arc<StreamedAttitude>, numbers: TruthNumbers) -> TruthSynchroniser {
        TruthSynchroniser {
            truth,
            numbers,
            zero_s: None,
            curve: VecDeque::new(),
            attitude: None,
            rate_arcsec_s: [0.0; 3],
            sun_inertial: None,
            has_said_sun: false,
            used_s: 0.0,
            used_arcsec: [0.0; 3],
            is_missing: false,
            behind: 0,
            told_before_s: 0.0,
            counts: TruthStatistics::default(),
        }
    }

    /// Whether a first sample has come.
    pub fn has_begun(&self) -> bool {
        self.zero_s.is_some()
    }

    /// Whether the source tells the sun: its first sample did.
    pub fn tells_sun(&self) -> bool {
        self.sun_inertial.is_some()
    }

    /// Source time of an on-board time; none before the first sample.
    pub fn source_s(&self, t_s: f64) -> Option<f64> {
        self.zero_s.map(|zero_s| zero_s + t_s)
    }

    /// On-board time up to which samples are there.
    pub fn told_s(&self) -> f64 {
        self.curve.back().map_or(f64::NEG_INFINITY, |last| last.t_s)
    }

    /// Whether nothing came for so long that the unit is held at rest.
    pub fn is_missing(&self) -> bool {
        self.is_missing
    }

    /// Whether samples cover `t_s`.
    pub fn covers(&self, t_s: f64) -> bool {
        self.told_s() >= t_s - GRAIN_S
    }

    /// Takes a sample as it comes, and tells what is worth telling.
    pub fn take(&mut self, sample: TruthSample) -> Option<String> {
        self.counts.received += 1;
        let (Some(zero_s), Some(&Point { t_s: last_s, angle, .. })) = (self.zero_s, self.curve.back()) else {
            self.zero_s = Some(sample.t_s - self.used_s);
            self.sun_inertial = sample.sun;
            let sun = self.sun_seen(&sample);
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
        let sun = self.sun_seen(&sample);
        if !(0.0..=LEAP_S).contains(&passed_s) {
            self.counts.jumps += 1;
            // Where the source still agrees with on-board time that goes on; otherwise what it tells is of now.
            let agrees = passed_s > 0.0 && (t_s - self.used_s).abs() <= LEAP_S;
            let now_s = if agrees { t_s } else { self.used_s.max(last_s + GRAIN_S) };
            self.zero_s = Some(sample.t_s - now_s);
            self.push(Point { t_s: now_s, angle: self.at(now_s), sun });
            self.rate_arcsec_s = [0.0; 3];
            return Some(format!("its time jumped by {passed_s:+.3} s; what it turned in that is not counted"));
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
            self.push(Point { t_s, angle: std::array::from_fn(|axis| angle[axis] + turn[axis]), sun });
            let is_unused = sample.sun.is_some() && !self.tells_sun();
            return (is_unused && !std::mem::replace(&mut self.has_said_sun, true)).then(|| {
                "it tells the sun, which its first sample did not; theta and psi stay unknown in this run".to_owned()
            });
        }
        // Over a stretch that was not told the last rate is held.
        self.push(Point { t_s, angle: self.at(t_s), sun });
        turn?;
        self.counts.jumps += 1;
        let (fastest_deg_s, limit_deg_s) = (fastest_arcsec_s / ARCSEC_PER_DEG, self.numbers.max_rate_deg_s);
        Some(format!(
            "its attitude jumped, by {fastest_deg_s:.1}°/s for {passed_s:.3} s; expected {limit_deg_s}°/s at most (truth.max_rate_deg_s); that is not counted"
        ))
    }

    /// The sun at a sample; where that tells no attitude, as it was.
    fn sun_seen(&mut self, sample: &TruthSample) -> Option<Sun> {
        self.sun_inertial = sample.sun.filter(|_| self.tells_sun()).or(self.sun_inertial);
        let (sun, obliquity_rad) = (self.sun_inertial?, self.numbers.obliquity_deg * RAD_PER_DEG);
        match sample.motion {
            MotionValue::Attitude(attitude) => Some(Sun::seen(attitude, sun, obliquity_rad)),
            MotionValue::Rate(_) => self.curve.back()?.sun,
        }
    }

    /// Before the first sample: has time 0 follow the source, a moment before its last sample.
    pub fn reset_origin(&mut self) {
        let start_s = self.told_s() - KEPT_S;
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

    /// Makes the truth final up to `end_s`, whatever is known, and tells what is worth telling.
    pub fn finish(&mut self, end_s: f64) -> Option<String> {
        let (start_s, length_s) = (self.used_s, end_s - self.used_s);
        if length_s <= 0.0 {
            return None;
        }
        let silent_s = end_s - self.told_s();
        let basis = match silent_s {
            ..=GRAIN_S => SampleQuality::Told,
            ..=HELD_S => SampleQuality::Held,
            _ => SampleQuality::Missing,
        };
        self.counts.late += u64::from(basis == SampleQuality::Held);
        self.counts.missing += u64::from(basis == SampleQuality::Missing);
        let known = self.at(start_s);
        let owed: [f64; 3] = std::array::from_fn(|axis| known[axis] - self.used_arcsec[axis]);
        for piece in 1..=PIECES {
            let share = piece as f64 / PIECES as f64;
            let t_s = if piece == PIECES { end_s } else { start_s + length_s * share };
            let angle = self.at(t_s);
            self.used_arcsec = std::array::from_fn(|axis| angle[axis] - owed[axis] * (1.0 - share));
            let sun = self.sun_at(t_s);
            self.truth.append(Knot { t_s, angle_control_arcsec: self.used_arcsec, basis, sun });
        }
        self.used_s = end_s;
        while self.curve.get(1).is_some_and(|next| next.t_s <= end_s) {
            self.curve.pop_front();
        }
        let told_s = self.told_s();
        let goes_on = told_s > std::mem::replace(&mut self.told_before_s, told_s);
        self.behind = if basis == SampleQuality::Missing && goes_on { self.behind + 1 } else { 0 };
        if self.behind == BEHIND {
            return Some(self.catch_up());
        }
        let was_missing = std::mem::replace(&mut self.is_missing, basis == SampleQuality::Missing);
        match (was_missing, self.is_missing) {
            (false, true) => {
                Some(format!("nothing came for {HELD_S} s of on-board time; the unit is held at rest until it is back"))
            }
            (true, false) => Some("it is back".to_owned()),
            _ => None,
        }
    }

    /// Takes what a source tells that is behind for good as of now. The curve moves in time alone, so no angle is lost.
    fn catch_up(&mut self) -> String {
        let lag_s = self.used_s - self.told_s();
        self.curve.iter_mut().for_each(|point| point.t_s += lag_s);
        self.zero_s = self.zero_s.map(|zero_s| zero_s - lag_s);
        (self.behind, self.is_missing, self.told_before_s) = (0, false, self.told_s());
        self.counts.jumps += 1;
        format!("it is {lag_s:.3} s behind, and goes on; what it tells is of now from here on")
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

    /// The sun at `t_s`; after the last sample as it was there.
    fn sun_at(&self, t_s: f64) -> Option<Sun> {
        match self.around(t_s) {
            (Some(Point { t_s: from_s, sun: Some(from), .. }), Some(Point { t_s: to_s, sun: Some(to), .. })) => {
                Some(from.towards(to, (t_s - from_s) / (to_s - from_s)))
            }
            (from, to) => from.or(to)?.sun,
        }
    }

    /// The points before `t_s`, and at it or after it. One that is earlier by rounding alone is at it: a sample that it
    /// covers must come out the same whether or not a later one is there.
    fn around(&self, t_s: f64) -> (Option<&Point>, Option<&Point>) {
        let after = self.curve.partition_point(|point| point.t_s < t_s - GRAIN_S);
        (after.checked_sub(1).and_then(|index| self.curve.get(index)), self.curve.get(after))
    }

    fn push(&mut self, point: Point) {
        let count = self.curve.len();
        if count >= 2 && point.t_s - self.curve[count - 2].t_s < NEAR_S {
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
