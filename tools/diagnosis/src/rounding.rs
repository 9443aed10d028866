//! Rounding errors of block averages.
//!
//! A count is the difference of rounded angles, so that the error of a block's average depends on the motion alone: independent
//! roundings average out, but at rest and at rates near a simple fraction of a count per sample the error persists, up to half a count
//! over many blocks. The phase of the accumulated angle is not known well enough to predict it: it is a random number between 0 and 1.
//! Variance and correlation over this phase follow from the model's own path.

use crate::measured::{BLOCK, CHANNELS, Series, TIMING, nodes};

/// Phases over which the statistics are taken.
const PHASES: usize = 32;

/// Statistics of the rounding error of a block's average.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlockRounding {
    /// Variance, counts².
    pub variance: f64,
    /// Correlation with the error of the block before.
    pub correlation: f64,
    /// Variance of the second difference of this block and the two before, counts².
    pub second_difference: f64,
}

impl BlockRounding {
    /// No rounding.
    pub const NONE: BlockRounding = BlockRounding { variance: 0.0, correlation: 0.0, second_difference: 0.0 };
}

/// Statistics of each block of each channel.
pub type Rounding = [Vec<BlockRounding>; CHANNELS];

/// The rounding along the accumulated counts of a model; none in the channel of the times.
pub fn rounding(model: &Series) -> Rounding {
    std::array::from_fn(|channel| {
        let blocks = (model[channel].len() - 1) / BLOCK;
        if channel == TIMING { vec![BlockRounding::NONE; blocks] } else { of_channel(&model[channel], blocks) }
    })
}

fn of_channel(angles: &[f64], blocks: usize) -> Vec<BlockRounding> {
    let mut before = [[0.0_f64; PHASES]; 2];
    let of_block = |block: usize| {
        let errors = errors(&angles[nodes(block)]);
        let mean = |of: &dyn Fn(usize) -> f64| (0..PHASES).map(of).sum::<f64>() / PHASES as f64;
        let [last, second] = before;
        let variance = mean(&|phase| errors[phase].powi(2));
        let last_variance = mean(&|phase| last[phase].powi(2));
        let product = mean(&|phase| errors[phase] * last[phase]);
        let scale = (variance * last_variance).sqrt();
        before = [errors, last];
        BlockRounding {
            variance,
            correlation: if scale > 0.0 { product / scale } else { 0.0 },
            second_difference: mean(&|phase| (errors[phase] - 2.0 * last[phase] + second[phase]).powi(2)),
        }
    };
    (0..blocks).map(of_block).collect()
}

/// Average error of the rounded angles for each phase.
fn errors(angles: &[f64]) -> [f64; PHASES] {
    std::array::from_fn(|phase| {
        let phase = (phase as f64 + 0.5) / PHASES as f64;
        let error = |angle: &f64| (angle + phase).round() - (angle + phase);
        angles.iter().map(error).sum::<f64>() / angles.len() as f64
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Statistics in the middle of a motion at a constant rate, in counts per sample.
    fn at_rate(rate: f64) -> BlockRounding {
        let angles: Vec<f64> = (0..=400).map(|node| rate * f64::from(node)).collect();
        of_channel(&angles, 40)[20]
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
