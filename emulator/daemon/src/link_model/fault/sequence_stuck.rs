//! The sequence keeps its value; the CRC is right.

use geu_model::fault::acting::Acting;
use geu_model::fault::catalogue::link_fault::SequenceStuck;
use geu_protocol::HalfSecond;

use super::LinkBehaviour;

impl LinkBehaviour for SequenceStuck {
    fn sample(&self, sample: HalfSecond, acting: &Acting) -> Option<HalfSecond> {
        Some(HalfSecond { sequence: acting.before.map_or(0, |before| before.sequence), ..sample })
    }
}
