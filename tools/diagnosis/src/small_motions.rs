//! Small motions that contain the noise of the gyros.
//!
//! A controller that uses the counts turns the unit back by the noise of the gyros, and the motion between the rows of a slow
//! reference is taken from the counts. An effect that withholds such a motion explains any noise.

use crate::measured::{Series, TIMING, nodes};
use crate::signature_bank::SignatureBank;

/// Largest turn within a block of a motion that answers the counts: several roundings.
const SMALL_COUNTS: f64 = 10.0;

impl SignatureBank {
    /// The signatures of effects that withhold small motions, without those along a path.
    #[must_use]
    pub fn without_small_motions(mut self, path: &Series) -> SignatureBank {
        for base in
            self.bases.iter_mut().filter(|base| base.amplitude.filters_motion() || base.amplitude.formula().is_some())
        {
            for (series, path) in base.series.iter_mut().zip(path).take(TIMING) {
                let turned = |block: usize| {
                    let (min, max) = path[nodes(block)]
                        .iter()
                        .fold((f64::MAX, f64::MIN), |(min, max), angle| (angle.min(min), angle.max(max)));
                    max - min
                };
                let (mut sum, mut before) = (0.0, 0.0);
                let of_block = |(block, value): (usize, &f64)| {
                    let change = value - std::mem::replace(&mut before, *value);
                    sum += if turned(block) < SMALL_COUNTS { 0.0 } else { change };
                    sum
                };
                *series = series.iter().enumerate().map(of_block).collect();
            }
        }
        self
    }
}
