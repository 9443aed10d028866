//! Removes the last bytes, on CAN of every message; an empty message is not sent.

use geu_model::fault::catalogue::link_fault::Truncate;

use super::{Context, LinkBehaviour, WireData};

impl LinkBehaviour for Truncate {
    fn encoded(&self, data: &mut Vec<WireData>, _: &Context) {
        data.retain_mut(|data| {
            let length = data.bytes().len().saturating_sub(self.bytes as usize);
            data.set_length(length);
            length > 0
        });
    }
}
