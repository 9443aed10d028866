//! A motion of prescribed rates about the control axes, as a rate table makes it: segments one after the other, then rest.
//!
//! Within a segment a rate is the sum of a straight line, a sine, and a random course: independent normal numbers at equal
//! intervals, joined by straight lines. All integrals are exact. θ is not known, and taken as 90°, where it turns nothing.

use std::f64::consts::{FRAC_PI_2, TAU};

use super::MotionState;
use crate::fault::FaultRng;
use crate::parameter_spec::numbers;
use crate::units::{ARCSEC_PER_DEG, RAD_PER_DEG};

numbers! {
    /// A segment of a motion of prescribed rates.
    pub struct RateSegment {
        /// Length.
        duration_s: required, 0.001..=1e9, "s";
        /// Rate about X at its start.
        x_deg_s: 0.0, -1e5..=1e5, "°/s";
        /// Rate about Y at its start.
        y_deg_s: 0.0, -1e5..=1e5, "°/s";
        /// Rate about Z at its start.
        z_deg_s: 0.0, -1e5..=1e5, "°/s";
        /// Rate about X at its end; between them it is a straight line; that of the start where not named.
        end_x_deg_s: absent, -1e5..=1e5, "°/s";
        /// Rate about Y at its end.
        end_y_deg_s: absent, -1e5..=1e5, "°/s";
        /// Rate about Z at its end.
        end_z_deg_s: absent, -1e5..=1e5, "°/s";
        /// Amplitude of a sine about X.
        sine_x_deg_s: 0.0, -1e5..=1e5, "°/s";
        /// Amplitude of a sine about Y.
        sine_y_deg_s: 0.0, -1e5..=1e5, "°/s";
        /// Amplitude of a sine about Z.
        sine_z_deg_s: 0.0, -1e5..=1e5, "°/s";
        /// Frequency of the sines.
        frequency_hz: 1.0, 1e-6..=1e4, "Hz";
        /// Phase of the sines at the start of the segment.
        phase_deg: 0.0, -360.0..=360.0, "°";
        /// Standard deviation of random rates about each axis.
        random_deg_s: 0.0, 0.0..=1e4, "°/s";
        /// Number of random rates drawn in a second.
        random_hz: 1.0, 1e-3..=1e3, "1/s";
    }
}

impl RateSegment {
    /// Rate at the start and at the end, and amplitude of the sine about an axis, arcsec/s.
    fn axis(&self, axis: usize) -> [f64; 3] {
        let start = [self.x_deg_s, self.y_deg_s, self.z_deg_s][axis];
        let end = [self.end_x_deg_s, self.end_y_deg_s, self.end_z_deg_s][axis];
        let sine = [self.sine_x_deg_s, self.sine_y_deg_s, self.sine_z_deg_s][axis];
        [start, if end.is_nan() { start } else { end }, sine].map(|rate| rate * ARCSEC_PER_DEG)
    }

    /// Rate and angle since the start of the segment without the random course, arcsec/s and arcsec.
    fn at(&self, axis: usize, t_s: f64) -> (f64, f64) {
        let [start, end, sine] = self.axis(axis);
        let slope = (end - start) / self.duration_s;
        let (turn_rad_s, phase_rad) = (TAU * self.frequency_hz, self.phase_deg * RAD_PER_DEG);
        let (mut rate, mut angle) = (start + slope * t_s, (start + 0.5 * slope * t_s) * t_s);
        if sine != 0.0 {
            let (sin, cos) = libm::sincos(turn_rad_s * t_s + phase_rad);
            rate += sine * sin;
            angle += sine / turn_rad_s * (libm::cos(phase_rad) - cos);
        }
        (rate, angle)
    }
}

/// Length of a motion, s.
pub fn length_s(segments: &[RateSegment]) -> f64 {
    segments.iter().map(|segment| segment.duration_s).sum()
}

/// A motion of prescribed rates, forward only.
#[derive(Debug, Clone)]
pub(super) struct RateMotion {
    segments: Vec<RateSegment>,
    seed: u64,
    index: usize,
    start_s: f64,
    /// Angle at the start of the segment.
    base_arcsec: [f64; 3],
    knot: Knot,
    /// Angle of the last moment.
    angle_arcsec: [f64; 3],
}

/// Random rates of an interval, arcsec/s, and their angle until its start.
#[derive(Debug, Clone, Copy, Default)]
struct Knot {
    number: u64,
    from: [f64; 3],
    to: [f64; 3],
    angle_arcsec: [f64; 3],
}

impl RateMotion {
    pub fn new(segments: &[RateSegment], seed: u64) -> RateMotion {
        let mut motion = RateMotion {
            segments: segments.to_vec(),
            seed,
            index: 0,
            start_s: 0.0,
            base_arcsec: [0.0; 3],
            knot: Knot::default(),
            angle_arcsec: [0.0; 3],
        };
        motion.begin();
        motion
    }

    /// Begins a segment.
    fn begin(&mut self) {
        self.knot = Knot { from: self.drawn(0), to: self.drawn(1), ..Knot::default() };
    }

