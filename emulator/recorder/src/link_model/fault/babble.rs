//! Noise between samples: random bytes, on CAN frames of any identifier.

use geu_model::fault::catalogue::link_fault::Babble;
use geu_protocol::CanFrame;

use super::{Context, LinkBehaviour, MAX_TRANSMISSIONS, Transmission, WireData};

/// Noise of one sample interval is sent in at most this many bursts.
const BURSTS: u64 = 16;

impl LinkBehaviour for Babble {
    fn noise(&self, transmissions: &mut Vec<Transmission>, frame: u64, context: &Context) {
        let mut draw = context.draw();
        let mut random = |count: u64| -> Vec<u8> { (0..count).map(|_| draw.bits() as u8).collect() };
        let (amount, interval_ns) = (self.amount as u64, (context.acting.interval_s * 1e9).round() as i64);
        let bursts = amount.min(BURSTS);
        for burst in 0..bursts {
            let count = (burst + 1) * amount / bursts - burst * amount / bursts;
            let after_ns = (2 * burst as i64 + 1) * interval_ns / (2 * bursts as i64);
            let noise = match context.encoding.is_can() {
                false => vec![WireData::Bytes(random(count))],
                true => (0..count)
                    .filter_map(|_| {
                        let bytes = random(11);
                        let id = u16::from_be_bytes([bytes[0], bytes[1]]) & 0x7FF;
                        CanFrame::new(id, &bytes[3..3 + usize::from(bytes[2] % 9)]).map(WireData::Frame)
                    })
                    .collect(),
            };
            let capacity = MAX_TRANSMISSIONS.saturating_sub(transmissions.len());
            let noise = noise.into_iter().take(capacity);
            transmissions.extend(noise.map(|data| Transmission { after_ns, ..Transmission::on_time(frame, data) }));
        }
    }
}
