//! What was measured: counts at nodes, when they were received, temperatures, and the motion that a better sensor saw; on
//! one time scale, whose 0 is the start of the first sample interval.

mod model;
mod runs;
mod series;

use std::sync::Arc;

use geu_calibration::AccumulatedCounts;
use geu_model::attitude::RecordedAttitude;
use geu_model::units::{ORBIT_S, SAMPLE_INTERVAL_S};
use geu_recording::ReferenceAttitude;

pub use series::{CHANNELS, Series, Shifts, TIMING};

use runs::ModelCache;
use series::TIMING_UNIT_S;

/// Samples averaged into one block, 5 s. Rounding and whatever swings with the limit cycle's period averages out; a missing
/// effect moves an angle over minutes.
pub const BLOCK: usize = 10;
/// Length of a block, s.
pub const BLOCK_S: f64 = BLOCK as f64 * SAMPLE_INTERVAL_S;
/// Length of a reading worth a diagnosis: 10 min.
const LEAST_BLOCKS: usize = 120;

/// Why nothing can be told.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MeasuredError {
    /// The recording has no sample.
    #[error("the recording: expected samples, got none; `geu decode` tells what is in it")]
    Empty,
    /// Recording and reference have too little in common.
    #[error(
        "the recording ({from_s:.1}…{to_s:.1} s) and the reference ({reference_from_s:.1}…{reference_to_s:.1} s): expected at least 10 min in common, got {common_s:.1} s"
    )]
    NoOverlap {
        /// Start of the recording.
        from_s: f64,
        /// Its end.
        to_s: f64,
        /// Start of the reference.
        reference_from_s: f64,
        /// Its end.
        reference_to_s: f64,
        /// What they have in common.
        common_s: f64,
    },
    /// Too much of it is lost.
    #[error(
        "the recording: expected at least 10 min of one gyro beside the reference, without lost, clipped or invalid samples, got {good_s:.0} s of {common_s:.0} s; `geu decode` tells what is lost"
    )]
    Broken {
        /// What can be used of the gyro that has most.
        good_s: f64,
        /// What recording and reference have in common.
        common_s: f64,
    },
}

/// Ten samples of one channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block {
    /// Whether its nodes can be trusted.
    pub is_good: bool,
    /// Whether the sum begins anew in it or before it: what was accumulated between is not known.
    pub restarts: bool,
}

/// A recording beside its reference.
#[derive(Debug, Clone)]
pub struct MeasuredData {
    /// What was counted.
    pub counts: AccumulatedCounts,
    /// The motion; time 0 is that of node 0.
    pub reference: Arc<RecordedAttitude>,
    /// Samples up to the end of the reference.
    pub samples: usize,
    /// Blocks of each channel. The channel of the times has good ones only where times were received.
    pub blocks: [Vec<Block>; CHANNELS],
    /// Runs of the model on it: nothing that they depend on may move after the first; a copy begins anew.
    runs: ModelCache,
    /// Time of receipt of each node less nominal samples, in units of [`TIMING_UNIT_S`]; NaN where none came.
    late: Vec<f64>,
    /// Time of node 0 since the start that courses count from: 0 but for a flight that follows a recording.
    start_s: f64,
}

/// A flight that was not measured, yet may be.
#[derive(Debug, Clone)]
pub struct PlannedMotion {
    /// Its motion; time 0 is that of node 0.
    pub motion: RecordedAttitude,
    /// Samples of it.
    pub samples: usize,
}

