//! Motions that have not been recorded, as recordings.

use std::sync::Arc;

use geu_calibration::AccumulatedCounts;
use geu_model::Configuration;
use geu_model::attitude::RecordedAttitude;
use geu_model::units::ORBIT_S;

use super::model_cache::ModelCache;
use super::series::{ModelRun, TIMING};
use super::{BLOCK, Block, MeasuredData};
use crate::accelerations::AccelerationDrifts;
use crate::trial_drifts::TrialDrifts;

/// A motion that has not been recorded.
#[derive(Debug, Clone)]
pub struct PlannedMotion {
    /// The motion; time 0 is that of node 0.
    pub motion: RecordedAttitude,
    /// Number of samples.
    pub samples: usize,
}

impl MeasuredData {
    /// A planned motion as a recording that follows this one, at the temperatures of the last orbit. If less than an orbit is recorded,
    /// the temperature of the electronics changes as configured.
    pub fn followed_by(&self, planned: PlannedMotion, nominal: &Configuration) -> MeasuredData {
        let PlannedMotion { motion, samples } = planned;
        let orbit = (ORBIT_S / self.interval_s()) as usize;
        let last = |celsius: &[f64], period: usize| -> Vec<f64> {
            let last = celsius.get(celsius.len().saturating_sub(period)..).unwrap_or_default();
            last.iter().cycle().take(samples + 1).copied().collect()
        };
        let is_orbit = self.counts.electronics_c.len() > orbit;
        let period = if is_orbit { orbit } else { 1 };
        let [mut electronics_c, sensor_c] =
            [&self.counts.electronics_c, &self.counts.sensor_c].map(|celsius| last(celsius, period));
        if !is_orbit {
            let configured =
                |node: usize| nominal.electronics.at_c(self.duration_s() + node as f64 * self.interval_s());
            let change = (0..=samples).map(|node| configured(node) - configured(0));
            electronics_c.iter_mut().zip(change).for_each(|(celsius, change)| *celsius += change);
        }
        let mut counts = AccumulatedCounts::of_unit(self.gyros(), self.interval_s(), self.counts.start_ns);
        counts.is_received = self.counts.is_received;
        counts.rounded_to.clone_from(&self.counts.rounded_to);
        (counts.electronics_c, counts.sensor_c) = (electronics_c, sensor_c);
        counts.accumulated = vec![vec![0.0; samples + 1]; self.gyros().heads()];
        let of_channel = |channel: usize| {
            let is_good = self.is_usable(channel);
            let count = if self.blocks[channel].is_empty() { 0 } else { samples / BLOCK };
            (0..count)
                .map(|number| Block { is_good, is_compared: is_good, restarts: number == 0, begins_trial: false })
                .collect()
        };
        MeasuredData {
            counts,
            reference: Arc::new(motion),
            smoothed: None,
            noise_scale: None,
            reference_sigma: None,
            glitches_s: Vec::new(),
            samples,
            weights: Default::default(),
            blocks: std::array::from_fn(of_channel),
            runs: ModelCache::default(),
            late: vec![0.0; samples + 1],
            lag_s: self.lag_s,
            clock_ppm: self.clock_ppm,
            trial_drifts: TrialDrifts::default(),
            accelerations: AccelerationDrifts::default(),
            start_s: self.start_s + self.duration_s(),
        }
    }

    /// This motion with the counts and sample ends of a model run.
    #[must_use]
    pub fn with_counts(&self, run: ModelRun) -> MeasuredData {
        let mut with = self.clone();
        let mut run = run.map(Arc::unwrap_or_clone);
        with.late = std::mem::take(&mut run[TIMING]);
        with.counts.accumulated = run.into_iter().take(self.gyros().heads()).collect();
        with
    }

    /// The first `samples` of the recording repeated right after it, with the electronics at other temperatures.
    pub fn again(&self, samples: usize, electronics_c: impl Fn(f64) -> f64) -> MeasuredData {
        let mut again = self.clone();
        again.samples = samples.min(self.samples);
        for channel in &mut again.blocks {
            channel.truncate(again.samples / BLOCK);
            channel.iter_mut().take(1).for_each(|first| first.restarts = true);
        }
        again.counts.electronics_c.iter_mut().for_each(|celsius| *celsius = electronics_c(*celsius));
        again.start_s += self.duration_s();
        again
    }
}
