//! A sample that ended: as the default unit has it, and the outputs of any unit.

use geu_protocol::Sample;

use crate::device::MAX_HEADS;

/// Outputs of the heads over a sample interval, of any unit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Outputs {
    /// Number of the sample since the run began.
    pub index: u64,
    /// Number of the sample since the sequence began.
    pub number: u64,
    /// Counts of each head.
    pub counts: [f64; MAX_HEADS],
    /// Angle of each head since the last frame that carried it, not rounded; 0 without such frames.
    pub angles_arcsec: [f64; MAX_HEADS],
    /// Heads with a measurement, as bits.
    pub valid: u8,
    /// Heads that were clipped, as bits.
    pub saturated: u8,
}

/// A sample that just ended.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CompletedSample {
    /// Sample of the default unit; of another unit without increments and flags of gyros.
    pub sample: Sample,
    pub outputs: Outputs,
    /// True if it is sent on every link now (cyclic mode), false if it is kept for a poll.
    pub cyclic: bool,
    /// Scheduled end, true time since the start of the first sample interval, ns.
    pub end_ns: i64,
}

impl From<Sample> for CompletedSample {
    /// A sample of the default unit, as it was received.
    fn from(sample: Sample) -> CompletedSample {
        let mut outputs = Outputs {
            number: sample.sequence.into(),
            valid: sample.gyro_flags & 0xF,
            saturated: sample.gyro_flags >> 4,
            ..Outputs::default()
        };
        outputs.counts.iter_mut().zip(sample.increments).for_each(|(counts, increment)| *counts = increment.into());
        CompletedSample { sample, outputs, cyclic: true, end_ns: 0 }
    }
}

impl CompletedSample {
    /// The sample with another number.
    #[must_use]
    pub fn numbered(self, number: u64) -> CompletedSample {
        let sample = Sample { sequence: number as u16, ..self.sample };
        CompletedSample { sample, outputs: Outputs { number, ..self.outputs }, ..self }
    }
}