impl MeasuredData {
    /// Sets counts beside their reference.
    ///
    /// # Errors
    /// [`MeasuredError`], where there is not enough of either.
    pub fn new(counts: AccumulatedCounts, reference: &ReferenceAttitude) -> Result<MeasuredData, MeasuredError> {
        if counts.is_empty() {
            return Err(MeasuredError::Empty);
        }
        let start_s = (reference.start_ns - counts.start_ns) as f64 * 1e-9;
        let reference = RecordedAttitude::clone(&reference.truth).starting_at(start_s);
        // Beside the ends of the reference a spline bends more than the motion does.
        let covered = |node_s: f64| node_s >= start_s && node_s <= reference.end_s();
        let samples = counts.node_s.partition_point(|&node_s| node_s <= reference.end_s()).saturating_sub(1);
        let common_s = (counts.end_s().min(reference.end_s()) - start_s.max(0.0)).max(0.0);
        let count = samples / BLOCK;
        let mut late = vec![f64::NAN; counts.node_s.len()];
        for &(node, late_s) in &counts.received_late_s {
            late[node] = late_s / TIMING_UNIT_S;
        }
        let mut blocks: [Vec<Block>; CHANNELS] =
            std::array::from_fn(|_| vec![Block { is_good: true, restarts: false }; count]);
        for (index, channel) in blocks.iter_mut().enumerate() {
            for (number, block) in channel.iter_mut().enumerate() {
                let nodes = nodes(number);
                let is_known = match index {
                    TIMING => late[nodes].iter().any(|late| !late.is_nan()),
                    _ => counts.node_s[nodes].iter().all(|&node_s| covered(node_s)),
                };
                (block.is_good, block.restarts) = (is_known, !is_known && index != TIMING);
            }
        }
        let good = |blocks: &[Vec<Block>; CHANNELS]| {
            let of_channel = |channel: &Vec<Block>| channel.iter().filter(|block| block.is_good).count();
            blocks[..TIMING].iter().map(of_channel).max().unwrap_or(0)
        };
        let covered = good(&blocks);
        for found in &counts.breaks {
            // The block in which the sum is lost, and all that it touches.
            for (index, channel) in blocks.iter_mut().enumerate() {
                let concerns = match index {
                    TIMING => {
                        found.kind == geu_calibration::BreakKind::TimeJump
                            || matches!(
                                found.kind,
                                geu_calibration::BreakKind::Jump | geu_calibration::BreakKind::Reset
                            )
                    }
                    gyro => found.gyros[gyro],
                };
                let last = found.to.saturating_sub(1) / BLOCK;
                for block in channel.iter_mut().take(last + 1).skip(found.from / BLOCK).filter(|_| concerns) {
                    *block = Block { is_good: false, restarts: true };
                }
            }
        }
        let good = good(&blocks);
        if good < LEAST_BLOCKS {
            if covered >= LEAST_BLOCKS {
                return Err(MeasuredError::Broken { good_s: good as f64 * BLOCK_S, common_s });
            }
            let at = counts.start_ns as f64 * 1e-9;
            return Err(MeasuredError::NoOverlap {
                from_s: at,
                to_s: at + counts.end_s(),
                reference_from_s: at + start_s,
                reference_to_s: at + reference.end_s(),
                common_s,
            });
        }
        let (reference, runs) = (Arc::new(reference), ModelCache::default());
        Ok(MeasuredData { counts, reference, samples, blocks, runs, late, start_s: 0.0 })
    }

    /// How long it is, s.
    pub fn duration_s(&self) -> f64 {
        self.samples as f64 * SAMPLE_INTERVAL_S
    }

    /// A flight as it would be recorded after this recording, at the temperatures of an orbit before.
    pub fn followed_by(&self, flight: PlannedMotion) -> MeasuredData {
        let PlannedMotion { motion, samples } = flight;
        let again = |celsius: &[f64]| -> Vec<f64> {
            let orbit = (ORBIT_S / SAMPLE_INTERVAL_S) as usize;
            // Of less than an orbit nothing tells how it goes on.
            let period = if celsius.len() > orbit { orbit } else { 1 };
            let last = celsius.get(celsius.len().saturating_sub(period)..).unwrap_or_default();
            last.iter().cycle().take(samples + 1).copied().collect()
        };
        let mut counts = AccumulatedCounts::starting_at(self.counts.start_ns);
        counts.is_received = self.counts.is_received;
        (counts.electronics_c, counts.sensor_c) = (again(&self.counts.electronics_c), again(&self.counts.sensor_c));
        counts.accumulated = std::array::from_fn(|_| vec![0.0; samples + 1]);
        let of_channel = |channel: usize| {
            let is_good = self.blocks[channel].iter().any(|block| block.is_good);
            let block = |number: usize| Block { is_good, restarts: number == 0 };
            (0..samples / BLOCK).map(block).collect()
        };
        MeasuredData {
            counts,
            reference: Arc::new(motion),
            samples,
            blocks: std::array::from_fn(of_channel),
            runs: ModelCache::default(),
            late: vec![0.0; samples + 1],
            start_s: self.start_s + self.duration_s(),
        }
    }

    /// The first `samples` of the recording, flown once more right after it, with the electronics at other temperatures.
    pub fn again(&self, samples: usize, electronics_c: impl Fn(f64) -> f64) -> MeasuredData {
        let mut again = self.clone();
        again.samples = samples.min(self.samples);
        for channel in &mut again.blocks {
            channel.truncate(again.samples / BLOCK);
            if let Some(first) = channel.first_mut() {
                first.restarts = true;
            }
        }
        again.counts.electronics_c.iter_mut().for_each(|celsius| *celsius = electronics_c(*celsius));
        again.start_s += self.duration_s();
        again
    }

