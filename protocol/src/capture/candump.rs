//! `candump -l` and `candump -L`: `(1795020000.500932) can0 1A0#FFFE000100050005`.
//!
//! Variants in use: three or eight digits select a standard or an extended identifier, names are padded, fractions have six or
//! nine digits, a direction ` T` or ` R` may follow; `123#R8` is a remote frame, `123##1…` a CAN FD frame, an identifier
//! 2xxxxxxx an error frame, and `DROPCOUNT:` lines count the frames that the recorder lost.

use super::text::{LineFormat, hex_byte, hex_data, hex_digit, number, reader, seconds, words};
use super::{CaptureRecord, Detection, Format, Frame, Timestamp};

pub(super) const FORMATS: &[Format] = &[Format {
    name: "candump",
    title: "candump log",
    suffixes: &["log"],
    detection: Detection::Lines,
    new_reader: Some(reader::<Candump>),
}];

const EXTENDED_MAX: u32 = 0x1FFF_FFFF;
const ERROR_FLAG: u32 = 0x2000_0000;

#[derive(Debug, Default)]
struct Candump {
    last_tens: LastTens,
    last_interface: LastInterface,
    data: [u8; 8],
}

impl LineFormat for Candump {
    const IS_INDEPENDENT: bool = true;

    fn read<'a>(&'a mut self, line: &'a [u8]) -> Option<CaptureRecord<'a>> {
        if let Some(remark) = remark(line) {
            return Some(remark);
        }
        let (time, rest) = line.strip_prefix(b"(")?.split_at(memchr::memchr(b')', line)?.checked_sub(1)?);
        let time = seconds(time.trim_ascii())?;
        let mut words = words(&rest[1..]);
        let (interface, frame) = (words.next()?, words.next()?);
        if !matches!((words.next(), words.next()), (None | Some(b"T" | b"R"), None)) {
            return None;
        }
        let hash = memchr::memchr(b'#', frame)?;
        let (id_text, content) = (&frame[..hash], &frame[hash + 1..]);
        if content.get(2) == Some(&b':') {
            return is_xl(id_text, content).then_some(CaptureRecord::Fd);
        }
        let (id, extended) = identifier(id_text)?;
        if id & ERROR_FLAG != 0 && extended {
            hex_bytes(content, &mut self.data)?;
            Some(CaptureRecord::Error)
        } else if let Some(rest) = content.strip_prefix(b"#") {
            (hex_digit(*rest.first()?) < 16).then_some(CaptureRecord::Fd)
        } else if let Some(length) = content.strip_prefix(b"R") {
            let is_length = length.is_empty() || (length.len() <= 3 && hex_digit(length[0]) <= 8);
            is_length.then_some(CaptureRecord::Remote)
        } else if id > EXTENDED_MAX {
            None
        } else {
            let length = hex_bytes(content, &mut self.data)?;
            self.last_interface.set(interface);
            Some(CaptureRecord::Frame(Frame { time: Some(time), interface, id, extended, data: &self.data[..length] }))
        }
    }

    /// Reads a line of the usual form: seconds of up to ten digits, microseconds, the same interface as before, a standard
    /// identifier, eight data bytes and nothing else.
    #[inline]
    fn read_usual<'a>(&'a mut self, bytes: &'a [u8]) -> Option<(Frame<'a>, usize)> {
        let line: &[u8; USUAL] = bytes.first_chunk()?;
        let start = u128::from_le_bytes(part(line, 0));
        if start & self.last_tens.mask != self.last_tens.text {
            self.last_tens = LastTens::new(line)?;
        }
        let (LastTens { point, t_ns: tens_ns, .. }, name) = (self.last_tens, self.last_interface);
        // The digit before the point moves into the place of the point, behind a zero.
        let around = word(line, point - 1);
        let micros = eight_digits(around & !0xFFFF | (around & 0xFF) << 8 | 0x30)?;
        let name_at = point + 9;
        if part(line, point + 7) != *b") " || word(line, name_at) & name.mask != name.word {
            return None;
        }
        let rest: [u8; 21] = part(line, name_at + name.name_length + 1);
        if rest[3] != b'#' || rest[20] != b'\n' {
            return None;
        }
        let (a, b, c) = (hex_digit(rest[0]), hex_digit(rest[1]), hex_digit(rest[2]));
        let id = u32::from(a) << 8 | u32::from(b) << 4 | u32::from(c);
        if a | b | c > 15 || id > 0x7FF {
            return None;
        }
        self.data = hex_data(rest[4..].first_chunk()?)?;
        let t_ns = tens_ns.checked_add(micros as i64 * 1_000)?;
        let interface = &bytes[name_at..name_at + name.name_length];
        let frame =
            Frame { time: Some(Timestamp { t_ns, digits: 6 }), interface, id, extended: false, data: &self.data };
        Some((frame, name_at + name.name_length + 1 + rest.len()))
    }
}

/// Bytes that hold every line of the usual form.
const USUAL: usize = 64;

/// Seconds of the line before but for their last digit, with the parenthesis before them and the point behind; many lines have
/// the same.
#[derive(Debug, Clone, Copy)]
struct LastTens {
    text: u128,
    mask: u128,
    /// Offset of the point, 2 to 11.
    point: usize,
    t_ns: i64,
}

impl Default for LastTens {
    /// The seconds of no line.
    fn default() -> LastTens {
        LastTens { text: u128::MAX, mask: 0, point: 2, t_ns: 0 }
    }
}

