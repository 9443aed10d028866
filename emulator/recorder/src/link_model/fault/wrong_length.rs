//! The length field is wrong; on CAN every message has this length.

use geu_model::fault::catalogue::link_fault::WrongLength;
use geu_protocol::serial::LENGTH_AT;

use super::{Context, LinkBehaviour, WireData, change_headers};

impl LinkBehaviour for WrongLength {
    fn encoded(&self, data: &mut Vec<WireData>, context: &Context) {
        match context.encoding.is_can() {
            false => change_headers(data, |bytes| bytes[LENGTH_AT] = self.length as u8),
            true => data.iter_mut().for_each(|data| data.set_length((self.length as usize).min(8))),
        }
    }
}
