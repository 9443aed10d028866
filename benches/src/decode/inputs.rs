//! Inputs of the default unit: a candump log, serial bytes, a pcapng capture.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use geu_protocol::serial::data_frame;
use geu_protocol::{CLOCK_PER_SAMPLE, CanIdMap, Sample};

/// Types of pcapng blocks, its byte order, and the link type of SocketCAN frames.
const SECTION: u32 = 0x0A0D_0D0A;
const INTERFACE: u32 = 1;
const ENHANCED_PACKET: u32 = 6;
const MAGIC: u32 = 0x1A2B_3C4D;
const SOCKETCAN: u16 = 227;
/// Bytes that are written at once.
const PART: usize = 1 << 20;

/// A log of samples as the unit sends them, the same samples as serial frames, and the same frames as pcapng.
pub fn write(log: &Path, bin: &Path, pcapng: &Path, lines: u64) -> io::Result<()> {
    // As a copied file: the system caches a file in the parts in which it was written, and reads small parts at half the speed.
    let create = |path| File::create(path).map(|file| BufWriter::with_capacity(PART, file));
    let (mut log, mut bin, mut pcapng) = (create(log)?, create(bin)?, create(pcapng)?);
    pcapng.write_all(&block(SECTION, &[MAGIC.to_le_bytes().as_slice(), &[1, 0, 0, 0], &[0xFF; 8]].concat()))?;
    pcapng.write_all(&block(INTERFACE, &[SOCKETCAN.to_le_bytes().as_slice(), &[0; 6]].concat()))?;
    let plan = CanIdMap::default();
    let mut line = 0;
    for index in 0u64.. {
        let rate = |phase: u64| ((index * 7 + phase * 1_013) % 4_001) as i16 - 2_000;
        let sample = Sample {
            sequence: index as u16,
            increments: [rate(0), rate(1), rate(2), rate(3)],
            gyro_flags: 0x0F,
            unit_flags: 0x07,
            electronics_centi_c: 2_000 + (index / 50 % 200) as i16,
            clock_count: (index + 1) * CLOCK_PER_SAMPLE,
            sensor_centi_c: 7_000,
        };
        bin.write_all(&data_frame(&sample))?;
        for (offset_us, frame) in [900, 1_150, 1_400].into_iter().zip(plan.frames(&sample)) {
            if line == lines {
                log.flush()?;
                pcapng.flush()?;
                return bin.flush();
            }
            let t_us = 1_795_020_000_500_000 + index * 500_000 + offset_us;
            write!(log, "({}.{:06}) can0 {:03X}#", t_us / 1_000_000, t_us % 1_000_000, frame.id())?;
            for byte in frame.data() {
                write!(log, "{byte:02X}")?;
            }
            log.write_all(b"\n")?;
            pcapng.write_all(&packet(t_us, frame.id(), frame.data()))?;
            line += 1;
        }
    }
    Ok(())
}

/// A block of pcapng: its content must be whole words.
fn block(kind: u32, content: &[u8]) -> Vec<u8> {
    let length = (content.len() as u32 + 12).to_le_bytes();
    [&kind.to_le_bytes(), length.as_slice(), content, &length].concat()
}

/// A packet with a classic CAN frame of eight bytes.
fn packet(t_us: u64, id: u32, data: &[u8]) -> Vec<u8> {
    let length = (8 + data.len() as u32).to_le_bytes();
    let frame = [id.to_be_bytes().as_slice(), &[data.len() as u8, 0, 0, 0], data].concat();
    let (high, low) = (((t_us >> 32) as u32).to_le_bytes(), (t_us as u32).to_le_bytes());
    block(ENHANCED_PACKET, &[[0; 4].as_slice(), &high, &low, &length, &length, &frame].concat())
}
