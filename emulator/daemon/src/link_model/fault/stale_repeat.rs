//! The last sample before the fault is repeated; none is sent where there was none.

use geu_model::fault::acting::ActiveFault;
use geu_model::fault::catalogue::link_fault::StaleRepeat;
use geu_protocol::Sample;

use super::LinkBehaviour;

impl LinkBehaviour for StaleRepeat {
    fn sample(&self, _: Sample, acting: &ActiveFault) -> Option<Sample> {
        acting.before
    }
}
