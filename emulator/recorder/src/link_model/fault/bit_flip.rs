//! Flips bits anywhere in the data: before the CRC is computed, or after it, including the CRC.

use geu_model::device::Device;
use geu_model::fault::catalogue::link_fault::BitFlip;
use geu_protocol::can::{STATUS_COVERED, close_status};
use geu_protocol::layout::Frame;
use geu_protocol::serial::{self, CRC, HEADER};

use super::{Context, Encoding, LinkBehaviour, WireData};

impl LinkBehaviour for BitFlip {
    fn encoded(&self, data: &mut Vec<WireData>, context: &Context) {
        let is_after_crc = self.crc == 0.0;
        // Candidate bits: message, byte, bit.
        let mut places = Vec::new();
        for (index, message) in data.iter().enumerate() {
            let length = message.bytes().len();
            let covered = match (context.encoding, index) {
                (Encoding::Serial { .. }, _) => HEADER..length.saturating_sub(if is_after_crc { 0 } else { CRC }),
                (Encoding::Can(_), 1) if !is_after_crc => 0..STATUS_COVERED.min(length),
                (Encoding::DescribedSerial { device, .. }, _) => {
                    frame_of(device, message).map_or(0, |frame| frame.start().len())..length
                }
                (Encoding::Can(_) | Encoding::DescribedCan(_), _) => 0..length,
            };
            let frame =
                context.encoding.device().filter(|_| !is_after_crc).and_then(|device| frame_of(device, message));
            // Of a frame with right checks neither these nor its constants are changed.
            let kept = frame.map(|frame| {
                let mut kept = frame.required().to_vec();
                for check in &frame.checks {
                    kept.iter_mut().zip(check.place.used(frame.length())).for_each(|(kept, own)| *kept |= own);
                }
                kept
            });
            let bits = covered.flat_map(|byte| (0..8).map(move |bit| (byte, bit)));
            let is_free = |(byte, bit): &(usize, u8)| kept.as_ref().is_none_or(|kept| kept[*byte] >> bit & 1 == 0);
            places.extend(bits.filter(is_free).map(|(byte, bit)| (index, byte, bit)));
        }
        let mut draw = context.draw();
        for _ in 0..(self.bits as u64).min(places.len() as u64) {
            let (index, byte, bit) = places.swap_remove((draw.uniform() * places.len() as f64) as usize);
            let mut bytes = data[index].bytes().to_vec();
            bytes[byte] ^= 1 << bit;
            data[index].set_bytes(bytes);
        }
        match context.encoding.device() {
            _ if is_after_crc => {}
            None => update_crc(data),
            Some(device) => data.iter_mut().for_each(|message| update_checks(device, message)),
        }
    }
}

/// The frame of a described unit that has this identifier or start, and this length.
fn frame_of<'a>(device: &'a Device, message: &WireData) -> Option<&'a Frame> {
    let bytes = message.bytes();
    let (is_can, id) = match message {
        WireData::Bytes(_) => (false, None),
        WireData::Frame(frame) => (true, Some((frame.id(), frame.is_extended()))),
    };
    let is_it = |frame: &&Frame| frame.id == id && frame.length() == bytes.len() && bytes.starts_with(frame.start());
    device.frames(is_can)?.frames.iter().find(is_it)
}

fn update_checks(device: &Device, message: &mut WireData) {
    let Some(frame) = frame_of(device, message) else { return };
    let mut bytes = message.bytes().to_vec();
    frame.checks.iter().for_each(|check| check.write(&mut bytes));
    message.set_bytes(bytes);
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