    /// Blocks of each channel.
    pub fn block_count(&self) -> usize {
        self.blocks[0].len()
    }

    /// Middle of a block, s.
    pub fn middle_s(block: usize) -> f64 {
        (block as f64 + 0.5) * BLOCK_S + 0.5 * SAMPLE_INTERVAL_S
    }

    /// What was measured at each node, as [`MeasuredData::run`] tells it of a model.
    pub fn series(&self) -> Series {
        let nodes = self.samples + 1;
        std::array::from_fn(|channel| match channel {
            TIMING => self.late[..nodes].to_vec(),
            gyro => self.counts.accumulated[gyro][..nodes].to_vec(),
        })
    }

    /// Averages over blocks of what was measured less what a model tells, 0 where a block is not good.
    pub fn residual(&self, model: &Series) -> Series {
        std::array::from_fn(|channel| {
            let of_node = |node: usize| match channel {
                TIMING => self.late[node] - model[TIMING][node],
                gyro => self.counts.accumulated[gyro][node] - model[gyro][node],
            };
            self.averages(channel, of_node)
        })
    }

    /// Averages over blocks of the difference of two runs, good or not.
    pub fn difference(&self, moved: &Series, from: &Series) -> Series {
        std::array::from_fn(|channel| {
            let average = |number: usize| {
                nodes(number).map(|node| moved[channel][node] - from[channel][node]).sum::<f64>() / BLOCK as f64
            };
            (0..self.block_count()).map(average).collect()
        })
    }

    /// Electronics temperature of each block, °C.
    pub fn electronics_c(&self) -> Vec<f64> {
        let of_block = |number: usize| self.counts.electronics_c[nodes(number)].iter().sum::<f64>() / BLOCK as f64;
        (0..self.block_count()).map(of_block).collect()
    }

    fn averages(&self, channel: usize, of_node: impl Fn(usize) -> f64) -> Vec<f64> {
        let average = |(number, block): (usize, &Block)| {
            if !block.is_good {
                return 0.0;
            }
            if channel == TIMING {
                // A stamp may be late by any time: the middle one.
                let mut known: Vec<f64> = nodes(number).map(&of_node).filter(|value| !value.is_nan()).collect();
                let middle = known.len() / 2;
                return *known.select_nth_unstable_by(middle, f64::total_cmp).1;
            }
            nodes(number).map(&of_node).sum::<f64>() / BLOCK as f64
        };
        self.blocks[channel].iter().enumerate().map(average).collect()
    }
}

/// Nodes of a block: node 0 is the start.
pub fn nodes(block: usize) -> std::ops::Range<usize> {
    1 + block * BLOCK..1 + (block + 1) * BLOCK
}

#[cfg(test)]
mod tests {
    use super::*;
    use geu_calibration::{BreakKind, Discontinuity};
    use geu_model::attitude::AttitudeRow;

    /// Samples at rest from `start_s` of the reference on, which has 1500 s; one in so many is lost.
    fn refused(start_s: f64, lost_each: usize) -> String {
        let row = |node: usize| AttitudeRow {
            t_s: node as f64 * SAMPLE_INTERVAL_S,
            angle_control_arcsec: [0.0; 3],
            theta_psi_rad: Some((1.5, 0.0)),
        };
        let rows: Vec<AttitudeRow> = (0..=3000).map(row).collect();
        let truth = Arc::new(RecordedAttitude::new(&rows).expect("a truth"));
        let mut counts = AccumulatedCounts::starting_at((start_s * 1e9) as i64);
        (1..=2400).for_each(|node| counts.push(node as f64 * SAMPLE_INTERVAL_S, [0.0; 4], 20.0));
        let lost = |node: usize| Discontinuity { from: node, to: node + 1, gyros: [true; 4], kind: BreakKind::Gap(1) };
        counts.breaks = (1..2400).step_by(lost_each).map(lost).collect();
        MeasuredData::new(counts, &ReferenceAttitude { start_ns: 0, truth, time_system: None })
            .expect_err("too little")
            .to_string()
    }

    #[test]
    fn too_little_in_common_and_too_much_lost_are_told_apart() {
        let apart = refused(1000.0, 2400);
        assert!(apart.contains("in common, got 500.0 s"), "{apart}");
        let broken = refused(0.0, 15);
        assert!(broken.contains("invalid samples, got 400 s of 1200 s"), "{broken}");
    }
}
