//! The sequence keeps its value; the CRC is right.

use geu_model::CompletedSample;
use geu_model::fault::catalogue::link_fault::SequenceStuck;
use geu_model::fault::engine::ActiveFault;

use super::LinkBehaviour;

impl LinkBehaviour for SequenceStuck {
    fn sample(&self, sample: CompletedSample, acting: &ActiveFault) -> Option<CompletedSample> {
        Some(sample.numbered(acting.before.map_or(0, |before| before.outputs.number)))
    }
}
