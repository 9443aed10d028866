//! The sequence is off by a constant; the CRC is right.

use geu_model::fault::acting::Acting;
use geu_model::fault::catalogue::link_fault::SequenceJump;
use geu_protocol::HalfSecond;

use super::LinkBehaviour;

impl LinkBehaviour for SequenceJump {
    fn sample(&self, sample: HalfSecond, _: &Acting) -> Option<HalfSecond> {
        Some(HalfSecond { sequence: sample.sequence.wrapping_add(self.by as u16), ..sample })
    }
}
