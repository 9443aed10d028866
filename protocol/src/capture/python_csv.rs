//! python-can's CSV: `1795020000.500932,0x1a0,0,0,0,8,//4AAQAFAAU=`. It does not mark CAN FD frames: a frame of up to
//! eight bytes is read as a classic frame, as python-can does.

use super::text::{LineFormat, number, reader, seconds};
use super::{CaptureRecord, Detection, Format, Frame, Timestamp, is_identifier};

pub(super) const FORMATS: &[Format] = &[Format {
    name: "python-can-csv",
    title: "python-can's CSV",
    suffixes: &["csv"],
    detection: Detection::Lines,
    new_reader: Some(reader::<PythonCsv>),
}];

const HEADER: &[u8] = b"timestamp,arbitration_id,extended,remote,error,dlc,data";
/// Data of a CAN FD frame.
const MAX_DATA: usize = 64;

#[derive(Debug, Default)]
struct PythonCsv {
    data: [u8; 8],
}

impl LineFormat for PythonCsv {
    fn read<'a>(&'a mut self, line: &'a [u8]) -> Option<CaptureRecord<'a>> {
        if line == HEADER || line.trim_ascii().is_empty() {
            return Some(CaptureRecord::Remark);
        }
        let mut cells = line.split(|&byte| byte == b',');
        let mut cell = || cells.next();
        let (time, id, extended, remote) =
            (time(cell()?)?, number(cell()?.strip_prefix(b"0x")?, 16)?, flag(cell()?)?, flag(cell()?)?);
        let (error, length, base64) = (flag(cell()?)?, number(cell()?, 10)? as usize, cell()?);
        if cells.next().is_some() || !is_identifier(id, extended) {
            return None;
        }
        if error || remote {
            return Some(if error { CaptureRecord::Error } else { CaptureRecord::Remote });
        }
        if length > MAX_DATA || base64.len() != length.div_ceil(3) * 4 {
            return None;
        }
        if length > self.data.len() {
            return Some(CaptureRecord::Fd);
        }
        decode(base64, &mut self.data[..length])?;
        Some(CaptureRecord::Frame(Frame { time: Some(time), interface: b"", id, extended, data: &self.data[..length] }))
    }
}

/// Seconds as Python prints a `float`, with an exponent if they are small.
fn time(text: &[u8]) -> Option<Timestamp> {
    seconds(text).or_else(|| {
        let time_s = std::str::from_utf8(text).ok().filter(|text| text.contains('e'))?.parse::<f64>().ok()?;
        (time_s.abs() < 9e9).then_some(Timestamp { t_ns: (time_s * 1e9).round() as i64, digits: 9 })
    })
}

fn flag(text: &[u8]) -> Option<bool> {
    matches!(text, b"0" | b"1").then_some(text == b"1")
}

/// Decodes base64 that holds exactly this number of bytes.
fn decode(base64: &[u8], data: &mut [u8]) -> Option<()> {
    for (group, bytes) in base64.chunks_exact(4).zip(data.chunks_mut(3)) {
        let (digits, padding) = group.split_at(bytes.len() + 1);
        let value =
            digits.iter().try_fold(0, |sum, digit| Some(sum << 6 | base64_digit(*digit)?))? << (6 * padding.len());
        bytes.copy_from_slice(&u32::to_be_bytes(value)[1..][..bytes.len()]);
        if padding.iter().any(|&byte| byte != b'=') {
            return None;
        }
    }
    Some(())
}

fn base64_digit(digit: u8) -> Option<u32> {
    Some(u32::from(match digit {
        b'A'..=b'Z' => digit - b'A',
        b'a'..=b'z' => digit - b'a' + 26,
        b'0'..=b'9' => digit - b'0' + 52,
        b'+' => 62,
        b'/' => 63,
        _ => return None,
    }))
}
