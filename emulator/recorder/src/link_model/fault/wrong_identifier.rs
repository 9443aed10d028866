//! Changes the frame type, on CAN the identifier of INCREMENTS and the following identifiers with it.

use geu_model::fault::catalogue::link_fault::WrongIdentifier;
use geu_protocol::CanFrame;
use geu_protocol::serial::TYPE_AT;

use super::{Context, Encoding, LinkBehaviour, WireData, change_headers};

impl LinkBehaviour for WrongIdentifier {
    fn encoded(&self, data: &mut Vec<WireData>, context: &Context) {
        // The last of several faults counts.
        if !context.is_last_of_its_code {
            return;
        }
        match context.encoding {
            Encoding::Serial { .. } => change_headers(data, |bytes| bytes[TYPE_AT] = self.identifier as u8),
            Encoding::Can(plan) => {
                for data in data {
                    if let WireData::Frame(frame) = data {
                        let offset = frame.id().saturating_sub(plan.base());
                        let id = (self.identifier as u16).saturating_add(offset);
                        *frame = CanFrame::new(id, frame.data()).unwrap_or(*frame);
                    }
                }
            }
        }
    }
}
