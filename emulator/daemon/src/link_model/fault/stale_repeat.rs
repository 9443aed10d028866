//! The last sample before the fault is repeated; none is sent where there was none.

use geu_model::fault::acting::Acting;
use geu_model::fault::catalogue::link_fault::StaleRepeat;
use geu_protocol::HalfSecond;

use super::LinkBehaviour;

impl LinkBehaviour for StaleRepeat {
    fn sample(&self, _: HalfSecond, acting: &Acting) -> Option<HalfSecond> {
        acting.before
    }
}
