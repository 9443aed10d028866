//! The bytes that a receiver at the link's rate reads when they are sent at another: 8N1, each bit sampled in its middle.

use geu_model::fault::catalogue::link_fault::BaudMismatch;
use geu_protocol::serial::BITS_PER_BYTE;

use super::{Context, LinkBehaviour, WireData};

/// Bits of a byte on the line.
const BITS: usize = BITS_PER_BYTE as usize;

impl LinkBehaviour for BaudMismatch {
    fn encoded(&self, data: &mut Vec<WireData>, context: &Context) {
        let Some(own) = context.encoding.baud() else { return };
        for data in data {
            if let WireData::Bytes(bytes) = data {
                *bytes = read_at(bytes, self.baud, f64::from(own));
            }
        }
    }
}

/// The bytes that are read at `own` baud when `bytes` are sent back to back at `baud`, the line idle before and after.
///
/// A byte without a stop bit is output as sampled; the next start bit is searched when the line is idle again.
fn read_at(bytes: &[u8], baud: f64, own: f64) -> Vec<u8> {
    let level = |time_bits: f64| {
        let bit = time_bits.floor();
        if bit < 0.0 || bit >= (bytes.len() * BITS) as f64 {
            return true;
        }
        let (byte, place) = (bit as usize / BITS, bit as usize % BITS);
        match place {
            0 => false,
            9 => true,
            place => bytes[byte] >> (place - 1) & 1 == 1,
        }
    };
    // Bit time of the receiver in bit times of the sender.
    let (step, end) = (baud / own, (bytes.len() * BITS) as f64);
    // The line changes only between bits of the sender.
    let next_fall = |from: f64| {
        let mut bit = from.ceil();
        while bit < end && (level(bit) || !level(bit - 0.5)) {
            bit += 1.0;
        }
        (bit < end).then_some(bit)
    };
    let (mut read, mut from) = (Vec::new(), 0.0);
    while let Some(start) = next_fall(from) {
        let middle = |place: f64| start + (place + 0.5) * step;
        if level(middle(0.0)) {
            // Too short for a start bit.
            from = start + 0.5;
            continue;
        }
        read.push((0..8).fold(0, |byte, bit| byte | u8::from(level(middle(f64::from(bit) + 1.0))) << bit));
        from = middle(9.0);
    }
    read
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_right_rate_reads_the_sent_bytes() {
        let bytes: Vec<u8> = (0..=255).collect();
        assert_eq!(read_at(&bytes, 115_200.0, 115_200.0), bytes);
        // A UART tolerates an error of 2 %.
        assert_eq!(read_at(&bytes, 117_000.0, 115_200.0), bytes);
    }

    #[test]
    fn half_the_rate_reads_every_bit_twice() {
        // 0x55 at half the rate: start 00, then 11 00 11 00 …: the receiver sees start, 0, 1, 1, 0, 0, 1, 1, 0 and a stop of 0.
        assert_eq!(read_at(&[0x55], 57_600.0, 115_200.0)[0], 0b0110_0110);
        // Twice the rate: every other bit is missed.
        assert!(!read_at(&[0xEB, 0x90], 230_400.0, 115_200.0).is_empty());
    }

    #[test]
    fn reading_ends_at_any_rate() {
        for baud in [50.0, 300.0, 9600.0, 115_200.0, 4e6] {
            assert!(read_at(&[0xEB; 28], baud, 115_200.0).len() < 28 * 2400, "{baud}");
        }
    }
}
