//! What a recording and a model are compared by.

/// Series that a model is compared with: the four gyros' accumulated angles, and when their samples ended.
pub const CHANNELS: usize = 5;
/// The channel of the times of receipt, after those of the gyros.
pub const TIMING: usize = 4;
/// Unit of the channel of the times: 0.1 ms, so that its numbers are of the size of the angles'.
pub const TIMING_UNIT_S: f64 = 1e-4;
/// How a recording and what is told beside it lie in time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Shifts {
    /// How much later than the reference's the recording's times are.
    pub lag_s: f64,
    /// How much later than the electronics' own course the temperature is told.
    pub temperature_s: f64,
}

/// The model beside a recording: each channel at every node, or averaged over blocks.
pub type Series = [Vec<f64>; CHANNELS];
