//! Counts are lost or gained between sensor and link.

use super::{EffectInputs, GyroEffect, GyroSubStep};

effect! {
    /// An offset of the accumulated count.
    pub struct LostCounts ("lost-counts", "lost counts") {
        /// Added to the accumulated count.
        counts: 0.0, -1e6..=1e6, "counts", Count;
        /// When, since the start of the first sample interval.
        time_s: 0.0, 0.0..=1e10, "s", Onset;
    }
    amplitudes: [{ per_day: 1e6, per_k: 1e6 }],
    paper: "0",
    source: "link",
}

impl GyroEffect for LostCounts {
    /// Counts already added.
    type State = f64;

    #[inline]
    fn apply(&self, state: &mut f64, head: &mut GyroSubStep, surroundings: &EffectInputs) {
        let counts = if surroundings.end_s > self.time_s { self.counts } else { 0.0 };
        head.added_counts += counts - *state;
        *state = counts;
    }
}
