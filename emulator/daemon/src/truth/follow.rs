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
        let was_missing = std::mem::replace(&mut self.is_missing, basis == Basis::Missing);
        match (was_missing, self.is_missing) {
            (false, true) => {
                Some(format!("nothing came for {HELD_S} s of on-board time; the unit is held at rest until it is back"))
            }
            (true, false) => Some("it is back".to_owned()),
            _ => None,
        }
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
mod tests {
    use super::*;

    /// A source that turns about X at a rate of its own, told as an attitude.
    fn about_x(t_s: f64, arcsec: f64) -> Sample {
        let half = (arcsec / 3600.0 / 2.0_f64).to_radians();
        Sample { t_s, motion: Told::Attitude([half.cos(), half.sin(), 0.0, 0.0]) }
    }

    fn rate(t_s: f64, x: f64) -> Sample {
        Sample { t_s, motion: Told::Rate([x, 0.0, 0.0]) }
    }

    fn take(follower: &mut Follower, samples: &[Sample]) {
        samples.iter().for_each(|sample| drop(follower.take(*sample)));
    }

    fn follower() -> Follower {
        Follower::new(Arc::default())
    }

    /// The rotation about X that was used in each half second.
    fn used(follower: &Follower) -> Vec<f64> {
        let knots = follower.truth.knots_from(0);
        let ends: Vec<f64> = knots.iter().step_by(PIECES).map(|knot| knot.angle_control_arcsec[0]).collect();
        ends.windows(2).map(|pair| pair[1] - pair[0]).collect()
    }

    fn assert_near(got: &[f64], expected: &[f64]) {
        let near = got.iter().zip(expected).all(|(got, expected)| (got - expected).abs() < 1e-6);
        assert!(got.len() == expected.len() && near, "{got:?} is not {expected:?}");
    }

    #[test]
    fn samples_on_time_are_used_as_they_are_from_the_first_on() {
        let mut follower = follower();
        for step in 0..=10 {
            let t_s = f64::from(step) * 0.1;
            follower.take(about_x(1e6 + t_s, 50.0 * t_s * t_s));
        }
        assert!(follower.covers(1.0) && !follower.covers(1.01));
        assert_eq!((follower.finish(0.5), follower.finish(1.0)), (None, None));
        assert_near(&used(&follower), &[12.5, 37.5]);
        assert_eq!(follower.counts, Counts { received: 11, ..Counts::default() });
    }

    #[test]
    fn a_late_sample_is_made_up_over_the_next_half_second_and_no_angle_is_lost() {
        let mut follower = follower();
        take(&mut follower, &[rate(0.0, 0.0), rate(0.5, 100.0)]);
        follower.finish(0.5);
        // Nothing tells that it turns the other way now: 100″/s are held.
        follower.finish(1.0);
        take(&mut follower, &[rate(1.0, -100.0), rate(1.5, -100.0)]);
        follower.finish(1.5);
        take(&mut follower, &[rate(2.0, -100.0)]);
        follower.finish(2.0);
        assert_near(&used(&follower), &[50.0, 50.0, -150.0, -50.0]);
        let bases: Vec<Basis> = follower.truth.knots_from(1).iter().step_by(PIECES).map(|knot| knot.basis).collect();
        assert_eq!(bases, [Basis::Told, Basis::Held, Basis::Told, Basis::Told]);
        assert_eq!(follower.counts.late, 1);
        // Evenly: every tenth of the half second has the same share.
        let knots = follower.truth.knots_from(10);
        let tenths: Vec<f64> = knots
            .windows(2)
            .take(5)
            .map(|pair| pair[1].angle_control_arcsec[0] - pair[0].angle_control_arcsec[0])
            .collect();
        assert_near(&tenths, &[-30.0; 5]);
    }

    #[test]
    fn a_source_that_is_missing_leaves_the_unit_at_rest_and_is_told_once_as_is_its_return() {
        let mut follower = follower();
        take(&mut follower, &[rate(0.0, 0.0), rate(0.5, 10.0)]);
        let notes: Vec<String> = (1..=16).filter_map(|half| follower.finish(f64::from(half) * 0.5)).collect();
        assert_eq!(notes.len(), 1, "{notes:?}");
        let rates = used(&follower);
        assert_near(&rates[..11], &[5.0; 11]);
        assert_near(&rates[11..], &[0.0; 5]);
        assert_eq!((follower.counts.late, follower.counts.missing), (10, 5));
        // What it tells when it is back is of a time that leapt; its own time goes on.
        assert!(follower.take(rate(8.2, 1000.0)).is_some_and(|note| note.contains("time jumped by +7.700 s")));
        follower.take(rate(8.7, 20.0));
        assert!(follower.finish(8.5).is_some_and(|note| note.contains("back")));
        assert_near(&used(&follower)[16..], &[6.0]);
        assert_eq!(follower.counts.jumps, 1);
    }

