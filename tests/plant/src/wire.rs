//! The output: a CAN capture, as in the interface control document.

use std::fmt::Write;

use crate::unit::Sample;

/// A frame of 8 bytes with its stuff bits on a bus of 500 kbit/s.
const FRAME_S: f64 = 250e-6;

/// INCREMENTS, STATUS and CLOCK of one sample.
pub fn frames(link: &mut String, start_unix_s: u64, received_s: f64, sequence: u32, sample: &Sample) {
    let mut increments = [0; 8];
    for (bytes, count) in increments.chunks_exact_mut(2).zip(sample.counts) {
        bytes.copy_from_slice(&count.to_be_bytes());
    }
    let mut status = [0; 8];
    status[..2].copy_from_slice(&(sequence as u16).to_be_bytes());
    status[2] = 0x0f | sample.saturated << 4;
    // Synchronous, clock locked; heater in 70 ± 1 °C.
    status[3] = 0x06 | u8::from((sample.sensor_c - 70.0).abs() <= 1.0);
    status[4..6].copy_from_slice(&centi(sample.electronics_c).to_be_bytes());
    let crc = increments.iter().chain(&status[..6]).fold(0xffff, |crc, byte| crc_16_ibm_3740(crc, *byte));
    status[6..].copy_from_slice(&crc.to_be_bytes());
    let mut clock = [0; 8];
    clock[..6].copy_from_slice(&(500_000 * (u64::from(sequence) + 1)).to_be_bytes()[2..]);
    clock[6..].copy_from_slice(&centi(sample.sensor_c).to_be_bytes());
    for (index, (id, bytes)) in [(0x1a0, increments), (0x1a1, status), (0x1a2, clock)].into_iter().enumerate() {
        let micros = ((received_s + index as f64 * FRAME_S) * 1e6).round() as u64;
        let (seconds, micros) = (start_unix_s + micros / 1_000_000, micros % 1_000_000);
        let _ = writeln!(link, "({seconds}.{micros:06}) can0 {id:03X}#{:016X}", u64::from_be_bytes(bytes));
    }
}

fn centi(celsius: f64) -> i16 {
    (celsius * 100.0).round() as i16
}

fn crc_16_ibm_3740(crc: u16, byte: u8) -> u16 {
    (0..8).fold(crc ^ u16::from(byte) << 8, |crc, _| if crc & 0x8000 == 0 { crc << 1 } else { crc << 1 ^ 0x1021 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interface_control_document_s_vector_is_written() {
        let sample =
            Sample { length_s: 0.5, counts: [-2, -2, 5, 5], saturated: 0, electronics_c: 20.64, sensor_c: 70.0 };
        let mut link = String::new();
        frames(&mut link, 0, 0.5009, 0, &sample);
        let expected = "(0.500900) can0 1A0#FFFEFFFE00050005\n(0.501150) can0 1A1#00000F070810DD5E\n(0.501400) can0 1A2#00000007A1201B58\n";
        assert_eq!(link, expected);
    }
}
