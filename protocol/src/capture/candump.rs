//! `candump -l` and `candump -L`: `(1795020000.500932) can0 1A0#FFFE000100050005`.
//!
//! As it occurs in the wild: three or eight digits decide standard or extended, names are padded, fractions have six or
//! nine digits, a direction ` T` or ` R` may follow; `123#R8` is a remote frame, `123##1…` a CAN FD frame, an identifier
//! 2xxxxxxx an error frame, and `DROPCOUNT:` lines tell what the recorder lost.

use super::text::{Lines, hex_byte, hex_digit, number, seconds, words};
use super::{CaptureRecord, Frame, RecordPosition, Timestamp};

const EXTENDED_MAX: u32 = 0x1FFF_FFFF;
const ERROR_FLAG: u32 = 0x2000_0000;

/// Reads `candump` logs.
#[derive(Debug, Clone, Default)]
pub struct Candump {
    pub(super) lines: Lines,
    interface: LastInterface,
}

impl Candump {
    #[inline]
    pub(super) fn run(
        &mut self,
        bytes: &[u8],
        last: bool,
        sink: &mut impl FnMut(RecordPosition, CaptureRecord),
    ) -> usize {
        let mut at = 0;
        loop {
            while self.lines.at_beginning()
                && let Some((frame, used)) = self.interface.usual_line(&bytes[at..])
            {
                at += used;
                sink(self.lines.count(), CaptureRecord::Frame(frame.as_frame(&bytes[at - used..])));
            }
            let Some(line) = self.lines.next(&bytes[at..], last) else {
                return at;
            };
            at += line.used;
            line.tell(sink, &mut |text, tell| read(text, &mut self.interface, tell));
        }
    }
}

/// A frame of the usual shape, its data and the length of its interface's name.
struct Usual {
    time: Timestamp,
    id: u32,
    data: [u8; 8],
    name_length: usize,
}

impl Usual {
    #[inline]
    fn as_frame<'a>(&'a self, line: &'a [u8]) -> Frame<'a> {
        Frame {
            time: Some(self.time),
            interface: &line[NAME_AT..NAME_AT + self.name_length],
            id: self.id,
            extended: false,
            data: &self.data,
        }
    }
}

/// Where the name begins in `(1795020000.500932) can0 …`.
const NAME_AT: usize = 20;

/// Name of the interface on the line before, as the lowest bytes of a word, with the blank behind it.
#[derive(Debug, Clone, Default)]
struct LastInterface {
    word: u64,
    mask: u64,
    name_length: usize,
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

    /// A line of the shape that nearly all have (ten-digit seconds, microseconds, the same interface as before, a
    /// standard identifier, eight data bytes, nothing behind), or nothing: then the line is read the slow way.
    #[inline]
    fn usual_line(&self, bytes: &[u8]) -> Option<(Usual, usize)> {
        let head: &[u8; NAME_AT + 8] = bytes.first_chunk()?;
        if head[0] != b'(' || head[11] != b'.' || head[18] != b')' || head[19] != b' ' {
            return None;
        }
        if self.name_length == 0 || word(head, NAME_AT) & self.mask != self.word {
            return None;
        }
        // Ten digits, the point, six digits: the last two before the point join the six behind it.
        let seconds_high = eight_digits(word(head, 1))?;
        let low = word(head, 10) & !0xFFFF | word(head, 9) & 0xFFFF;
        let low = eight_digits(low)?;
        let t_ns = ((seconds_high * 100_000_000 + low) as i64).checked_mul(1_000)?;
        let rest: &[u8; 21] = bytes[NAME_AT + self.name_length + 1..].first_chunk()?;
        if rest[3] != b'#' || rest[20] != b'\n' {
            return None;
        }
        let (a, b, c) = (hex_digit(rest[0]), hex_digit(rest[1]), hex_digit(rest[2]));
        let mut wrong = a | b | c;
        let mut data = [0; 8];
        for (index, byte) in data.iter_mut().enumerate() {
            let (high, low) = (hex_digit(rest[4 + 2 * index]), hex_digit(rest[5 + 2 * index]));
            wrong |= high | low;
            *byte = high << 4 | low;
        }
        let id = u32::from(a) << 8 | u32::from(b) << 4 | u32::from(c);
        if wrong > 15 || id > 0x7FF {
            return None;
        }
        let time = Timestamp { t_ns, digits: 6 };
        Some((Usual { time, id, data, name_length: self.name_length }, NAME_AT + self.name_length + 1 + rest.len()))
    }
}

#[inline]
fn word(bytes: &[u8; NAME_AT + 8], at: usize) -> u64 {
    u64::from_le_bytes(*bytes[at..].first_chunk().unwrap_or(&[0; 8]))
}

/// The number that eight ASCII digits write, the first in the lowest byte (all eight at once, in three multiplications).
#[inline]
fn eight_digits(digits: u64) -> Option<u64> {
    const HIGH: u64 = 0xF0F0_F0F0_F0F0_F0F0;
    const THREES: u64 = 0x3030_3030_3030_3030;
    if digits & HIGH != THREES || (digits.wrapping_add(0x0606_0606_0606_0606)) & HIGH != THREES {
        return None;
    }
    let tens = (digits & 0x0F0F_0F0F_0F0F_0F0F).wrapping_mul(10 << 8 | 1) >> 8;
    let hundreds = (tens & 0x00FF_00FF_00FF_00FF).wrapping_mul(100 << 16 | 1) >> 16;
    Some((hundreds & 0x0000_FFFF_0000_FFFF).wrapping_mul(10_000 << 32 | 1) >> 32)
}

/// Reads any line; nothing where it is broken.
fn read(line: &[u8], last_interface: &mut LastInterface, tell: &mut dyn FnMut(CaptureRecord)) -> Option<()> {
    if let Some(event) = remark(line) {
        tell(event);
        return Some(());
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
    let (id, extended) = identifier(id_text)?;
    let mut data = [0; 8];
    let event = if id & ERROR_FLAG != 0 && extended {
        hex_bytes(content, &mut data)?;
        CaptureRecord::Error
    } else if let Some(rest) = content.strip_prefix(b"#") {
        if rest.is_empty() || hex_digit(rest[0]) > 15 {
            return None;
        }
        CaptureRecord::Fd
    } else if content.get(2) == Some(&b':') {
        CaptureRecord::Fd
    } else if let Some(length) = content.strip_prefix(b"R") {
        if !length.is_empty() && (length.len() > 3 || hex_digit(length[0]) > 8) {
            return None;
        }
        CaptureRecord::Remote
    } else {
        if id > EXTENDED_MAX {
            return None;
        }
        let length = hex_bytes(content, &mut data)?;
        last_interface.set(interface);
        CaptureRecord::Frame(Frame { time: Some(time), interface, id, extended, data: &data[..length] })
    };
    tell(event);
    Some(())
}

/// Blank lines, comments, and what the recorder says itself.
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
