//! Rounding errors of block averages, and the noise that depends on the motion of a block.
//!
//! A count is the difference of rounded angles, so that the error of a block's average depends on the motion alone: independent
//! roundings average out, but at rest and at rates near a simple fraction of a count per sample the error persists, up to half a count
//! over many blocks. The phase of the accumulated angle is not known well enough to predict it: it is a random number between 0 and 1.
//! Variance and correlation over this phase follow from the model's own path.

use geu_model::units::PPM;

use crate::measured::{BLOCK, CHANNELS, MeasuredData, ModelRun, TIMING, nodes};

/// Phases over which the statistics are taken.
const PHASES: usize = 32;
/// Correlation with the motion above which a recording is that of a closed loop, before effects are known: effects of fast motions
/// correlate too.
pub const CLOSED_LOOP: f64 = 0.2;
/// Limit of that correlation beside the effects found.
pub const CLOSED_LOOP_WITH_EFFECTS: f64 = 0.1;
/// Largest delay of a controller's answer, samples.
const MAX_LAG: usize = 6;
/// Samples on either side that define the slow part of a motion.
const NEIGHBOURS: usize = 10;
/// Minimum number of samples of a correlation: at 1000 independent ones its sigma is 0.03.
const MIN_NODES: usize = 1000;

/// Statistics of the rounding error of a block's average.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlockRounding {
    /// Variance, counts².
    pub variance: f64,
    /// Correlation with the error of the block before.
    pub correlation: f64,
    /// Variance of the second difference of this block and the two before, counts².
    pub second_difference: f64,
    /// Growth of the angle's variance over the block by the noise of a smoothed reference, counts².
    pub reference_walk: f64,
    /// Variance of the white noise, as a multiple of [`crate::whitening::NoiseModel::white`].
    pub white_scale: f64,
    /// Growth of the angle's variance by a walk of the angle, as a multiple of that of the noise model.
    pub walk_scale: f64,
    /// Growth of the angle's variance over the block by a scale factor with white noise of 1 ppm·√s, counts².
    pub scale_walk: f64,
}

impl BlockRounding {
    /// No rounding.
    pub const NONE: BlockRounding = BlockRounding {
        variance: 0.0,
        correlation: 0.0,
        second_difference: 0.0,
        reference_walk: 0.0,
        white_scale: 1.0,
        walk_scale: 1.0,
        scale_walk: 0.0,
    };
}

impl BlockRounding {
    /// Multiplies the variance of all noise but the rounding.
    fn scale_noise(&mut self, scale: f64) {
        for own in [&mut self.reference_walk, &mut self.white_scale, &mut self.walk_scale, &mut self.scale_walk] {
            *own *= scale;
        }
    }
}

/// Statistics of each block of each channel.
pub type Rounding = [Vec<BlockRounding>; CHANNELS];

/// The rounding along the accumulated counts of a model; none in the channel of the times.
pub fn rounding(measured: &MeasuredData, model: &ModelRun) -> Rounding {
    std::array::from_fn(|channel| {
        let blocks = model[channel].len().saturating_sub(1) / BLOCK;
        let Some(&count) = measured.counts.rounded_to.get(channel) else { return vec![BlockRounding::NONE; blocks] };
        let mut rounding = match &measured.weights[channel] {
            Some(weights) => of_weights(weights, blocks),
            None if count == 0.0 => vec![BlockRounding::NONE; blocks],
            None => of_channel(&model[channel], blocks, count),
        };
        let turns = rounding.iter_mut().zip(model[channel].windows(BLOCK + 1).step_by(BLOCK));
        turns.for_each(|(block, nodes)| block.scale_walk = scale_walk(nodes) / measured.interval_s());
        if let Some(smoothed) = &measured.smoothed {
            let walk = rounding.iter_mut().zip(&smoothed.walk[channel]);
            walk.for_each(|(block, walk)| block.reference_walk = walk.norm_squared());
            let scale = rounding.iter_mut().zip(&smoothed.white_scale[channel]);
            scale.for_each(|(block, scale)| block.white_scale = *scale);
        }
        if let Some(scales) = &measured.noise_scale {
            rounding.iter_mut().zip(&scales[channel]).for_each(|(block, scale)| block.scale_noise(*scale));
        }
        rounding
    })
}

/// Errors of averages of dequantised angles: independent.
fn of_weights(weights: &[f64], blocks: usize) -> Vec<BlockRounding> {
    let variance = |block: usize| nodes(block).map(|node| weights[node]).sum::<f64>().recip();
    let of_block = |block: usize| {
        let [last, second] = [1, 2].map(|before| variance(block.saturating_sub(before)));
        let second_difference = variance(block) + 4.0 * last + second;
        BlockRounding { variance: variance(block), second_difference, ..BlockRounding::NONE }
    };
    (0..blocks).map(of_block).collect()
}

/// Errors of angles that are rounded to whole multiples of `count`.
fn of_channel(angles: &[f64], blocks: usize, count: f64) -> Vec<BlockRounding> {
    let mut path = RoundingPath::default();
    let of_block = |block: usize| {
        let counts: Vec<f64> = angles[nodes(block)].iter().map(|angle| angle / count).collect();
        let own = path.push(&counts);
        let variances = [own.variance, own.second_difference].map(|variance| variance * count * count);
        BlockRounding { variance: variances[0], second_difference: variances[1], ..own }
    };
    (0..blocks).map(of_block).collect()
}