    #[test]
    fn samples_that_were_held_up_on_the_way_are_all_counted() {
        let mut follower = follower();
        (0..=1).for_each(|half| drop(follower.take(rate(f64::from(half) * 0.5, 10.0))));
        (1..=20).for_each(|half| drop(follower.finish(f64::from(half) * 0.5)));
        (2..=21).for_each(|half| drop(follower.take(rate(f64::from(half) * 0.5, 10.0))));
        follower.finish(10.5);
        assert!((used(&follower).iter().sum::<f64>() - 105.0).abs() < 1e-9);
        assert_eq!(follower.counts.jumps, 0);
    }

    #[test]
    fn time_that_goes_back_goes_on_from_where_the_unit_is() {
        let mut follower = follower();
        (0..=4).for_each(|half| drop(follower.take(about_x(100.0 + f64::from(half) * 0.5, 10.0 * f64::from(half)))));
        (1..=4).for_each(|half| drop(follower.finish(f64::from(half) * 0.5)));
        assert!(follower.take(about_x(0.0, 5000.0)).is_some_and(|note| note.contains("jumped by -102.000 s")));
        follower.take(about_x(0.6, 5006.0));
        assert!(follower.covers(2.5));
        follower.finish(2.5);
        assert!((used(&follower)[4] - 5.0).abs() < 1e-3, "{:?}", used(&follower));
    }

    #[test]
    fn an_attitude_that_jumps_is_not_turned_to() {
        let mut follower = follower();
        follower.take(about_x(0.0, 0.0));
        follower.take(about_x(0.5, 50.0));
        assert!(follower.take(about_x(1.0, 100_000.0)).is_some_and(|note| note.contains("attitude jumped")));
        follower.take(about_x(1.5, 100_020.0));
        (1..=3).for_each(|half| drop(follower.finish(f64::from(half) * 0.5)));
        assert_near(&used(&follower), &[50.0, 50.0, 20.0]);
        assert_eq!((follower.counts.jumps, follower.counts.late), (1, 0));
    }

    #[test]
    fn a_sample_that_was_overtaken_is_counted_and_not_used() {
        let mut follower = follower();
        take(&mut follower, &[rate(0.0, 0.0), rate(0.2, 10.0), rate(0.1, 900.0), rate(0.2, 900.0), rate(0.5, 10.0)]);
        follower.finish(0.5);
        assert_near(&used(&follower), &[5.0]);
        assert_eq!(follower.counts.out_of_order, 2);
    }

    #[test]
    fn a_source_that_ran_before_the_unit_begins_a_moment_before_its_last_sample() {
        let mut follower = follower();
        for step in 0..=100 {
            follower.take(rate(50.0 + f64::from(step) * 0.3, f64::from(step)));
            follower.forget_the_past();
        }
        assert!((follower.told_s() - 1.0).abs() < 1e-9 && follower.curve.len() <= 5);
        follower.finish(1.0);
        // 0.3 s at each of 100, 99 and 98″/s, 0.1 s at 97″/s.
        assert_near(&used(&follower), &[0.3 * 297.0 + 9.7]);
    }

    #[test]
    fn whatever_a_source_tells_what_is_used_is_finite_and_its_time_rises() {
        let mut follower = follower();
        let mut state = 1_u64;
        let mut draw = |most: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 33) % most
        };
        let (mut t_s, mut end_s) = (0.0, 0.0);
        for _ in 0..20_000 {
            t_s = match draw(20) {
                0 => -1e12,
                1 => 1e12,
                2 => t_s - 0.3,
                3 => t_s + 1e-300,
                4 => t_s + 4.9,
                _ => t_s + 0.1,
            };
            let motion = match draw(6) {
                0 => Told::Rate([f64::MAX, -f64::MAX, 1.0]),
                1 => Told::Rate([1e4, 0.0, -1e4]),
                2 => Told::Attitude([0.0, 0.6, -0.8, 0.0]),
                3 => Told::Attitude([1.0, 5e-324, 0.0, 0.0]),
                _ => Told::Attitude([-1.0, 0.0, 0.0, 0.0]),
            };
            follower.take(Sample { t_s, motion });
            if draw(3) == 0 {
                end_s += 0.5;
                follower.finish(end_s);
            }
        }
        let knots = follower.truth.knots_from(0);
        assert!(knots.windows(2).all(|pair| pair[0].t_s < pair[1].t_s), "time rises");
        assert!(knots.iter().all(|knot| knot.angle_control_arcsec.iter().all(|angle| angle.abs() < 1e9)));
    }

    #[test]
    fn a_flood_of_samples_needs_no_more_memory_than_one_each_millisecond() {
        let mut follower = follower();
        (0..100_000).for_each(|index| drop(follower.take(rate(f64::from(index) * 1e-5, 10.0))));
        assert!(follower.curve.len() < 2100, "{}", follower.curve.len());
        follower.finish(0.5);
        assert_near(&used(&follower), &[5.0]);
    }
}
