//! Motions as gyros are tested: body rates as sums of sines, of which the integrals are exact.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use super::unit::{ARCSEC_PER_DEG, DeviceUnit};
use crate::noise::Noise;

/// Kind of a motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeviceMotionKind {
    /// A rate table with three axes: rates of both signs about each, with rests.
    Table,
    /// A slow vehicle or spacecraft with slews.
    Vehicle,
    /// A hand: 0.3 to 2 Hz about all axes, with rests.
    Hand,
}

impl DeviceMotionKind {
    /// All of them.
    pub const ALL: [DeviceMotionKind; 3] = [DeviceMotionKind::Table, DeviceMotionKind::Vehicle, DeviceMotionKind::Hand];

    /// Name of an argument.
    pub fn name(self) -> &'static str {
        ["table", "vehicle", "hand"][self as usize]
    }
}

/// A rate of sin(ωs + phase), s since the start of its segment; a constant has ω = 0.
#[derive(Debug)]
struct Term {
    rates_arcsec_s: [f64; 3],
    rad_per_s: f64,
    phase_rad: f64,
}

impl Term {
    fn constant(rates_arcsec_s: [f64; 3]) -> Term {
        Term { rates_arcsec_s, rad_per_s: 0.0, phase_rad: FRAC_PI_2 }
    }

    /// Factor of the rates, and its integral from 0.
    fn at(&self, s: f64) -> (f64, f64) {
        let (sin, cos) = libm::sincos(self.rad_per_s * s + self.phase_rad);
        let integral = match self.rad_per_s {
            0.0 => s * sin,
            rad_per_s => (libm::cos(self.phase_rad) - cos) / rad_per_s,
        };
        (sin, integral)
    }
}

#[derive(Debug)]
struct Segment {
    start_s: f64,
    duration_s: f64,
    terms: Vec<Term>,
    /// Integral of the rates up to its start.
    angles_arcsec: [f64; 3],
}

impl Segment {
    /// Rates and their integral; before its start as at its start, after its end as at its end.
    fn at(&self, t: f64) -> ([f64; 3], [f64; 3]) {
        let (mut rates, mut angles) = ([0.0; 3], self.angles_arcsec);
        let s = (t - self.start_s).clamp(0.0, self.duration_s);
        for term in &self.terms {
            let (factor, integral) = term.at(s);
            for axis in 0..3 {
                rates[axis] += term.rates_arcsec_s[axis] * factor;
                angles[axis] += term.rates_arcsec_s[axis] * integral;
            }
        }
        (rates, angles)
    }
}

/// Body rates from time 0; at rest before.
#[derive(Debug)]
pub struct DeviceMotion {
    segments: Vec<Segment>,
    /// Present over the whole time.
    background: Segment,
}

impl DeviceMotion {
    /// Draws a motion with the rates of a unit.
    pub fn drawn(kind: DeviceMotionKind, unit: &DeviceUnit, random: &mut Noise, duration_s: f64) -> DeviceMotion {
        let background = Segment { start_s: 0.0, duration_s: 2.0 * duration_s, terms: vec![], angles_arcsec: [0.0; 3] };
        let mut motion = DeviceMotion { segments: vec![], background };
        motion.push(random.uniform(10.0, 20.0), vec![]);
        match kind {
            DeviceMotionKind::Table => motion.table(unit, random, duration_s),
            DeviceMotionKind::Vehicle => motion.vehicle(unit, random, duration_s),
            DeviceMotionKind::Hand => motion.hand(unit, random, duration_s),
        }
        motion.push(duration_s, vec![]);
        motion
    }

    fn end_s(&self) -> f64 {
        self.segments.last().map_or(0.0, |last| last.start_s + last.duration_s)
    }

    fn push(&mut self, duration_s: f64, terms: Vec<Term>) {
        let start_s = self.end_s();
        let angles_arcsec = self.segments.last().map_or([0.0; 3], |last| last.at(start_s).1);
        self.segments.push(Segment { start_s, duration_s, terms, angles_arcsec });
    }

    /// A change of the rates from 0 (`is_rise`) or to 0 by half a cosine.
    fn ramp(&mut self, duration_s: f64, rates: [f64; 3], is_rise: bool) {
        let half = rates.map(|rate| rate / 2.0);
        let phase_rad = if is_rise { -FRAC_PI_2 } else { FRAC_PI_2 };
        let cosine = Term { rates_arcsec_s: half, rad_per_s: PI / duration_s, phase_rad };
        self.push(duration_s, vec![Term::constant(half), cosine]);
    }

