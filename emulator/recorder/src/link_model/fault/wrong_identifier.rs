//! Changes the frame type, on CAN the identifier of the first message and the following identifiers with it.

use geu_model::fault::catalogue::link_fault::WrongIdentifier;
use geu_protocol::serial::TYPE_AT;

use super::{Context, Encoding, LinkBehaviour, WireData, change_headers};

impl LinkBehaviour for WrongIdentifier {
    fn encoded(&self, data: &mut Vec<WireData>, context: &Context) {
        // The last of several faults counts.
        if !context.is_last_of_its_code {
            return;
        }
        if !context.encoding.is_can() {
            return change_headers(data, |bytes| bytes[TYPE_AT] = self.identifier as u8);
        }
        let first = match context.encoding {
            Encoding::Can(plan) => Some(plan.base().into()),
            _ => data.iter().find_map(|data| if let WireData::Frame(frame) = data { Some(frame.id()) } else { None }),
        };
        for data in data {
            if let WireData::Frame(frame) = data {
                *frame = frame.with_id(self.identifier as u32 + frame.id().saturating_sub(first.unwrap_or_default()));
            }
        }
    }
}
