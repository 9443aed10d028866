//! Jumps of an angle in the samples of a gyro.
//!
//! Counts are lost in one sample, which differs from those beside it. A reference by cameras jumps too, where other markers come into view:
//! the residual shows the same jump, the samples of the gyro do not.

use geu_checks::median;
use geu_hypothesis::Hypothesis;
use geu_model::parameter_spec::Role;

use crate::measured::{BLOCK, MeasuredData};
use crate::significance::{MEDIAN_OF_NORMAL, THREE_SIGMAS};

/// Nodes to either side of an onset: it is known to a block.
const REACH: usize = 2 * BLOCK;

impl MeasuredData {
    /// True if counts of that value at that time would change a sample of a gyro by more than motion and noise do, and none is changed.
    pub fn contradicts(&self, lost: &Hypothesis) -> bool {
        let onset = lost.parameters().iter().find(|own| own.role == Role::Onset).map(|own| own.value);
        let Some(onset_s) = onset.filter(|_| lost.amplitude.is_count()) else { return false };
        let node = (onset_s / self.interval_s()) as usize;
        let changes = |gyro: usize| -> Vec<f64> {
            let sums = &self.counts.accumulated[gyro];
            let own = &sums[node.saturating_sub(REACH).min(sums.len())..(node + REACH).min(sums.len())];
            own.windows(4).map(|sums| sums[2] - sums[1] - 0.5 * (sums[1] - sums[0] + sums[3] - sums[2])).collect()
        };
        (0..self.gyros().heads()).filter(|&gyro| lost.gyros[gyro]).any(|gyro| {
            let mut sizes: Vec<f64> = changes(gyro).into_iter().map(f64::abs).collect();
            let largest = sizes.iter().copied().fold(0.0, f64::max);
            let sigma = median(&mut sizes) / MEDIAN_OF_NORMAL;
            // Three sigma from none to half of it, and from there to the whole.
            let half = 0.5 * lost.value.abs();
            !sizes.is_empty() && largest < half && THREE_SIGMAS * sigma < half
        })
    }
}
