//! Channels in which a recording and a model are compared.

use std::sync::Arc;

use geu_calibration::AccumulatedCounts;
use geu_model::device::MAX_HEADS;

/// The channel of the receive times, after the gyros; a unit with fewer gyros leaves channels empty.
pub const TIMING: usize = MAX_HEADS;
/// Number of channels: the accumulated angles of the gyros, and the ends of their samples.
pub const CHANNELS: usize = TIMING + 1;
/// Unit of the channel of the times: 0.1 ms, so that its values have the magnitude of the angles.
pub const TIMING_UNIT_S: f64 = 1e-4;

/// Time shifts between a recording, its reference and its temperatures.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Shifts {
    /// Recording times minus reference times.
    pub lag_s: f64,
    /// Delay of the recorded temperature against that of the electronics.
    pub temperature_s: f64,
}

/// Each channel averaged over blocks.
pub type Series = [Vec<f64>; CHANNELS];
/// A run of the model: each channel at every node.
pub type ModelRun = [Arc<Vec<f64>>; CHANNELS];

/// The counts without what effects add to them; after the end of that the last of it.
pub fn without(counts: &AccumulatedCounts, added: &Series) -> AccumulatedCounts {
    let mut counts = counts.clone();
    for (own, added) in counts.accumulated.iter_mut().zip(added) {
        let last = added.last().copied().unwrap_or_default();
        let all = added.iter().copied().chain(std::iter::repeat(last));
        own.iter_mut().zip(all).for_each(|(own, added)| *own -= added);
    }
    counts
}
