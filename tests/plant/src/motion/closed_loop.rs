//! A spacecraft that its attitude control turns by the unit's own counts: slews at 0.2°/s and rests.
//!
//! Each axis is a double integrator. At the end of each sample the control sets the acceleration until the next one from the angle and
//! rate by the counts of GYRX, GYRY and GYRZA, so that the motion answers their rounding.

use crate::SAMPLE_INTERVAL_S;
use crate::noise::Noise;
use crate::unit::REFERENCE_UNIT;

const SLEW_ARCSEC_S: f64 = 720.0;
const ACCELERATION_ARCSEC_S2: f64 = 18.0;
/// Largest rate at the start.
const INITIAL_ARCSEC_S: f64 = 10.0;
const ARCSEC_PER_DEG: f64 = 3600.0;
const DAMPING: f64 = 0.7;

/// A constant acceleration.
struct Arc {
    start_s: f64,
    rates: [f64; 3],
    accelerations: [f64; 3],
}

/// A commanded turn about an axis.
struct Slew {
    start_s: f64,
    axis: usize,
    /// Signed.
    rate: f64,
    duration_s: f64,
}

pub struct ClosedLoop {
    arcs: Vec<Arc>,
    slews: Vec<Slew>,
    /// Bandwidth, rad/s.
    bandwidth: f64,
    /// Angle by the counts minus that commanded.
    error_arcsec: [f64; 3],
    commanded: [f64; 3],
}

impl ClosedLoop {
    pub fn drawn(random: &mut Noise, duration_s: f64) -> ClosedLoop {
        let rates = [0; 3].map(|_| random.uniform(-INITIAL_ARCSEC_S, INITIAL_ARCSEC_S));
        let arcs = vec![Arc { start_s: f64::NEG_INFINITY, rates, accelerations: [0.0; 3] }];
        let bandwidth = random.uniform(0.06, 0.15);
        let mut slews: Vec<Slew> = Vec::new();
        let mut end_s = random.uniform(300.0, 600.0);
        while end_s < duration_s {
            let axis = if slews.len() < 6 { slews.len() / 2 } else { random.one_of(&[0, 1, 2]) };
            let sign = if slews.len().is_multiple_of(2) { 1.0 } else { -1.0 };
            let duration_s = random.uniform(30.0, 90.0) * ARCSEC_PER_DEG / SLEW_ARCSEC_S;
            slews.push(Slew { start_s: end_s, axis, rate: sign * SLEW_ARCSEC_S, duration_s });
            end_s += duration_s + random.uniform(150.0, 500.0);
        }
        ClosedLoop { arcs, slews, bandwidth, error_arcsec: [0.0; 3], commanded: [0.0; 3] }
    }

    pub fn at(&self, t: f64) -> [f64; 3] {
        let arc = &self.arcs[self.arcs.partition_point(|arc| arc.start_s <= t).saturating_sub(1)];
        let since_s = if arc.start_s.is_finite() { t - arc.start_s } else { 0.0 };
        std::array::from_fn(|axis| arc.rates[axis] + arc.accelerations[axis] * since_s)
    }

    /// Commanded rate.
    fn command(&self, t: f64) -> [f64; 3] {
        let mut rates = [0.0; 3];
        for slew in &self.slews {
            let (since_s, left_s) = (t - slew.start_s, slew.start_s + slew.duration_s - t);
            let reached = ACCELERATION_ARCSEC_S2 * since_s.min(left_s).max(0.0);
            rates[slew.axis] += slew.rate.clamp(-reached, reached);
        }
        rates
    }

    pub fn answer(&mut self, end_s: f64, counts: [i16; 4]) {
        let rates = self.at(end_s);
        let [now, next] = [end_s, end_s + SAMPLE_INTERVAL_S].map(|t| self.command(t));
        let before = std::mem::replace(&mut self.commanded, now);
        let accelerations = std::array::from_fn(|axis| {
            let (scale_factor, drift, _) = REFERENCE_UNIT[axis];
            let turned = f64::from(counts[axis]) * scale_factor + drift;
            self.error_arcsec[axis] += turned - (before[axis] + now[axis]) / 2.0 * SAMPLE_INTERVAL_S;
            let ahead = (next[axis] - now[axis]) / SAMPLE_INTERVAL_S;
            ahead
                - self.bandwidth * self.bandwidth * self.error_arcsec[axis]
                - 2.0 * DAMPING * self.bandwidth * (turned / SAMPLE_INTERVAL_S - now[axis])
        });
        self.arcs.push(Arc { start_s: end_s, rates, accelerations });
    }
}
