//! Drifts of the gyros in the further trials of a recording, beside those in the first one.
//!
//! The whitening filter leaves them free, so that no effect is taken for one. They are estimated and taken from the counts only for the
//! residuals and for a reference that is smoothed.

use geu_calibration::AccumulatedCounts;
use geu_calibration::solve::PER_GYRO;
use geu_checks::Finding;
use geu_model::units::{S_PER_H, SAMPLE_INTERVAL_S};
use geu_protocol::Gyros;
use geu_recording::Trial;

use crate::diagnosis_case::DiagnosisCase;
use crate::measured::{Block, Series, block_at};
use crate::model_state::ModelState;
use crate::whitening::NoiseModel;

/// A further trial, and what is subtracted from its counts.
#[derive(Debug, Clone)]
struct TrialDrift {
    name: String,
    /// Start and end since node 0, s.
    from_s: f64,
    to_s: f64,
    /// Drift of each gyro and its sigma, counts/s; the sigma is infinite without data.
    drifts: Vec<(f64, f64)>,
}

/// Drifts of all further trials.
#[derive(Debug, Clone, Default)]
pub struct TrialDrifts(Vec<TrialDrift>);

impl TrialDrifts {
    /// None yet. The times of the trials are 0 at `start_s`.
    pub fn none(trials: &[Trial], start_s: f64, gyros: Gyros) -> TrialDrifts {
        let drifts = vec![(0.0, f64::INFINITY); gyros.heads()];
        let of_trial = |trial: &Trial| TrialDrift {
            name: trial.name.clone(),
            from_s: trial.from_s + start_s,
            to_s: trial.to_s + start_s,
            drifts: drifts.clone(),
        };
        // The first one is that in which the recording begins.
        let in_recording = trials.iter().filter(|trial| trial.to_s + start_s > 0.0);
        TrialDrifts(in_recording.skip(1).map(of_trial).collect())
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Takes from counts the drifts that are left in the residual of a state.
    pub fn subtract(
        &mut self,
        (counts, residual): (&mut AccumulatedCounts, &Series),
        case: &DiagnosisCase,
        state: &ModelState,
    ) {
        let block_s = case.measured.block_s();
        for trial in &mut self.0 {
            let [from, to] = [trial.from_s, trial.to_s].map(|t_s| block_at(counts, t_s));
            for (gyro, drift) in trial.drifts.iter_mut().enumerate() {
                let to = (to + 1).min(residual[gyro].len());
                let Some(values) = residual[gyro].get(from..to) else { continue };
                let blocks = &case.measured.blocks[gyro][from..to];
                let (left, sigma) = slope(values, blocks, &state.noise[gyro], block_s);
                // Of the drift in the first trial, counts per 0.5 s.
                let first = state.calibration_sigmas[PER_GYRO * gyro + 1] / SAMPLE_INTERVAL_S;
                *drift = (drift.0 + left, sigma.hypot(first));
                for (sum, node_s) in counts.accumulated[gyro].iter_mut().zip(&counts.node_s) {
                    *sum -= left * (node_s.clamp(trial.from_s, trial.to_s) - trial.from_s);
                }
            }
        }
    }

    pub fn findings(&self, case: &DiagnosisCase) -> Vec<Finding> {
        let angle = case.nominal.device.angle_unit();
        let finding = |trial: &TrialDrift| {
            let names = case.nominal.device.heads.iter().map(|head| head.gyro.name());
            let known = names.zip(&trial.drifts).filter(|(_, drift)| drift.1.is_finite());
            let value = |(name, (drift, sigma)): (&str, &(f64, f64))| {
                // A drift turns the reference, not the measured angle.
                format!("{name} {} ± {}", angle.fixed(-drift * S_PER_H, 1), angle.fixed(sigma * S_PER_H, 1))
            };
            let values: Vec<String> = known.map(value).collect();
            let values = if values.is_empty() { "not known".to_owned() } else { values.join(", ") };
            Finding {
                kind: "trial-drift".to_owned(),
                place: format!("trial {}, {:.1}\u{2013}{:.1} s", trial.name, trial.from_s, trial.to_s),
                text: format!("drift beside that of the first trial, {}/h: {values}", angle.name),
            }
        };
        self.0.iter().map(finding).collect()
    }
}

/// Slope of block averages, per s, and its sigma. Each part between restarts has a level of its own.
fn slope(values: &[f64], blocks: &[Block], noise: &NoiseModel, block_s: f64) -> (f64, f64) {
    let known: Vec<usize> = (0..blocks.len()).filter(|&block| blocks[block].is_compared).collect();
    let (mut products, mut squares, mut walks) = (0.0, 0.0, 0.0);
    for part in known.chunk_by(|one, other| one + 1 == *other && !blocks[*other].restarts) {
        let count = part.len() as f64;
        let middle = part.iter().map(|&block| block as f64).sum::<f64>() / count;
        let level = part.iter().map(|&block| values[block]).sum::<f64>() / count;
        let mut own = 0.0;
        for &block in part {
            let t_s = (block as f64 - middle) * block_s;
            products += t_s * (values[block] - level);
            own += t_s * t_s;
        }
        // Of a line through a walk.
        walks += 1.2 * (noise.angle_walk * own).powi(2) / (count * block_s);
        squares += own;
    }
    if squares == 0.0 {
        return (0.0, f64::INFINITY);
    }
    (products / squares, (walks / squares + noise.white).sqrt() / squares.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_is_that_within_the_parts() {
        let mut blocks = vec![Block::COMPARED; 40];
        blocks[15] = Block::BROKEN;
        let value = |block: usize| if block < 15 { 0.5 * block as f64 } else { 900.0 + 0.5 * block as f64 };
        let values: Vec<f64> = (0..40).map(value).collect();
        let noise = NoiseModel { white: 0.0, angle_walk: 0.1, rate_walk: 0.0, scale_walk: 0.0, flicker: 0.0 };
        let (drift, sigma) = slope(&values, &blocks, &noise, 2.0);
        assert!((drift - 0.25).abs() < 1e-12 && (sigma - 0.1 * (1.2 / 48.0f64).sqrt()).abs() < 0.2 * sigma);
        blocks.iter_mut().for_each(|block| block.is_compared = false);
        assert_eq!(slope(&values, &blocks, &noise, 2.0), (0.0, f64::INFINITY));
    }
}
