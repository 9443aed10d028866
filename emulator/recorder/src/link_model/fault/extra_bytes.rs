//! Random bytes precede each sample.

use geu_model::fault::catalogue::link_fault::ExtraBytes;

use super::{Context, LinkBehaviour, WireData};

impl LinkBehaviour for ExtraBytes {
    fn first(&self, data: &mut WireData, context: &Context) {
        if let WireData::Bytes(own) = data {
            let mut draw = context.draw();
            own.splice(..0, (0..self.bytes as u64).map(|_| draw.bits() as u8));
        }
    }
}