    /// Random rates of the segment, by number.
    fn drawn(&self, number: u64) -> [f64; 3] {
        let Some(segment) = self.segments.get(self.index).filter(|segment| segment.random_deg_s > 0.0) else {
            return [0.0; 3];
        };
        let rng = FaultRng::new(self.seed, "motion");
        let at = (self.index as u64) << 40 | number;
        ["x", "y", "z"].map(|axis| segment.random_deg_s * ARCSEC_PER_DEG * rng.at(axis, at).standard_normal())
    }

    /// Turn about the control axes since the last call, arcsec, and the state at `t_s`.
    pub fn advance(&mut self, t_s: f64) -> ([f64; 3], MotionState) {
        while let Some(segment) = self.segments.get(self.index)
            && t_s >= self.start_s + segment.duration_s
        {
            let duration_s = segment.duration_s;
            self.base_arcsec = self.within(duration_s).1;
            self.start_s += duration_s;
            self.index += 1;
            self.begin();
        }
        let (rate_control_arcsec_s, angle) = self.within((t_s - self.start_s).max(0.0));
        let turned = std::array::from_fn(|axis| angle[axis] - self.angle_arcsec[axis]);
        self.angle_arcsec = angle;
        (turned, MotionState { t_s, rate_control_arcsec_s, theta_rad: FRAC_PI_2, psi_rad: 0.0 })
    }

    /// Rates and angles at a time within the segment.
    fn within(&mut self, t_s: f64) -> ([f64; 3], [f64; 3]) {
        let Some(segment) = self.segments.get(self.index).copied() else { return ([0.0; 3], self.base_arcsec) };
        let interval_s = 1.0 / segment.random_hz;
        while segment.random_deg_s > 0.0 && t_s >= (self.knot.number + 1) as f64 * interval_s {
            let Knot { number, from, to, mut angle_arcsec } = self.knot;
            for (axis, angle) in angle_arcsec.iter_mut().enumerate() {
                *angle += 0.5 * (from[axis] + to[axis]) * interval_s;
            }
            self.knot = Knot { number: number + 1, from: to, to: self.drawn(number + 2), angle_arcsec };
        }
        let since_s = t_s - self.knot.number as f64 * interval_s;
        let (mut rates, mut angles) = ([0.0; 3], [0.0; 3]);
        for axis in 0..3 {
            let (rate, angle) = segment.at(axis, t_s);
            let slope = (self.knot.to[axis] - self.knot.from[axis]) / interval_s;
            let random = self.knot.angle_arcsec[axis] + (self.knot.from[axis] + 0.5 * slope * since_s) * since_s;
            rates[axis] = rate + self.knot.from[axis] + slope * since_s;
            angles[axis] = self.base_arcsec[axis] + angle + random;
        }
        (rates, angles)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segment(duration_s: f64) -> RateSegment {
        RateSegment { duration_s, ..RateSegment::default() }
    }

    #[test]
    fn angles_are_the_integrals_of_the_rates() {
        let segments = [
            RateSegment { x_deg_s: 2.0, end_x_deg_s: -1.0, z_deg_s: 0.5, ..segment(3.0) },
            RateSegment { sine_y_deg_s: 10.0, frequency_hz: 2.3, phase_deg: 40.0, ..segment(2.7) },
            RateSegment { random_deg_s: 3.0, random_hz: 7.0, y_deg_s: 1.0, ..segment(4.0) },
        ];
        let mut motion = RateMotion::new(&segments, 5);
        let (mut sum, mut integral, mut last) = ([0.0; 3], [0.0; 3], [0.0; 3]);
        // A grain that no segment's end nor interval falls on.
        let step_s = 1.0 / 8191.0;
        for index in 1..=(10.0 / step_s) as usize {
            let (turned, state) = motion.advance(index as f64 * step_s);
            for axis in 0..3 {
                sum[axis] += turned[axis];
                let rate = state.rate_control_arcsec_s[axis];
                integral[axis] += if index == 1 { rate * step_s } else { 0.5 * (rate + last[axis]) * step_s };
            }
            last = state.rate_control_arcsec_s;
        }
        for axis in 0..3 {
            assert!((sum[axis] - integral[axis]).abs() < 8.0, "{axis}: {} {}", sum[axis], integral[axis]);
        }
        // 3 s of a mean of 0.5 °/s, and 0.5 °/s about Z; the random part is on top from 5.7 s on.
        let mut motion = RateMotion::new(&segments[..1], 5);
        let (turned, at_end) = motion.advance(20.0);
        assert!((turned[0] - 1.5 * 3600.0).abs() < 1e-9 && (turned[2] - 1.5 * 3600.0).abs() < 1e-9, "{turned:?}");
        assert_eq!((at_end.rate_control_arcsec_s, at_end.theta_rad), ([0.0; 3], FRAC_PI_2));
        assert!(length_s(&segments) == 9.7);
    }

    #[test]
    fn random_rates_depend_on_the_seed_and_not_on_the_steps() {
        let segments = [RateSegment { random_deg_s: 3.0, random_hz: 20.0, ..segment(10.0) }];
        let angle = |seed: u64, steps: usize| {
            let mut motion = RateMotion::new(&segments, seed);
            let turned = (1..=steps).map(|index| motion.advance(index as f64 * 9.0 / steps as f64).0[1]);
            turned.sum::<f64>()
        };
        assert!((angle(1, 9000) - angle(1, 9)).abs() < 1e-6);
        assert!((angle(1, 9) - angle(2, 9)).abs() > 1.0);
    }
}
