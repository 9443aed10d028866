//! The rules by which a unit follows a source: what is used when samples are on time, late, missing, or jump.
//!
//! The source's samples make a curve of accumulated rotation S over on-board time: straight from sample to sample, beyond the
//! last at the last rate for [`HELD_S`], then at rest. When a half second must end, what it counts is the curve as it is then
//! known, and what the half seconds before counted too much or too little (S as it is known now less what was used) is made up
//! evenly over this one. So a late sample is felt as a rate, and no angle is lost.

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;

use geu_model::attitude::{Basis, Knot, Stepped, turn_between_arcsec};

/// A source that told nothing for so long is missing; the last rate is held until then, s.
pub(crate) const HELD_S: f64 = 5.0;
/// Between two samples no more time than this passes, or it is a jump, s.
const LEAP_S: f64 = 5.0;
/// Time that goes back by less is a sample out of order, s; datagrams may overtake each other.
const OUT_OF_ORDER_S: f64 = 0.5;
/// A faster turn between two samples is a jump: 10°/s.
const FASTEST_ARCSEC_S: f64 = 36_000.0;
/// Samples nearer than this to the one before the last take the last one's place, so that memory is bounded, s.
const NEAR_S: f64 = 0.001;
/// Times are rounded by so much, s.
const GRAIN_S: f64 = 1e-6;
/// A source that goes on, but is missing for its lag in so many half seconds on end, is behind for good.
const BEHIND: u32 = 4;
/// Of a source that runs before the unit does, so much is kept, s: more than anybody tells ahead.
const KEPT_S: f64 = 1.0;
/// Pieces that a half second becomes: the model's own sub-steps.
const PIECES: usize = 5;

/// What a source tells of an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sample {
    /// On the source's time scale.
    pub t_s: f64,
    pub motion: Told,
}

/// How the unit moves, as it was told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Told {
    /// The attitude, control frame to inertial, real part first, of unit length.
    Attitude([f64; 4]),
    /// The mean rates about the control axes since the sample before.
    Rate([f64; 3]),
}

/// What became of a source's samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Samples that came.
    pub received: u64,
    /// Half seconds that ended before the samples of their end were there.
    pub late: u64,
    /// Half seconds in which the source was missing.
    pub missing: u64,
    /// Times that time or attitude jumped.
    pub jumps: u64,
    /// Samples that came after a later one, and were not used.
    pub out_of_order: u64,
    /// Lines or messages that could not be read.
    pub bad_lines: u64,
}

impl fmt::Display for Counts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Counts { received, late, missing, jumps, out_of_order, bad_lines } = self;
        write!(
            f,
            "received {received}, late half seconds {late}, missing {missing}, jumps {jumps}, out of order {out_of_order}, bad lines {bad_lines}"
        )
    }
}

/// Follows one source.
#[derive(Debug)]
pub(crate) struct Follower {
    truth: Arc<Stepped>,
    /// Source time of on-board time 0; none before the first sample.
    zero_s: Option<f64>,
    /// The curve: on-board time and accumulated rotation, from the last sample that is not after what was used.
    curve: VecDeque<(f64, [f64; 3])>,
    /// The attitude at the last sample, where it told one, and the rate up to it.
    attitude: Option<[f64; 4]>,
    rate_arcsec_s: [f64; 3],
    /// How far the truth is final, and the rotation used by then.
    used_s: f64,
    used_arcsec: [f64; 3],
    is_missing: bool,
    /// Half seconds on end in which the source was missing though it went on, and how far it had come by the last.
    behind: u32,
    told_before_s: f64,
    pub counts: Counts,
}

impl Follower {
    /// One that has heard nothing yet, and appends to `truth`.
    pub fn new(truth: Arc<Stepped>) -> Follower {
        Follower {
            truth,
            zero_s: None,
            curve: VecDeque::new(),
            attitude: None,
            rate_arcsec_s: [0.0; 3],
            used_s: 0.0,
            used_arcsec: [0.0; 3],
            is_missing: false,
            behind: 0,
            told_before_s: 0.0,
            counts: Counts::default(),
        }
    }

    /// Whether a first sample has come.
    pub fn has_begun(&self) -> bool {
        self.zero_s.is_some()
    }

