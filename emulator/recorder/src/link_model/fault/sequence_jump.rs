//! The sequence is off by a constant; the CRC is right.

use geu_model::CompletedSample;
use geu_model::fault::catalogue::link_fault::SequenceJump;
use geu_model::fault::engine::ActiveFault;

use super::LinkBehaviour;

impl LinkBehaviour for SequenceJump {
    fn sample(&self, sample: CompletedSample, _: &ActiveFault) -> Option<CompletedSample> {
        Some(sample.numbered(sample.outputs.number.wrapping_add(self.by as i64 as u64)))
    }
}
