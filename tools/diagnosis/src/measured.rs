//! A recording beside its reference: counts at nodes, receive times, temperatures and the reference motion, on one time scale whose 0
//! is the start of the first sample interval.

mod blocks;
mod dequantised;
mod error;
mod filled_gaps;
mod model;
mod model_cache;
mod planned;
mod reference_motion;
mod reference_sigma;
mod relative_rows;
mod series;
mod smoothed_reference;
mod smoothing;
mod temperature;
mod turns;

use geu_checks::median;
use std::borrow::Cow;
use std::sync::Arc;

use geu_calibration::AccumulatedCounts;
use geu_model::Configuration;
use geu_model::attitude::RecordedAttitude;
use geu_protocol::Gyros;
use geu_recording::ReferenceAttitude;

use crate::accelerations::AccelerationDrifts;
use crate::trial_drifts::TrialDrifts;
pub use blocks::{BLOCK, Block, block_at, nodes};
use blocks::{begin_trials, covered_blocks, leave_out, leave_out_without_rows};
use dequantised::{DequantisedAngles, dequantise};
pub use error::{MAX_ROW_S, MeasuredError};
pub use planned::PlannedMotion;
use reference_motion::ReferenceMotion;
pub use reference_sigma::ReferenceSigma;
pub use series::{CHANNELS, ModelRun, Series, Shifts, TIMING};
use smoothed_reference::SmoothedReference;

use geu_calibration::without_coning;
use model_cache::ModelCache;
use series::{TIMING_UNIT_S, without};
use temperature::between_readings;

/// Minimum usable number of blocks, of the default unit 10 min.
const MIN_BLOCKS: usize = 120;

/// Number of counts that may contradict a path: more, and it is not that of the gyro.
const MAX_CONTRADICTIONS: usize = 20;
/// Logarithm of the ratio of likelihoods from which a path with effects is preferred: more than any effect requires, χ² of 40.
const LIKELIER: f64 = 20.0;

/// A recording beside its reference.
#[derive(Debug, Clone)]
pub struct MeasuredData {
    /// Accumulated counts.
    pub counts: AccumulatedCounts,
    /// The motion; time 0 is that of node 0.
    pub reference: Arc<RecordedAttitude>,
    /// Traces of the smoothing in a reference that is noisy or slow.
    pub smoothed: Option<Arc<SmoothedReference>>,
    /// The stated sigmas of its rows, if there are any.
    pub reference_sigma: Option<ReferenceSigma>,
    /// Times of its rows that are left out, s.
    pub glitches_s: Vec<f64>,
    /// Samples up to the end of the reference.
    pub samples: usize,
    /// Weights of the nodes of gyros of which the angles are dequantised, counts⁻².
    pub weights: [Option<Arc<Vec<f64>>>; TIMING],
    /// Variance of all noise of each gyro in each block, as a multiple of that of the noise model, if it differs.
    pub noise_scale: Option<Arc<[Vec<f64>; TIMING]>>,
    /// Blocks of each channel. The channel of the times has usable ones only with receive times.
    pub blocks: [Vec<Block>; CHANNELS],
    /// Model runs on this recording. The fields above must not change after the first run; a clone starts without runs.
    runs: ModelCache,
    /// Receive time of each node minus nominal samples, in units of [`TIMING_UNIT_S`]; NaN without one.
    late: Vec<f64>,
    /// Lag of the recording that the reference was moved by.
    pub lag_s: f64,
    /// Error of the clock by which the recording is aligned with the reference, ppm.
    pub clock_ppm: f64,
    /// Drifts of further trials that are taken from the counts.
    pub trial_drifts: TrialDrifts,
    /// Drifts by accelerations that are taken from the counts.
    pub accelerations: AccelerationDrifts,
    /// Time of node 0 since the origin of time courses: 0, or the end of the recording that a planned motion follows.
    pub(crate) start_s: f64,
}

impl MeasuredData {
    /// Combines counts and their reference.
    ///
    /// # Errors
    /// [`MeasuredError`], if there is not enough of either.
    pub fn new(
        counts: AccumulatedCounts,
        reference: &ReferenceAttitude,
        nominal: &Configuration,
    ) -> Result<MeasuredData, MeasuredError> {
        MeasuredData::combined(counts, reference, 0.0, Some(nominal), None)
    }

