//! The gyros laid over the sun sensor's history, to rebuild the limit cycle at a reference time (Casteren figure 8).

use geu_model::sensor::{Fss, SensorNumbers};
use geu_model::units::ARCSEC_PER_RAD;

use super::data::AbsoluteData;
use super::path::{GyroPath, Station, interpolate};
use crate::counts::{AccumulatedCounts, Interpolation};
use crate::sun::{Point, step_control_arcsec};

/// Seconds on either side of a reference time over which the gyros are laid over the sun sensor.
pub(super) const OVERLAY_S: f64 = 30.0;
/// Minimum number of sun sensor samples for this.
pub(super) const MIN_OVERLAY_SAMPLES: usize = 20;
/// Error of the mean of θ from the sun sensor's steps, in steps, if motion carries θ over them: over a limit cycle of
/// 4″/s and 5 s, 3.2″ in steps of 4″, the mean of the rounded sine errs by 0.2″ (rms over where its middle lies).
pub(super) const LEVEL_STEPS: f64 = 1.0 / 20.0;
/// Scatter about the path, in steps, below which θ does not move over the steps; rounding that does scatters by 1/√12.
pub(super) const STILL_STEPS: f64 = 0.15;
/// Error of the limit cycle about X from the sun sensor's steps, in steps: a cycle about the sun's own plane meets as many
/// steps above as below, and most of their errors cancel.
pub(super) const CYCLE_STEPS: f64 = 1.0 / 80.0;

/// The gyros laid over the sun sensor's history (figure 8).
pub(super) struct Overlay<'a> {
    pub counts: &'a AccumulatedCounts,
    pub sensors: &'a AbsoluteData,
    pub numbers: &'a SensorNumbers,
    pub path: &'a GyroPath,
}

impl Overlay<'_> {
    /// Departure about X by the gyros, except for a constant, at nodes around a fix, arcsec: their rotation about X less that
    /// of their path and the sun. The path goes through this fix alone, so that no other bends it here. Also returns the
    /// first of these nodes.
    pub fn about_x_arcsec(&self, station: &Station, raised_rad: f64) -> (usize, Vec<f64>) {
        // Two nodes more than the samples need, for the four nodes of an interpolation.
        let (from_s, to_s) = (station.point.t_s - OVERLAY_S - 1.5, station.point.t_s + OVERLAY_S + 1.5);
        let first = self.counts.node_s.partition_point(|node_s| *node_s < from_s);
        let last = self.counts.node_s.partition_point(|node_s| *node_s <= to_s);
        let raised = |node: usize| {
            let point = self.path.unbent[node];
            Point { theta_rad: point.theta_rad + raised_rad, ..point }
        };
        let mut explained = 0.0;
        let about_x = (first..last).map(|node| {
            if node > first {
                explained += step_control_arcsec(&raised(node - 1), &raised(node))[0];
            }
            self.path.turned_control_arcsec[node][0] - explained
        });
        (first, about_x.collect())
    }

    pub fn samples(&self, from_s: f64, to_s: f64) -> impl Iterator<Item = (f64, &[f64; 2])> {
        let ns = |t_s: f64| self.counts.start_ns + (t_s * 1e9) as i64;
        let sun = &self.sensors.sun;
        let first = sun.partition_point(|sample| sample.0 < ns(from_s));
        let last = sun.partition_point(|sample| sample.0 <= ns(to_s));
        sun[first..last].iter().map(|(t_ns, angles)| ((t_ns - self.counts.start_ns) as f64 * 1e-9, angles))
    }

    /// Rotation about X out of the attitude of θ and ψ at a fix: that of the gyros, with the constant and the slope that
    /// lay them over the sun sensor around the fix.
    pub fn limit_cycle_x_arcsec(&self, station: &Station) -> Option<f64> {
        let t_s = station.point.t_s;
        let theta_at = |reading: &Interpolation| interpolate(&self.path.unbent, reading).theta_rad;
        let raised_rad = station.point.theta_rad - theta_at(&station.reading);
        let (first, about_x_arcsec) = self.about_x_arcsec(station, raised_rad);
        let gyros = |reading: &Interpolation| {
            let from = reading.first.checked_sub(first)?;
            let nodes = about_x_arcsec.get(from..from + reading.weights.len())?;
            Some(reading.weights.iter().zip(nodes).map(|(weight, value)| weight * value).sum::<f64>())
        };
        let (mut count, mut sums) = (0, [0.0; 5]);
        for (sample_s, angles) in self.samples(t_s - OVERLAY_S, t_s + OVERLAY_S) {
            let Some(reading) = self.counts.at(sample_s) else { continue };
            let Some(gyros) = gyros(&reading) else { continue };
            let theta_rad = theta_at(&reading) + raised_rad;
            // The sun leaves the XZ plane by the turn about X times sin θ.
            let difference = angles[1] / libm::sin(theta_rad) - gyros;
            let x = sample_s - t_s;
            count += 1;
            for (sum, term) in sums.iter_mut().zip([1.0, x, x * x, difference, x * difference]) {
                *sum += term;
            }
        }
        let [n, x, xx, y, xy] = sums;
        let spread = n * xx - x * x;
        if count < MIN_OVERLAY_SAMPLES || spread <= 0.0 {
            return None;
        }
        Some(gyros(&station.reading)? + (xx * y - x * xy) / spread)
    }

    /// Mean of the sun sensor's θ less that of the gyros' path between two instants, arcsec, and its variance. `bend_rad`
    /// gives the bend of the path at a number of samples.
    pub fn level(&self, from_s: f64, to_s: f64, bend_rad: impl Fn(f64) -> f64) -> Option<(f64, f64)> {
        let (mut count, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for (sample_s, angles) in self.samples(from_s, to_s) {
            let Some(reading) = self.counts.at(sample_s) else { continue };
            let theta_rad = interpolate(&self.path.unbent, &reading).theta_rad + bend_rad(reading.samples);
            let above = angles[0] - theta_rad * ARCSEC_PER_RAD;
            count += 1.0;
            sum += above;
            squares += above * above;
        }
        if count < MIN_OVERLAY_SAMPLES as f64 {
            return None;
        }
        let mean = sum / count;
        let Fss { step_arcsec, noise_arcsec } = self.numbers.fss;
        let is_still = squares / count - mean * mean < (STILL_STEPS * step_arcsec).powi(2);
        let steps = if is_still { 1.0 / 12.0 } else { LEVEL_STEPS * LEVEL_STEPS };
        Some((mean, steps * step_arcsec * step_arcsec + noise_arcsec * noise_arcsec / count))
    }
}
