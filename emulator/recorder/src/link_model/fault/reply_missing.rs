//! Commands are carried out, and get no reply.

use geu_model::fault::catalogue::link_fault::ReplyMissing;

use super::{LinkBehaviour, Transmission};

impl LinkBehaviour for ReplyMissing {
    fn reply(&self, _: Transmission) -> Option<Transmission> {
        None
    }
}