    /// Combines counts and their reference, moved by a lag. The gyros of a configuration, if any, smooth a reference that is noisy or slow; with
    /// what effects add to their counts, that is left out of the smoothing.
    pub(crate) fn combined(
        mut counts: AccumulatedCounts,
        reference: &ReferenceAttitude,
        lag_s: f64,
        calibrated: Option<&Configuration>,
        added: Option<&Series>,
    ) -> Result<MeasuredData, MeasuredError> {
        if counts.is_empty() {
            return Err(MeasuredError::Empty);
        }
        let readings = [&mut counts.electronics_c, &mut counts.sensor_c].into_iter();
        readings.for_each(|celsius| *celsius = between_readings(celsius));
        let start_s = (reference.start_ns - counts.start_ns) as f64 * 1e-9 + lag_s;
        // The model of the default unit turns about one axis in each interval, too.
        let is_turned = reference.is_attitude && counts.gyros.unit() != Gyros::ALL;
        let moved = RecordedAttitude::clone(&reference.truth).starting_at(start_s);
        // Only within the reference, not at its ends, is the interpolating spline accurate.
        let is_covered = |node: usize| (start_s..=moved.end_s()).contains(&counts.node_s[node]);
        let samples = counts.node_s.partition_point(|&node_s| node_s <= moved.end_s()).saturating_sub(1);
        let mut late = vec![f64::NAN; counts.node_s.len()];
        counts.received_late_s.iter().for_each(|&(node, late_s)| late[node] = late_s / TIMING_UNIT_S);
        let mut blocks = covered_blocks(&counts, samples, &late, is_covered);
        let good = |blocks: &[Vec<Block>; CHANNELS]| {
            let of_channel = |channel: &Vec<Block>| channel.iter().filter(|block| block.is_good).count();
            blocks[..TIMING].iter().map(of_channel).max().unwrap_or(0)
        };
        let covered = good(&blocks);
        leave_out(&counts.breaks, &mut blocks);
        begin_trials(
            &counts,
            reference.trials.iter().skip(1).map(|trial| start_s + trial.from_s).filter(|from_s| *from_s > 0.0),
            &mut blocks,
        );
        let good = good(&blocks);
        let common_s = (counts.end_s().min(moved.end_s()) - start_s.max(0.0)).max(0.0);
        let [good_s, min_s] = [good, MIN_BLOCKS].map(|count| (count * BLOCK) as f64 * counts.interval_s);
        if covered < MIN_BLOCKS {
            return Err(MeasuredError::NoOverlap {
                from_s: counts.start_s(),
                to_s: counts.start_s() + counts.end_s(),
                reference_from_s: counts.start_s() + start_s,
                reference_to_s: counts.start_s() + moved.end_s(),
                common_s,
                min_s,
            });
        }
        if good < MIN_BLOCKS {
            return Err(MeasuredError::Broken { good_s, common_s, min_s });
        }
        let ReferenceMotion { motion, smoothed, has_rows, sigma, glitches_s } =
            calibrated.map_or_else(ReferenceMotion::default, |calibrated| {
                let counts = added.map_or(Cow::Borrowed(&counts), |added| Cow::Owned(without(&counts, added)));
                ReferenceMotion::new(&counts, &moved, reference, calibrated, samples / BLOCK)
            });
        leave_out_without_rows(&has_rows, &mut blocks);
        // A smoothed motion has no coning.
        let is_turned = is_turned && smoothed.is_none();
        let motion = motion.unwrap_or(moved);
        let reference = Arc::new(if is_turned { without_coning(motion) } else { motion });
        Ok(MeasuredData {
            counts,
            reference,
            smoothed: smoothed.map(Arc::new),
            noise_scale: None,
            reference_sigma: sigma,
            glitches_s,
            samples,
            weights: Default::default(),
            blocks,
            runs: ModelCache::default(),
            late,
            lag_s,
            clock_ppm: 0.0,
            trial_drifts: TrialDrifts::default(),
            accelerations: AccelerationDrifts::default(),
            start_s: 0.0,
        })
    }

    /// Nominal interval of the nodes, s.
    pub fn interval_s(&self) -> f64 {
        self.counts.interval_s
    }

    /// Length of a block, s.
    pub fn block_s(&self) -> f64 {
        BLOCK as f64 * self.counts.interval_s
    }

    /// All gyros of the unit.
    pub fn gyros(&self) -> Gyros {
        self.counts.gyros
    }

    /// Duration, s.
    pub fn duration_s(&self) -> f64 {
        self.samples as f64 * self.counts.interval_s
    }

    /// True if the channel has a usable block.
    pub fn is_usable(&self, channel: usize) -> bool {
        self.blocks[channel].iter().any(|block| block.is_good)
    }

    /// Number of blocks of each channel.
    pub fn block_count(&self) -> usize {
        self.blocks[0].len()
    }

    /// Measured value of each channel at each node, as [`MeasuredData::run`] gives it for a model.
    pub fn series(&self) -> Series {
        std::array::from_fn(|channel| self.measured(channel).get(..=self.samples).unwrap_or_default().to_vec())
    }

    fn measured(&self, channel: usize) -> &[f64] {
        if channel == TIMING { &self.late } else { self.counts.accumulated.get(channel).map_or(&[], |own| own) }
    }

