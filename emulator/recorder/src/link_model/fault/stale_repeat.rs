//! Repeats the last sample before the fault; sends none if there was none.

use geu_model::CompletedSample;
use geu_model::fault::catalogue::link_fault::StaleRepeat;
use geu_model::fault::engine::ActiveFault;

use super::LinkBehaviour;

impl LinkBehaviour for StaleRepeat {
    fn sample(&self, _: CompletedSample, acting: &ActiveFault) -> Option<CompletedSample> {
        acting.before
    }
}
