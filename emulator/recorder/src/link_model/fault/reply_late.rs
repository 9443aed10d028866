//! Replies, and samples that are polled, are late.

use geu_model::fault::catalogue::link_fault::ReplyLate;

use super::{LinkBehaviour, Transmission, ns};

impl LinkBehaviour for ReplyLate {
    fn reply(&self, reply: Transmission) -> Option<Transmission> {
        Some(Transmission { after_ns: reply.after_ns + ns(self.delay_s), ..reply })
    }
}