    /// Each axis, three rates, both signs, again and again.
    fn table(&mut self, unit: &DeviceUnit, random: &mut Noise, duration_s: f64) {
        while self.end_s() < duration_s {
            for axis in 0..3 {
                for share in [0.25, 0.5, 1.0] {
                    for sign in [1.0, -1.0] {
                        let mut rates = [0.0; 3];
                        rates[axis] = sign * share * unit.table_deg_s * ARCSEC_PER_DEG * random.uniform(0.9, 1.0);
                        let ramp_s = random.uniform(1.0, 2.0);
                        self.ramp(ramp_s, rates, true);
                        self.push(random.uniform(20.0, 30.0), vec![Term::constant(rates)]);
                        self.ramp(ramp_s, rates, false);
                        self.push(random.uniform(6.0, 12.0), vec![]);
                    }
                }
            }
        }
    }

    /// Slow sines, and slews about any axis.
    fn vehicle(&mut self, unit: &DeviceUnit, random: &mut Noise, duration_s: f64) {
        let slew = unit.slew_deg_s * ARCSEC_PER_DEG;
        for axis in 0..3 {
            for _ in 0..2 {
                let mut rates_arcsec_s = [0.0; 3];
                rates_arcsec_s[axis] = slew * random.uniform(0.01, 0.03);
                let rad_per_s = TAU / random.uniform(60.0, 400.0);
                self.background.terms.push(Term { rates_arcsec_s, rad_per_s, phase_rad: 0.0 });
            }
        }
        while self.end_s() < duration_s {
            let axis = [0; 3].map(|_| random.normal());
            let length = axis.iter().map(|part| part * part).sum::<f64>().sqrt();
            let peak = slew * random.uniform(0.3, 1.0) / length;
            let (rates, ramp_s) = (axis.map(|part| part * peak), random.uniform(3.0, 10.0));
            self.ramp(ramp_s, rates, true);
            self.ramp(ramp_s, rates, false);
            self.push(random.uniform(15.0, 50.0), vec![]);
        }
    }

    /// Three sines about each axis in whole periods.
    fn hand(&mut self, unit: &DeviceUnit, random: &mut Noise, duration_s: f64) {
        while self.end_s() < duration_s {
            let length_s = random.uniform(20.0, 60.0);
            let mut terms = Vec::new();
            for axis in 0..3 {
                for _ in 0..3 {
                    let periods = (length_s * random.uniform(0.3, 2.0)).round();
                    let mut rates_arcsec_s = [0.0; 3];
                    rates_arcsec_s[axis] = unit.hand_deg_s * ARCSEC_PER_DEG / 3.0 * random.uniform(0.3, 1.0);
                    terms.push(Term { rates_arcsec_s, rad_per_s: TAU * periods / length_s, phase_rad: 0.0 });
                }
            }
            self.push(length_s, terms);
            self.push(random.uniform(3.0, 10.0), vec![]);
        }
    }

    /// Rates in arcsec/s and their integrals in arcsec about the control axes.
    pub fn at(&self, t: f64) -> ([f64; 3], [f64; 3]) {
        let index = self.segments.partition_point(|segment| segment.start_s <= t).saturating_sub(1);
        let (rates, angles) = self.segments[index].at(t);
        let (more_rates, more_angles) = self.background.at(t);
        (std::array::from_fn(|axis| rates[axis] + more_rates[axis]), sum(angles, more_angles))
    }
}

fn sum(one: [f64; 3], other: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| one[axis] + other[axis])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_closed_integral_of_the_rates_is_their_sum_over_small_steps() {
        for kind in DeviceMotionKind::ALL {
            let unit = DeviceUnit::stim300();
            let motion = DeviceMotion::drawn(kind, &unit, &mut Noise::new(1, 0), 100.0);
            let (mut sums, step_s) = ([0.0; 3], 1e-3);
            let mut turned = 0.0f64;
            for step in 0..100_000 {
                let (rates, _) = motion.at((f64::from(step) + 0.5) * step_s);
                sums = sum(sums, rates.map(|rate| rate * step_s));
                turned = turned.max(sums[0].abs());
            }
            let (_, angles) = motion.at(100.0);
            for axis in 0..3 {
                // Middle rule: jerk of some 10⁷ arcsec/s³ at 2 Hz × (1 ms)²/24 × 100 s, of which most cancels.
                assert!((sums[axis] - angles[axis]).abs() < 0.5, "{kind:?}: {sums:?} {angles:?}");
            }
            assert!(turned > 3600.0, "{kind:?} turns by {turned} arcsec");
        }
    }

    #[test]
    fn rates_are_continuous() {
        for kind in DeviceMotionKind::ALL {
            let motion = DeviceMotion::drawn(kind, &DeviceUnit::stim300(), &mut Noise::new(2, 0), 300.0);
            let mut before = [0.0; 3];
            for step in 0..300_000 {
                let (rates, _) = motion.at(f64::from(step) * 1e-3);
                for axis in 0..3 {
                    // 1000 deg/s² at most.
                    assert!((rates[axis] - before[axis]).abs() < 3600.0, "{kind:?} at {step} ms");
                }
                before = rates;
            }
        }
    }
}