/// The statistics of one channel, block after block.
#[derive(Debug, Clone, Default)]
pub struct RoundingPath {
    /// Average errors of the two blocks before, the last first.
    before: [[f64; PHASES]; 2],
}

impl RoundingPath {
    /// Adds a block of accumulated counts before rounding.
    pub fn push(&mut self, angles: &[f64]) -> BlockRounding {
        let errors = errors(angles);
        let mean = |of: &dyn Fn(usize) -> f64| (0..PHASES).map(of).sum::<f64>() / PHASES as f64;
        let [last, second] = self.before;
        let variance = mean(&|phase| errors[phase].powi(2));
        let last_variance = mean(&|phase| last[phase].powi(2));
        let product = mean(&|phase| errors[phase] * last[phase]);
        let scale = (variance * last_variance).sqrt();
        self.before = [errors, last];
        BlockRounding {
            variance,
            correlation: if scale > 0.0 { product / scale } else { 0.0 },
            second_difference: mean(&|phase| (errors[phase] - 2.0 * last[phase] + second[phase]).powi(2)),
            ..BlockRounding::NONE
        }
    }
}

/// Variance of the angle at the end of a block times the interval of its nodes, with 1 ppm·√s of noise of the scale factor.
fn scale_walk(angles: &[f64]) -> f64 {
    angles.windows(2).map(|pair| (PPM * (pair[1] - pair[0])).powi(2)).sum::<f64>()
}

/// Average error of the rounded angles for each phase.
fn errors(angles: &[f64]) -> [f64; PHASES] {
    std::array::from_fn(|phase| {
        let phase = (phase as f64 + 0.5) / PHASES as f64;
        let error = |angle: &f64| (angle + phase).round() - (angle + phase);
        angles.iter().map(error).sum::<f64>() / angles.len() as f64
    })
}

/// Correlation of the motion with the rounding of the counts, the largest of the gyros; 0 with a smoothed reference, which contains them.
///
/// A controller that uses the counts turns the unit back when a count changes. Then signatures made of its small motions contain the
/// rounding itself, and no null recording along the same motion shows it. Measured in closed loops 0.19 to 0.7, else up to 0.06.
pub fn correlation_with_motion(measured: &MeasuredData, path: &ModelRun) -> f64 {
    let is_counted = |gyro: &usize| measured.counts.rounded_to.get(*gyro).is_some_and(|count| *count == 1.0);
    if measured.smoothed.is_some() {
        return 0.0;
    }
    let counts = measured.series();
    let of_gyro = |gyro: usize| {
        let residual: Vec<f64> = counts[gyro].iter().zip(path[gyro].iter()).map(|(count, path)| count - path).collect();
        let (errors, motion) = (fast(&residual), fast(&path[gyro]));
        let is_good = |node: usize| {
            let block = node.checked_sub(1).and_then(|node| measured.blocks[gyro].get(node / BLOCK));
            block.is_some_and(|block| block.is_good) && errors[node].abs() < 1.0 && motion[node].abs() < 1.0
        };
        let of_lag = |lag: usize| {
            let pairs = || (0..errors.len().saturating_sub(lag)).filter(|&node| is_good(node) && is_good(node + lag));
            // The motion after an error: it answers.
            let product = |of: &dyn Fn(usize) -> f64| pairs().map(of).sum::<f64>();
            let both = product(&|node| errors[node] * motion[node + lag]);
            let own = product(&|node| errors[node].powi(2)) * product(&|node| motion[node + lag].powi(2));
            if pairs().count() > MIN_NODES && own > 0.0 { (both / own.sqrt()).abs() } else { 0.0 }
        };
        (1..=MAX_LAG).map(of_lag).fold(0.0, f64::max)
    };
    (0..TIMING).filter(is_counted).map(of_gyro).fold(0.0, f64::max)
}

/// A series minus its average over the neighbours, 0 at the ends.
fn fast(values: &[f64]) -> Vec<f64> {
    let mut fast = vec![0.0; values.len()];
    for (around, value) in values.windows(2 * NEIGHBOURS + 1).zip(&mut fast[NEIGHBOURS.min(values.len())..]) {
        // Relative to the first, where the sum loses no digits.
        let mean = around.iter().map(|other| other - around[0]).sum::<f64>() / around.len() as f64;
        *value = around[NEIGHBOURS] - around[0] - mean;
    }
    fast
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Statistics in the middle of a motion at a constant rate, in counts per sample.
    fn at_rate(rate: f64) -> BlockRounding {
        let angles: Vec<f64> = (0..=400).map(|node| rate * f64::from(node)).collect();
        of_channel(&angles, 40, 1.0)[20]
    }

    #[test]
    fn rounding_at_rest_is_constant_and_that_of_any_rate_averages_out() {
        let rest = at_rate(0.0);
        assert!((rest.variance - 1.0 / 12.0).abs() < 1e-3 && rest.correlation > 0.999, "{rest:?}");
        // Halves: the error is a sawtooth of half a count.
        let half = at_rate(115.5);
        assert!((half.variance - 1.0 / 48.0).abs() < 1e-3 && half.correlation > 0.999, "{half:?}");
        assert!(half.second_difference < 1e-9, "{half:?}");
        // Ten samples of the golden ratio are spread evenly.
        let any = at_rate(0.618_034);
        assert!(any.variance < 0.1 / 12.0, "{any:?}");
    }
}