    /// On-board time up to which samples are there.
    pub fn told_s(&self) -> f64 {
        self.curve.back().map_or(f64::NEG_INFINITY, |&(t_s, _)| t_s)
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
    pub fn take(&mut self, sample: Sample) -> Option<String> {
        self.counts.received += 1;
        let (Some(zero_s), Some(&(last_s, angle))) = (self.zero_s, self.curve.back()) else {
            self.zero_s = Some(sample.t_s - self.used_s);
            self.curve.push_back((self.used_s, self.used_arcsec));
            self.attitude = attitude_of(sample.motion);
            return None;
        };
        let (t_s, passed_s) = (sample.t_s - zero_s, sample.t_s - zero_s - last_s);
        if (-OUT_OF_ORDER_S..=0.0).contains(&passed_s) {
            self.counts.out_of_order += 1;
            return None;
        }
        let before = std::mem::replace(&mut self.attitude, attitude_of(sample.motion));
        if !(0.0..=LEAP_S).contains(&passed_s) {
            self.counts.jumps += 1;
            // Where the source still agrees with on-board time that goes on; otherwise what it tells is of now.
            let agrees = passed_s > 0.0 && (t_s - self.used_s).abs() <= LEAP_S;
            let now_s = if agrees { t_s } else { self.used_s.max(last_s + GRAIN_S) };
            self.zero_s = Some(sample.t_s - now_s);
            self.push(now_s, self.at(now_s));
            self.rate_arcsec_s = [0.0; 3];
            return Some(format!("its time jumped by {passed_s:+.3} s; what it turned in that is not counted"));
        }
        let turn = match sample.motion {
            Told::Rate(rate_arcsec_s) => Some(rate_arcsec_s.map(|rate| rate * passed_s)),
            Told::Attitude(attitude) => before.map(|before| turn_between_arcsec(before, attitude)),
        };
        let rate = turn.map(|turn| turn.map(|turn| turn / passed_s));
        let fastest_arcsec_s = rate.map_or(0.0, |rate| rate.iter().map(|rate| rate * rate).sum::<f64>().sqrt());
        if let (Some(turn), Some(rate)) = (turn, rate)
            && fastest_arcsec_s <= FASTEST_ARCSEC_S
        {
            self.rate_arcsec_s = rate;
            self.push(t_s, std::array::from_fn(|axis| angle[axis] + turn[axis]));
            return None;
        }
        // Over a stretch that was not told the last rate is held.
        self.push(t_s, self.at(t_s));
        turn?;
        self.counts.jumps += 1;
        let fastest_deg_s = fastest_arcsec_s / 3600.0;
        Some(format!("its attitude jumped, by {fastest_deg_s:.1}°/s for {passed_s:.3} s; that is not counted"))
    }

    /// Before the first half second: has time 0 follow the source, a moment before its last sample.
    pub fn forget_the_past(&mut self) {
        let start_s = self.told_s() - KEPT_S;
        if let Some(zero_s) = self.zero_s.as_mut().filter(|_| start_s > 0.0 && self.used_s == 0.0) {
            *zero_s += start_s;
            let start = self.at(start_s);
            self.curve.retain(|&(t_s, _)| t_s > start_s);
            self.curve.push_front((start_s, start));
            for (t_s, angle) in &mut self.curve {
                *t_s -= start_s;
                *angle = std::array::from_fn(|axis| angle[axis] - start[axis]);
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
            ..=GRAIN_S => Basis::Told,
            ..=HELD_S => Basis::Held,
            _ => Basis::Missing,
        };
        self.counts.late += u64::from(basis == Basis::Held);
        self.counts.missing += u64::from(basis == Basis::Missing);
        let known = self.at(start_s);
        let owed: [f64; 3] = std::array::from_fn(|axis| known[axis] - self.used_arcsec[axis]);
        for piece in 1..=PIECES {
            let share = piece as f64 / PIECES as f64;
            let t_s = if piece == PIECES { end_s } else { start_s + length_s * share };
            let angle = self.at(t_s);
            self.used_arcsec = std::array::from_fn(|axis| angle[axis] - owed[axis] * (1.0 - share));
            self.truth.append(Knot { t_s, angle_control_arcsec: self.used_arcsec, basis });
        }
        self.used_s = end_s;
        while self.curve.get(1).is_some_and(|&(t_s, _)| t_s <= end_s) {
            self.curve.pop_front();
        }
        let told_s = self.told_s();
        let goes_on = told_s > std::mem::replace(&mut self.told_before_s, told_s);
        self.behind = if basis == Basis::Missing && goes_on { self.behind + 1 } else { 0 };
        if self.behind == BEHIND {
            return Some(self.catch_up());
        }
        let was_missing = std::mem::replace(&mut self.is_missing, basis == Basis::Missing);
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
        self.curve.iter_mut().for_each(|(t_s, _)| *t_s += lag_s);
        self.zero_s = self.zero_s.map(|zero_s| zero_s - lag_s);
        (self.behind, self.is_missing, self.told_before_s) = (0, false, self.told_s());
        self.counts.jumps += 1;
        format!("it is {lag_s:.3} s behind, and goes on; what it tells is of now from here on")
    }

    /// The curve at `t_s`.
    fn at(&self, t_s: f64) -> [f64; 3] {
        let after = self.curve.partition_point(|&(knot_s, _)| knot_s < t_s);
        let Some(&(to_s, to)) = self.curve.get(after) else {
            let Some(&(last_s, last)) = self.curve.back() else { return self.used_arcsec };
            let held_s = (t_s - last_s).min(HELD_S);
            return std::array::from_fn(|axis| last[axis] + self.rate_arcsec_s[axis] * held_s);
        };
        let Some(&(from_s, from)) = after.checked_sub(1).and_then(|index| self.curve.get(index)) else { return to };
        let share = (t_s - from_s) / (to_s - from_s);
        std::array::from_fn(|axis| from[axis] + (to[axis] - from[axis]) * share)
    }

    fn push(&mut self, t_s: f64, angle_arcsec: [f64; 3]) {
        let count = self.curve.len();
        if count >= 2 && t_s - self.curve[count - 2].0 < NEAR_S {
            self.curve.pop_back();
        }
        self.curve.push_back((t_s, angle_arcsec));
    }
}

fn attitude_of(motion: Told) -> Option<[f64; 4]> {
    match motion {
        Told::Attitude(attitude) => Some(attitude),
        Told::Rate(_) => None,
    }
}

#[cfg(test)]
mod tests;
