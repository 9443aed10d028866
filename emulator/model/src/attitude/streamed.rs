//! An attitude that is received during the run: rotation about the control axes, at constant rates between knots.
//!
//! An external source reports the attitude. The synchroniser appends final knots, and the unit reads them. Knots never
//! change, so the knots alone repeat the run.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard};

use super::{MotionState, Sun};
use crate::units::ARCSEC_PER_RAD;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SampleQuality {
    Received,
    /// The source was late: the last rate was held.
    Held,
    /// The source was missing for long: the unit was held at rest.
    Missing,
}

impl SampleQuality {
    /// Each with its word in a file.
    pub const WORDS: [(SampleQuality, &'static str); 3] =
        [(SampleQuality::Received, "told"), (SampleQuality::Held, "held"), (SampleQuality::Missing, "missing")];
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Knot {
    /// True time since the start of the run.
    pub t_s: f64,
    /// Rotation about the control axes since the start.
    pub angle_control_arcsec: [f64; 3],
    /// Quality of the interval that ends here.
    pub basis: SampleQuality,
    /// The sun at the end, if the source reports it: in all knots except the start, or in none.
    pub sun: Option<Sun>,
}

/// The start of every such truth.
const START: Knot = Knot { t_s: 0.0, angle_control_arcsec: [0.0; 3], basis: SampleQuality::Received, sun: None };

/// The truth as far as it is known; at rest before its start and after its end.
#[derive(Debug)]
pub struct StreamedAttitude {
    known: Mutex<Knots>,
    most: usize,
}

#[derive(Debug)]
struct Knots {
    knots: VecDeque<Knot>,
    /// Number of dropped knots before the first.
    forgotten: u64,
}

impl Default for StreamedAttitude {
    fn default() -> StreamedAttitude {
        StreamedAttitude::remembering(usize::MAX)
    }
}

impl StreamedAttitude {
    /// Keeps only the last `most` knots, for a run without end.
    pub fn remembering(most: usize) -> StreamedAttitude {
        StreamedAttitude {
            known: Mutex::new(Knots { knots: VecDeque::from([START]), forgotten: 0 }),
            most: most.max(2),
        }
    }

    fn known(&self) -> MutexGuard<'_, Knots> {
        self.known.lock().expect("nothing panics with the knots")
    }

    /// Appends a knot; ignores one whose time does not increase.
    pub fn append(&self, knot: Knot) {
        let mut known = self.known();
        if known.knots.back().is_some_and(|last| knot.t_s > last.t_s) {
            known.knots.push_back(knot);
            if known.knots.len() > self.most {
                known.knots.pop_front();
                known.forgotten += 1;
            }
        }
    }

    pub fn end_s(&self) -> f64 {
        self.known().knots.back().unwrap_or(&START).t_s
    }

    /// The knots from number `first` on, counted from 0 for the start, as far as they are not forgotten.
    pub fn knots_from(&self, first: u64) -> Vec<Knot> {
        let known = self.known();
        known.knots.iter().skip(first.saturating_sub(known.forgotten) as usize).copied().collect()
    }

    /// True if the last knot has the sun.
    pub fn has_sun(&self) -> bool {
        self.known().knots.back().is_some_and(|last| last.sun.is_some())
    }

    /// Rotation since the start, rates and sun at `t_s`. At a knot the rates before it hold.
    pub fn at(&self, t_s: f64) -> ([f64; 3], MotionState, Option<Sun>) {
        let known = self.known();
        let after = known.knots.partition_point(|knot| knot.t_s < t_s);
        let (Some(from), Some(to)) =
            (after.checked_sub(1).and_then(|index| known.knots.get(index)), known.knots.get(after))
        else {
            let nearest = if after == 0 { known.knots.front() } else { known.knots.back() }.unwrap_or(&START);
            // The start has no sun: that of the next knot holds.
            let sun = nearest.sun.or_else(|| known.knots.get(1)?.sun);
            return (nearest.angle_control_arcsec, moment(t_s, sun), sun);
        };
        let (length_s, since_s) = (to.t_s - from.t_s, t_s - from.t_s);
        let turn: [f64; 3] =
            std::array::from_fn(|axis| to.angle_control_arcsec[axis] - from.angle_control_arcsec[axis]);
        let share = since_s / length_s;
        let sun = to.sun.map(|to| from.sun.map_or(to, |from| from.towards(&to, share)));
        let moment = MotionState { rate_control_arcsec_s: turn.map(|turn| turn / length_s), ..moment(t_s, sun) };
        (std::array::from_fn(|axis| from.angle_control_arcsec[axis] + turn[axis] * share), moment, sun)
    }
}

/// At rest; where θ and ψ are not known the package is taken at rest at 90°, where nothing turns it.
pub(super) fn moment(t_s: f64, sun: Option<Sun>) -> MotionState {
    let sun = sun.unwrap_or(Sun { theta_rad: std::f64::consts::FRAC_PI_2, ..Sun::default() });
    MotionState { t_s, theta_rad: sun.theta_rad, psi_rad: sun.psi_rad, ..MotionState::default() }
}

/// The turn about the control axes, by the shorter way, from one attitude to the next; quaternions of unit length, control
/// frame to inertial, real part first.
pub fn turn_between_arcsec(from: [f64; 4], to: [f64; 4]) -> [f64; 3] {
    let ([a, b, c, d], [e, f, g, h]) = (from, to);
    // The vector part of from⁻¹ · to, and its real part.
    let part = [a * f - b * e - c * h + d * g, a * g - c * e - d * f + b * h, a * h - d * e - b * g + c * f];
    let real = a * e + b * f + c * g + d * h;
    let sine = libm::sqrt(part.iter().map(|part| part * part).sum());
    // Twice the angle's half over its sine; the limit where there is next to no turn.
    let factor = if sine < 1e-12 { 2.0 } else { 2.0 * libm::atan2(sine, real.abs()) / sine };
    part.map(|part| part * factor.copysign(real) * ARCSEC_PER_RAD)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn knot(t_s: f64, x: f64) -> Knot {
        Knot { t_s, angle_control_arcsec: [x, 0.0, -x], basis: SampleQuality::Received, sun: None }
    }

    #[test]
    fn rates_are_constant_between_knots_and_zero_outside() {
        let truth = StreamedAttitude::default();
        truth.append(knot(0.5, 10.0));
        truth.append(knot(1.0, 40.0));
        truth.append(knot(0.7, 99.0));
        for (t_s, angle, rate) in
            [(-1.0, 0.0, 0.0), (0.25, 5.0, 20.0), (0.5, 10.0, 20.0), (0.75, 25.0, 60.0), (2.0, 40.0, 0.0)]
        {
            let (got, moment, _) = truth.at(t_s);
            assert_eq!((got, moment.rate_control_arcsec_s), ([angle, 0.0, -angle], [rate, 0.0, -rate]), "{t_s}");
        }
    }

    #[test]
    fn theta_and_psi_are_those_of_the_sun_and_90_degrees_without_one() {
        let truth = StreamedAttitude::default();
        assert_eq!((truth.has_sun(), truth.at(0.0).1.theta_rad), (false, std::f64::consts::FRAC_PI_2));
        let sun = |theta_rad: f64| Some(Sun { theta_rad, psi_rad: -theta_rad, departure_control_arcsec: [3.0, 0.0] });
        truth.append(Knot { sun: sun(1.0), ..knot(0.5, 10.0) });
        truth.append(Knot { sun: sun(2.0), ..knot(1.0, 20.0) });
        assert!(truth.has_sun());
        for (t_s, theta_rad) in [(-1.0, 1.0), (0.0, 1.0), (0.25, 1.0), (0.75, 1.5), (1.0, 2.0), (9.0, 2.0)] {
            let (_, moment, seen) = truth.at(t_s);
            assert_eq!((moment.theta_rad, moment.psi_rad), (theta_rad, -theta_rad), "{t_s}");
            assert_eq!(seen.map(|sun| sun.departure_control_arcsec), Some([3.0, 0.0]));
        }
    }

    #[test]
    fn old_knots_are_forgotten_and_the_others_keep_their_numbers() {
        let truth = StreamedAttitude::remembering(4);
        (1..=10).for_each(|k| truth.append(knot(f64::from(k), f64::from(k))));
        assert_eq!(truth.knots_from(9).iter().map(|knot| knot.t_s).collect::<Vec<_>>(), [9.0, 10.0]);
        assert_eq!(truth.knots_from(0).len(), 4);
        assert_eq!(truth.at(8.5).0[0], 8.5);
    }

    #[test]
    fn a_turn_takes_the_shorter_way_for_either_sign() {
        let about_y = |deg: f64| {
            let half = (deg / 2.0).to_radians();
            [half.cos(), 0.0, half.sin(), 0.0]
        };
        let from = about_y(30.0);
        for (to, expected_deg) in
            [(about_y(31.0), 1.0), (about_y(31.0).map(|part| -part), 1.0), (about_y(-10.0), -40.0), (from, 0.0)]
        {
            let turn = turn_between_arcsec(from, to);
            assert!((turn[1] - expected_deg * 3600.0).abs() < 1e-6 && turn[0] == 0.0 && turn[2] == 0.0, "{turn:?}");
        }
    }
}
