//! Captures: in one part and in three they are the same, and the account covers every record.

use std::io::Write;

use geu_protocol::capture::{CaptureRecord, Detected, Format, Frame, Timestamp, detect};
use geu_recording::{Decoder, DecoderOptions, DeviceDecoder};

use crate::decoded::{capture, forked};
use crate::{device, parts};

/// A capture of the default unit.
pub fn unit(format: &str, data: &[u8]) {
    let format = Format::from_name(format).expect("a format");
    let (content, parts) = parts(data);
    let decode = |parts: &[&[u8]], each: fn(&CaptureRecord)| {
        capture(Decoder::new(&DecoderOptions::default()), format, parts, each)
    };
    let whole = decode(&[content], reads_back);
    assert_eq!(whole, decode(&parts, |_| {}));
    if let Some(records) = forked(format, content, parts[0].len()..content.len() - parts[2].len()) {
        assert_eq!(whole.0, records);
    }
}

/// A capture, or a table, of the known unit that the first byte selects.
pub fn described(format: &str, names: &[&str], data: &[u8]) {
    let Some((first, data)) = data.split_first() else { return };
    let device = device::known(names[usize::from(*first) % names.len()]);
    let format = Format::from_name(format).expect("a format");
    let (content, parts) = parts(data);
    let decode =
        |parts: &[&[u8]]| capture(DeviceDecoder::new(device, &DecoderOptions::default()), format, parts, |_| {});
    assert_eq!(decode(&[content]), decode(&parts));
}

/// The format of an input: a decision from its first bytes holds for all.
pub fn detected(data: &[u8]) {
    let (content, [first, ..]) = parts(data);
    let name = |detected: Detected| match detected {
        Detected::Format(format) => Some(format.name),
        Detected::Foreign(foreign) => Some(foreign.name),
        Detected::UnknownText => Some("text"),
        Detected::Undecided => None,
    };
    assert!(name(detect(content, true)).is_some());
    name(detect(first, false));
}

/// Writes a frame as a line of candump, which must read as the same frame.
fn reads_back(record: &CaptureRecord) {
    let CaptureRecord::Frame(frame @ Frame { time: Some(Timestamp { t_ns: t_ns @ 0.., .. }), .. }) = *record else {
        return;
    };
    let is_name = !frame.interface.is_empty() && frame.interface.iter().all(u8::is_ascii_graphic);
    let interface = if is_name { frame.interface } else { b"can0" };
    let time = Timestamp { t_ns, digits: 9 };
    let (mut line, width) = (Vec::with_capacity(80), if frame.extended { 8 } else { 3 });
    write!(line, "({time}) {} {:0width$X}#", String::from_utf8_lossy(interface), frame.id).expect("memory");
    frame.data.iter().for_each(|byte| write!(line, "{byte:02X}").expect("memory"));
    line.push(b'\n');
    let expected = CaptureRecord::Frame(Frame { time: Some(time), interface, ..frame });
    let (mut reader, mut count) = (Format::from_name("candump").and_then(Format::reader).expect("a reader"), 0);
    reader.read(&line, true, &mut |_, read| {
        count += 1;
        assert_eq!(read, expected);
    });
    assert_eq!(count, 1);
}
