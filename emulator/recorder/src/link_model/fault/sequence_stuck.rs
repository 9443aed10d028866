//! The sequence keeps its value; the CRC is right.

use geu_model::fault::catalogue::link_fault::SequenceStuck;
use geu_model::fault::engine::ActiveFault;
use geu_protocol::Sample;

use super::LinkBehaviour;

impl LinkBehaviour for SequenceStuck {
    fn sample(&self, sample: Sample, acting: &ActiveFault) -> Option<Sample> {
        Some(Sample { sequence: acting.before.map_or(0, |before| before.sequence), ..sample })
    }
}
