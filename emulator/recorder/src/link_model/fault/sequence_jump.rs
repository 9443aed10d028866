//! The sequence is off by a constant; the CRC is right.

use geu_model::fault::catalogue::link_fault::SequenceJump;
use geu_model::fault::engine::ActiveFault;
use geu_protocol::Sample;

use super::LinkBehaviour;

impl LinkBehaviour for SequenceJump {
    fn sample(&self, sample: Sample, _: &ActiveFault) -> Option<Sample> {
        Some(Sample { sequence: sample.sequence.wrapping_add(self.by as i64 as u16), ..sample })
    }
}
