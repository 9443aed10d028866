//! Repeats the last sample before the fault; sends none if there was none.

use geu_model::fault::catalogue::link_fault::StaleRepeat;
use geu_model::fault::engine::ActiveFault;
use geu_protocol::Sample;

use super::LinkBehaviour;

impl LinkBehaviour for StaleRepeat {
    fn sample(&self, _: Sample, acting: &ActiveFault) -> Option<Sample> {
        acting.before
    }
}
