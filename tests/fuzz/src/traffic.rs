//! Frames with right checks, in any order and between other bytes: what lies behind the checks of a link.

use std::fmt::Write;

use geu_protocol::capture::Format;
use geu_protocol::field::CLOCK_MODULUS;
use geu_protocol::serial::{FrameType, data_frame, frame};
use geu_protocol::{CanFrame, CanIdMap, Sample};
use geu_recording::{Decoder, DecoderOptions, DeviceDecoder};

use crate::decoded::{capture, serial};
use crate::{device, parts};

/// Splits off the first bytes, zeros in place of missing ones.
fn split<const COUNT: usize>(data: &mut &[u8]) -> [u8; COUNT] {
    let mut bytes = [0; COUNT];
    let (own, rest) = data.split_at(data.len().min(COUNT));
    bytes[..own.len()].copy_from_slice(own);
    *data = rest;
    bytes
}

/// A sample that follows another one: by one, with a gap or a repeat, with a clock that follows or not.
fn next(last: &Sample, data: &mut &[u8]) -> Sample {
    let [step, clock, flags, unit_flags, x, y, za, zb] = split(data);
    let sequence = last.sequence.wrapping_add(u16::from(step % 8));
    let cycles = u64::from(step % 8) * 500_000 + u64::from(clock.saturating_sub(200)) * 9_973;
    let increments = [x, y, za, zb].map(|byte| i16::from_be_bytes([byte; 2]));
    let clock_count = (last.clock_count + cycles) % CLOCK_MODULUS;
    let unit_flags = if unit_flags > 200 { unit_flags } else { 7 };
    Sample { sequence, increments, clock_count, gyro_flags: !flags, unit_flags, ..*last }
}

/// Serial bytes of the default unit.
pub fn bytes(data: &[u8]) {
    let (mut data, cuts) = data.split_at(data.len().saturating_sub(2));
    let (mut stream, mut last, mut samples) = (Vec::new(), Sample::default(), Some(Vec::new()));
    while let Some((tag, rest)) = data.split_first() {
        data = rest;
        let payload: [u8; 8] = if tag % 8 < 5 { [0; 8] } else { split(&mut data) };
        match tag % 8 {
            0..5 => {
                last = next(&last, &mut data);
                samples.iter_mut().for_each(|samples| samples.push(last));
                stream.extend(data_frame(&last));
            }
            5 => stream.extend(frame(FrameType::Command, &payload[..usize::from(tag / 8 % 9)])),
            6 => stream.extend(frame(FrameType::Reply, &payload[..usize::from(tag / 8 % 9)])),
            _ => (samples, stream) = (None, [&stream, &payload[..usize::from(tag / 8 % 9)]].concat()),
        }
    }
    stream.extend(cuts);
    let (content, parts) = parts(&stream);
    let decode = |parts: &[&[u8]]| serial(Decoder::new(&DecoderOptions::default()), parts);
    let whole = decode(&[content]);
    // Without other bytes every sample is read.
    if let Some(samples) = samples.filter(|_| cuts.len() == 2) {
        assert_eq!(whole.rows.iter().map(|row| row.sample).collect::<Vec<_>>(), samples);
    }
    assert_eq!(whole, decode(&parts));
}

/// A log of candump with frames of the default unit on two interfaces.
pub fn frames(data: &[u8]) {
    let (mut data, cuts) = data.split_at(data.len().saturating_sub(2));
    let (mut log, mut last, mut t_us) = (String::new(), Sample::default(), 0u64);
    while let Some((tag, rest)) = data.split_first() {
        data = rest;
        let mut own = Vec::new();
        if tag % 8 < 6 {
            last = next(&last, &mut data);
            own.extend(CanIdMap::default().frames(&last));
            // With a frame missing, or in another order.
            match tag % 8 {
                4 => drop(own.remove(usize::from(tag / 8 % 3))),
                5 => own.swap(0, usize::from(tag / 8 % 3)),
                _ => {}
            }
        } else {
            let payload: [u8; 8] = split(&mut data);
            own.extend(CanFrame::new(0x1A0 + u16::from(tag % 16), &payload[..usize::from(tag / 8 % 9)]));
        }
        t_us += u64::from(*tag) * 4_000;
        for frame in own {
            let interface = if tag / 64 == 3 { "can1" } else { "can0" };
            write!(log, "({}.{:06}) {interface} {:03X}#", t_us / 1_000_000, t_us % 1_000_000, frame.id())
                .expect("memory");
            frame.data().iter().for_each(|byte| write!(log, "{byte:02X}").expect("memory"));
            log.push('\n');
        }
    }
    let log = [log.as_bytes(), cuts].concat();
    let (content, parts) = parts(&log);
    let format = Format::from_name("candump").expect("a format");
    let decode = |parts: &[&[u8]]| capture(Decoder::new(&DecoderOptions::default()), format, parts, |_| {});
    assert_eq!(decode(&[content]), decode(&parts));
}

/// Serial bytes of the described unit that the first byte selects.
pub fn described(data: &[u8]) {
    const NAMES: [&str; 6] = ["hg4930", "kvh-1750", "mti-100", "stim300", "stim300-increment", "tetrad"];
    let Some((first, data)) = data.split_first() else { return };
    let device = device::known(NAMES[usize::from(*first) % NAMES.len()]);
    let frames = &device.frames(false).expect("a serial line").frames;
    let (mut data, cuts) = data.split_at(data.len().saturating_sub(2));
    let (mut stream, mut values) = (Vec::new(), vec![0.0; device.values().len()]);
    while let Some((tag, rest)) = data.split_first() {
        data = rest;
        if *tag >= 0xF0 {
            stream.extend(split::<5>(&mut data));
            continue;
        }
        // Some values change from frame to frame.
        for _ in 0..tag % 4 {
            let [place, change] = split(&mut data);
            let place = usize::from(place) % values.len();
            values[place] += f64::from(change as i8);
        }
        frames[usize::from(tag / 4) % frames.len()].write(&values, &mut stream);
    }
    stream.extend(cuts);
    let (content, parts) = parts(&stream);
    let decode = |parts: &[&[u8]]| serial(DeviceDecoder::new(device, &DecoderOptions::default()), parts);
    assert_eq!(decode(&[content]), decode(&parts));
}
