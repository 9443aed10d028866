//! Flips bits anywhere in the data: before the CRC is computed, or after it, including the CRC.

use geu_model::fault::catalogue::link_fault::BitFlip;
use geu_protocol::can::{STATUS_COVERED, close_status};
use geu_protocol::serial::{self, CRC, HEADER};

use super::{Context, Encoding, LinkBehaviour, WireData};

impl LinkBehaviour for BitFlip {
    fn encoded(&self, data: &mut Vec<WireData>, context: &Context) {
        let is_after_crc = self.crc == 0.0;
        let is_serial = matches!(context.encoding, Encoding::Serial { .. });
        // Candidate bits: message, byte, bit.
        let mut places = Vec::new();
        for (index, message) in data.iter().enumerate() {
            let length = message.bytes().len();
            let covered = match (is_serial, index) {
                (true, _) => HEADER..length.saturating_sub(if is_after_crc { 0 } else { CRC }),
                (false, 1) if !is_after_crc => 0..STATUS_COVERED.min(length),
                (false, _) => 0..length,
            };
            places.extend(covered.flat_map(|byte| (0..8).map(move |bit| (index, byte, bit))));
        }
        let mut draw = context.draw();
        for _ in 0..(self.bits as u64).min(places.len() as u64) {
            let (index, byte, bit) = places.swap_remove((draw.uniform() * places.len() as f64) as usize);
            let mut bytes = data[index].bytes().to_vec();
            bytes[byte] ^= 1 << bit;
            data[index].set_bytes(bytes);
        }
        if !is_after_crc {
            update_crc(data);
        }
    }
}

fn update_crc(data: &mut [WireData]) {
    match data {
        [WireData::Bytes(bytes)] => serial::update_crc(bytes),
        [WireData::Frame(increments), WireData::Frame(status), ..] => {
            if let Ok(mut data) = <[u8; 8]>::try_from(status.data()) {
                close_status(increments.data(), &mut data);
                *status = status.with_data(&data).unwrap_or(*status);
            }
        }
        // Other faults removed messages.
        [] | [WireData::Frame(_)] | [WireData::Bytes(_), ..] | [WireData::Frame(_), WireData::Bytes(_), ..] => {}
    }
}