impl LastTens {
    fn new(line: &[u8; USUAL]) -> Option<LastTens> {
        let digits = line[1..].iter().take_while(|digit| digit.is_ascii_digit()).count();
        let point = digits + 1;
        if line[0] != b'(' || !(1..=10).contains(&digits) || line[point] != b'.' {
            return None;
        }
        let tens = line[1..digits].iter().fold(0i64, |sum, digit| 10 * sum + i64::from(digit - b'0'));
        let mask = u128::MAX >> (8 * (15 - point)) & !(0xFF << (8 * digits));
        let text = u128::from_le_bytes(part(line, 0)) & mask;
        Some(LastTens { text, mask, point, t_ns: tens.checked_mul(10_000_000_000)? })
    }
}

/// Name of the interface on the line before, as the lowest bytes of a word, with the blank behind it.
#[derive(Debug, Clone, Copy)]
struct LastInterface {
    word: u64,
    mask: u64,
    name_length: usize,
}

impl Default for LastInterface {
    /// The name of no interface.
    fn default() -> LastInterface {
        LastInterface { word: u64::MAX, mask: 0, name_length: 0 }
    }
}

impl LastInterface {
    fn set(&mut self, name: &[u8]) {
        if name.len() < 8 {
            let mut word = [0; 8];
            word[..name.len()].copy_from_slice(name);
            word[name.len()] = b' ';
            let bits = 8 * (name.len() as u32 + 1);
            *self = LastInterface {
                word: u64::from_le_bytes(word),
                mask: u64::MAX >> (64 - bits),
                name_length: name.len(),
            };
        }
    }
}

/// Bytes of a line from an offset below half its length.
#[inline]
fn part<const LENGTH: usize>(line: &[u8; USUAL], at: usize) -> [u8; LENGTH] {
    // The mask removes the check of bounds; every offset is below.
    *line[at % (USUAL / 2)..].first_chunk().expect("a part of less than half a line")
}

#[inline]
fn word(line: &[u8; USUAL], at: usize) -> u64 {
    u64::from_le_bytes(part(line, at))
}

/// The number of eight ASCII digits, the first in the lowest byte (all eight at once, in three multiplications).
#[inline]
fn eight_digits(digits: u64) -> Option<u64> {
    const HIGH: u64 = 0xF0F0_F0F0_F0F0_F0F0;
    let beyond_nine = digits.wrapping_add(0x0606_0606_0606_0606);
    if digits & HIGH | (beyond_nine & HIGH) >> 4 != 0x3333_3333_3333_3333 {
        return None;
    }
    let tens = (digits & 0x0F0F_0F0F_0F0F_0F0F).wrapping_mul(10 << 8 | 1) >> 8;
    let hundreds = (tens & 0x00FF_00FF_00FF_00FF).wrapping_mul(100 << 16 | 1) >> 16;
    Some((hundreds & 0x0000_FFFF_0000_FFFF).wrapping_mul(10_000 << 32 | 1) >> 32)
}

/// Reads blank lines, comments and notes of the recorder.
pub(super) fn remark(line: &[u8]) -> Option<CaptureRecord<'static>> {
    let line = line.trim_ascii();
    if let Some(rest) = line.strip_prefix(b"DROPCOUNT:") {
        let dropped = words(rest).find_map(|word| number(word, 10)).unwrap_or(0);
        return Some(CaptureRecord::Dropped(dropped.into()));
    }
    let comment = line.is_empty() || line.starts_with(b"#") || line.starts_with(b"//") || line.starts_with(b";");
    comment.then_some(CaptureRecord::Remark)
}

/// An identifier of three digits (standard) or eight (extended, or an error frame).
pub(super) fn identifier(text: &[u8]) -> Option<(u32, bool)> {
    let id = number(text, 16)?;
    match text.len() {
        3 if id <= 0x7FF => Some((id, false)),
        8 => Some((id, true)),
        _ => None,
    }
}

/// True for a CAN XL frame: its priority, which two digits of a virtual network may precede, and flags, type, acceptance field and data.
fn is_xl(priority: &[u8], content: &[u8]) -> bool {
    let is_hex = |text: &[u8]| text.iter().all(|digit| hex_digit(*digit) < 16);
    let Some(hash) = memchr::memchr(b'#', content) else { return false };
    let digits = content[..hash].split(|byte| *byte == b':').map(|field| if is_hex(field) { field.len() } else { 0 });
    let data = &content[hash + 1..];
    let is_data = !data.is_empty() && data.len().is_multiple_of(2) && is_hex(data);
    matches!(priority.len(), 3 | 5) && is_hex(priority) && digits.eq([2, 2, 8]) && is_data
}

/// Data of a classic frame: up to eight bytes, points between them allowed, a raw length code `_9`…`_F` behind them.
fn hex_bytes(mut text: &[u8], data: &mut [u8; 8]) -> Option<usize> {
    let mut length = 0;
    while let [high, low, rest @ ..] = text {
        if length == 8 {
            break;
        }
        data[length] = hex_byte(*high, *low)?;
        length += 1;
        text = rest.strip_prefix(b".").unwrap_or(rest);
    }
    match text {
        [] => Some(length),
        [b'_', code] if length == 8 && (9..16).contains(&hex_digit(*code)) => Some(length),
        _ => None,
    }
}
