//! Descriptions of units, and the units that they describe.

use std::collections::HashMap;
use std::sync::{Arc, LazyLock};

use geu_model::device::{DEVICES, Device};
use geu_model::{Configuration, GyroUnit};
use geu_protocol::layout::{Database, Frame};
use geu_recording::{DecoderOptions, DeviceDecoder};

use crate::decoded;

/// Samples of a unit.
const SAMPLES: usize = 3;

/// The unit of that name.
pub fn known(name: &str) -> &'static Device {
    static ALL: LazyLock<HashMap<&str, Device>> =
        LazyLock::new(|| DEVICES.iter().map(|(name, _)| (*name, Device::from_name(name).expect("a unit"))).collect());
    &ALL[name]
}

/// A description, and behind a zero byte the file that it names. A unit that is accepted runs, and what it sends is what it reads.
pub fn description(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    let (text, file) = text.split_once('\0').unwrap_or((text, ""));
    let Ok(device) = Device::parse("device.toml", text, &|_| Ok(file.to_owned())) else { return };
    let device = Arc::new(device);
    let configuration = Configuration::of_device(&device, &[]).expect("a unit without errors");
    let mut unit = GyroUnit::new(&configuration);
    let mut sent = [Vec::new(), Vec::new()];
    for _ in 0..if device.interval_s > 10.0 { 1 } else { SAMPLES } {
        let sample = unit.end_sample();
        assert!(sample.outputs.counts.iter().all(|count| count.is_finite()), "{:?}", sample.outputs);
        for (is_can, sent) in [false, true].into_iter().zip(&mut sent) {
            for (frame, bytes) in device.encode(is_can, &sample) {
                is_read(&device, frame, &bytes);
                sent.extend(bytes);
            }
        }
    }
    let parts: Vec<&[u8]> = sent[0].chunks(7).collect();
    let decode = |parts: &[&[u8]]| decoded::serial(DeviceDecoder::new(&device, &DecoderOptions::default()), parts);
    assert_eq!(decode(&[&sent[0]]), decode(&parts));
}

/// The bytes of a frame are one, and their numbers are written as the same bytes.
fn is_read(device: &Device, frame: &Frame, bytes: &[u8]) {
    assert_eq!(bytes.len(), frame.length());
    assert!(frame.has_constants(bytes) && frame.checks_hold(bytes), "{}: {bytes:02X?}", frame.name);
    let mut values = vec![0.0; device.values().len()];
    frame.read(bytes, &mut values);
    let mut again = Vec::new();
    frame.write(&values, &mut again);
    assert_eq!(bytes, again, "{}", frame.name);
}

/// A CAN database.
pub fn database(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    let Ok(database) = Database::parse(text) else { return };
    for message in &database.messages {
        for place in message.signals.iter().filter_map(|signal| signal.place) {
            assert!(place.end() <= message.length, "{message:?}");
        }
    }
}
