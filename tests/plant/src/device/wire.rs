//! The links of described units, from their data sheets: datagram 94 of a STIM300, frames of the tetrad, CAN of an MM5.10.

use std::io::Write;

use super::unit::{DeviceUnit, Wire};

/// A sample as it is sent.
pub struct SentSample<'a> {
    pub index: u64,
    pub numbers: &'a [f64],
    /// A bit for each head.
    pub saturated: u8,
    pub temperature_c: f64,
    /// Time of the first byte.
    pub received_unix_us: u64,
}

/// Length of a CAN frame at 500 kbit/s.
const FRAME_US: u64 = 250;
/// Delay of a STIM300 datagram, µs, in the middle of the data sheet's.
const LATENCY_US: u16 = 300;

/// Appends the bytes or lines of a sample.
pub fn append(link: &mut Vec<u8>, unit: &DeviceUnit, sample: &SentSample) {
    match unit.wire {
        Wire::Stim300 => stim300(link, sample),
        Wire::Tetrad => tetrad(link, sample),
        Wire::Mm510 => mm510(link, sample),
    }
}

/// TS1524 rev. 31, 7.5.2.2: counter modulo 256; status bit 4 is an overload, of the axes in bits 0 to 2.
fn stim300(link: &mut Vec<u8>, sample: &SentSample) {
    let start = link.len();
    link.push(0x94);
    for number in sample.numbers {
        link.extend_from_slice(&(*number as i32).to_be_bytes()[1..]);
    }
    link.push(if sample.saturated == 0 { 0 } else { 0x10 | sample.saturated });
    for _ in sample.numbers {
        link.extend_from_slice(&((sample.temperature_c * 256.0).round() as i16).to_be_bytes());
    }
    link.push(0);
    link.push(sample.index as u8);
    link.extend_from_slice(&LATENCY_US.to_be_bytes());
    // 21 bytes, and zeros that are not sent up to 24 (5.5.7).
    let padded = link[start..].iter().chain(&[0; 3]);
    let crc = padded.fold(!0, |crc, byte| crc_step(crc, *byte, 32, 0x04c1_1db7));
    link.extend_from_slice(&(crc as u32).to_be_bytes());
}

fn tetrad(link: &mut Vec<u8>, sample: &SentSample) {
    link.extend_from_slice(&[0xa5, 0x5a]);
    let start = link.len();
    link.extend_from_slice(&(sample.index as u16).to_le_bytes());
    for number in sample.numbers {
        link.extend_from_slice(&(*number as i32).to_le_bytes());
    }
    link.push(0x0f | sample.saturated << 4);
    link.extend_from_slice(&((sample.temperature_c * 100.0).round() as i16).to_le_bytes());
    link.extend_from_slice(&(10_000 * (sample.index + 1)).to_le_bytes()[..6]);
    let crc = link[start..].iter().fold(0xffff, |crc, byte| crc_step(crc, *byte, 16, 0x1021));
    link.extend_from_slice(&(crc as u16).to_le_bytes());
}

/// TX1 with the yaw rate and TX2 with the roll rate; accelerations of 0 g.
fn mm510(link: &mut Vec<u8>, sample: &SentSample) {
    for (place, (id, third)) in [(0x174, 0xff), (0x178, 0)].into_iter().enumerate() {
        let mut bytes = [0; 8];
        bytes[..2].copy_from_slice(&((sample.numbers[place] + 32768.0) as u16).to_le_bytes());
        bytes[3] = third;
        bytes[4..6].copy_from_slice(&0x8000u16.to_le_bytes());
        bytes[6] = sample.index as u8 & 0x0f;
        let crc = bytes[..7].iter().fold(0xff, |crc, byte| crc_step(crc, *byte, 8, 0x1d));
        bytes[7] = crc as u8 ^ 0xff;
        let us = sample.received_unix_us + place as u64 * FRAME_US;
        let (s, us, data) = (us / 1_000_000, us % 1_000_000, u64::from_be_bytes(bytes));
        let _ = writeln!(link, "({s}.{us:06}) can0 {id:03X}#{data:016X}");
    }
}

/// A CRC of 8 bits or more over a byte, highest bit first.
fn crc_step(crc: u64, byte: u8, bits: u32, polynomial: u64) -> u64 {
    let (mask, top) = ((1 << bits) - 1, 1 << (bits - 1));
    let start = (crc & mask) ^ u64::from(byte) << (bits - 8);
    (0..8).fold(start, |crc, _| if crc & top == 0 { crc << 1 & mask } else { (crc << 1 ^ polynomial) & mask })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checks_are_those_of_the_catalogue() {
        // CRC RevEng's check values of "123456789".
        let check = |initial: u64, bits: u32, polynomial: u64| {
            b"123456789".iter().fold(initial, |crc, byte| crc_step(crc, *byte, bits, polynomial))
        };
        assert_eq!(check(!0, 32, 0x04c1_1db7), 0x0376_e6e7);
        assert_eq!(check(0xffff, 16, 0x1021), 0x29b1);
        assert_eq!(check(0xff, 8, 0x1d) ^ 0xff, 0x4b);
    }

    #[test]
    fn the_bytes_of_a_sample_are_as_described() {
        let unit = DeviceUnit::mm510();
        let sample = |numbers| SentSample {
            index: 0x105,
            numbers,
            saturated: 0,
            temperature_c: 25.0,
            received_unix_us: 3_000_100,
        };
        let mut link = Vec::new();
        append(&mut link, &unit, &sample(&[-1.0, 256.0]));
        let lines = String::from_utf8(link).expect("text");
        // 7FFF and 8100, little-endian, and counter 5, read off the data sheet.
        assert!(lines.starts_with("(3.000100) can0 174#FF7F00FF008005"), "{lines}");
        assert!(lines.contains("\n(3.000350) can0 178#008100000080"), "{lines}");
        let mut link = Vec::new();
        append(&mut link, &DeviceUnit::stim300(), &sample(&[-2.0, 1.0, 65536.0]));
        assert_eq!(link[..10], [0x94, 0xff, 0xff, 0xfe, 0, 0, 1, 1, 0, 0]);
        assert_eq!((link.len(), &link[11..13], link[18]), (25, &[25, 0][..], 5));
    }
}