    /// Block averages of measurement minus model along the reference's own rows, 0 in blocks that are not usable.
    pub fn residual(&self, model: &ModelRun) -> Series {
        std::array::from_fn(|channel| {
            let measured = self.measured(channel);
            let departure =
                |number: usize| self.smoothed.as_ref().map_or(0.0, |smoothed| smoothed.departure[number][channel]);
            let average = |(number, block): (usize, &Block)| {
                let residual = |node: usize| measured[node] - model[channel][node];
                match channel {
                    _ if !block.is_compared => 0.0,
                    // A receive time may be late by any amount: the median.
                    TIMING => {
                        median(&mut nodes(number).map(residual).filter(|value| !value.is_nan()).collect::<Vec<_>>())
                    }
                    _ => self.average(channel, number, residual) - departure(number),
                }
            };
            self.blocks[channel].iter().enumerate().map(average).collect()
        })
    }

    /// Block averages of the difference of two runs, of all blocks.
    pub fn difference(&self, moved: &ModelRun, from: &ModelRun) -> Series {
        std::array::from_fn(|channel| {
            let average =
                |number: usize| self.average(channel, number, |node| moved[channel][node] - from[channel][node]);
            (0..self.blocks[channel].len()).map(average).collect()
        })
    }

    /// Average of a value over the nodes of a block.
    fn average(&self, channel: usize, block: usize, value: impl Fn(usize) -> f64) -> f64 {
        match self.weights.get(channel).and_then(Option::as_ref) {
            Some(weights) => {
                let sum = nodes(block).map(|node| weights[node] * value(node)).sum::<f64>();
                sum / nodes(block).map(|node| weights[node]).sum::<f64>()
            }
            None => nodes(block).map(value).sum::<f64>() / BLOCK as f64,
        }
    }

    /// The recording with angles in place of counts, estimated for each gyro along the first of these paths that its counts do not
    /// contradict, or along a later path if it is likelier by far. A gyro that contradicts all of them keeps its counts.
    #[must_use]
    pub fn dequantised(&self, paths: &[ModelRun], angle_walks: [f64; TIMING]) -> MeasuredData {
        let mut measured = self.clone();
        for (gyro, angle_walk) in angle_walks.into_iter().enumerate() {
            let Some(counts) = self.counts.accumulated.get(gyro) else { continue };
            let (blocks, interval_s) = (&self.blocks[gyro], self.counts.interval_s);
            let along = paths.iter().map(|path| dequantise(counts, &path[gyro], blocks, angle_walk, interval_s));
            let possible = along.filter(|own| own.contradictions <= MAX_CONTRADICTIONS);
            let likelier = |first: DequantisedAngles, other: DequantisedAngles| {
                if other.log_likelihood > first.log_likelihood + LIKELIER { other } else { first }
            };
            if let Some(own) = possible.reduce(likelier) {
                measured.counts.accumulated[gyro] = own.angles;
                measured.weights[gyro] = Some(Arc::new(own.weights));
            }
        }
        measured
    }

    /// Electronics temperature of each block, °C.
    pub fn electronics_c(&self) -> Vec<f64> {
        let of_block = |number: usize| self.counts.electronics_c[nodes(number)].iter().sum::<f64>() / BLOCK as f64;
        (0..self.block_count()).map(of_block).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use geu_calibration::{BreakKind, Discontinuity};
    use geu_model::attitude::AttitudeRow;
    use geu_model::units::SAMPLE_INTERVAL_S;

    /// Error for samples at rest from `start_s` of a reference of 1500 s, of which every `lost_each`-th sample is lost.
    fn rejected(start_s: f64, lost_each: usize) -> String {
        let row = |node: usize| AttitudeRow {
            t_s: node as f64 * SAMPLE_INTERVAL_S,
            angle_control_arcsec: [0.0; 3],
            theta_psi_rad: Some((1.5, 0.0)),
        };
        let rows: Vec<AttitudeRow> = (0..=3000).map(row).collect();
        let truth = Arc::new(RecordedAttitude::new(rows).expect("a truth"));
        let mut counts = AccumulatedCounts::starting_at((start_s * 1e9) as i64);
        (1..=2400).for_each(|node| counts.push(node as f64 * SAMPLE_INTERVAL_S, &[0.0; 4], 20.0));
        let lost = |node: usize| Discontinuity { from: node, to: node + 1, gyros: Gyros::ALL, kind: BreakKind::Gap(1) };
        counts.breaks = (1..2400).step_by(lost_each).map(lost).collect();
        MeasuredData::new(counts, &ReferenceAttitude::of_truth(0, truth), &Configuration::reference())
            .expect_err("too little")
            .to_string()
    }

    #[test]
    fn short_overlap_and_lost_samples_are_different_errors() {
        let short = rejected(1000.0, 2400);
        assert!(short.contains("in common, got 500.0 s"), "{short}");
        let broken = rejected(0.0, 15);
        assert!(broken.contains("invalid samples, got 400 s of 1200 s"), "{broken}");
    }
}
