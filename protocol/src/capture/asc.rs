//! Vector ASC, as Vector's tools, python-can and `log2asc` write it:
//! `   0.500932 1  1A0             Rx   d 8 FF FE 00 01 00 05 00 05`.
//!
//! Times are seconds since the start of the measurement, or (`timestamps relative`) since the line before. The interface is
//! the channel number.

use super::text::{LineFormat, number, reader, seconds, words};
use super::{CaptureRecord, Detection, Format, Frame, Timestamp, is_identifier};

pub(super) const FORMATS: &[Format] = &[Format {
    name: "asc",
    title: "Vector ASC",
    suffixes: &["asc"],
    detection: Detection::Lines,
    new_reader: Some(reader::<Asc>),
}];

/// `CANFD` lines: flag of a frame in the FD format; the line of a classic frame does not have it.
const FD_FORMAT: u32 = 0x1000;
/// `CANFD` lines: a remote frame.
const REMOTE: u32 = 0x10;
/// First words of lines that are no events.
const HEADERS: [&[u8]; 8] = [b"date", b"base", b"internal", b"no", b"begin", b"end", b"previous", b"start"];

#[derive(Debug, Default)]
struct Asc {
    is_decimal: bool,
    is_relative: bool,
    /// Time of the line before, if times are relative.
    elapsed_ns: i64,
    data: [u8; 8],
}

impl LineFormat for Asc {
    fn read<'a>(&'a mut self, line: &'a [u8]) -> Option<CaptureRecord<'a>> {
        let mut words = words(line);
        let Some(first) = words.next() else {
            return Some(CaptureRecord::Remark);
        };
        if first.eq_ignore_ascii_case(b"base") {
            let text = line.to_ascii_lowercase();
            self.is_decimal = memchr::memmem::find(&text, b"base dec").is_some();
            self.is_relative = memchr::memmem::find(&text, b"timestamps relative").is_some();
        }
        if first.starts_with(b"//") || HEADERS.iter().any(|header| first.eq_ignore_ascii_case(header)) {
            return Some(CaptureRecord::Remark);
        }
        let mut time = seconds(first)?;
        if self.is_relative {
            self.elapsed_ns = self.elapsed_ns.checked_add(time.t_ns)?;
            time.t_ns = self.elapsed_ns;
        }
        self.event(time, &mut words)
    }
}

impl Asc {
    /// Reads an event, from the word behind its time.
    fn event<'a>(
        &'a mut self,
        time: Timestamp,
        words: &mut (impl Iterator<Item = &'a [u8]> + Clone),
    ) -> Option<CaptureRecord<'a>> {
        let base = if self.is_decimal { 10 } else { 16 };
        let interface = words.next()?;
        if interface == b"CANFD" {
            return self.fd(time, base, words);
        }
        if number(interface, 10).is_none() {
            // `Start of measurement`, `CAN 1 Status:…`, `SV:`, `LIN`: events of other kinds.
            return Some(CaptureRecord::Remark);
        }
        let id = words.next()?;
        if id == b"ErrorFrame" {
            return Some(CaptureRecord::Error);
        }
        let Some((id, extended)) = identifier(id, base) else {
            // `Statistic:` and other events of the channel are words; a number that is no identifier is a broken frame.
            let is_word = id.iter().all(|byte| byte.is_ascii_alphabetic() || *byte == b':') && id.ends_with(b":");
            return is_word.then_some(CaptureRecord::Remark);
        };
        let (_direction, kind) = (words.next()?, words.next()?);
        match kind {
            b"r" => Some(CaptureRecord::Remote),
            b"d" => {
                let length = number(words.next()?, 16).filter(|&length| length <= 15)?.min(8) as usize;
                let data = self.data(length, base, words)?;
                Some(CaptureRecord::Frame(Frame { time: Some(time), interface, id, extended, data }))
            }
            _ => None,
        }
    }

    /// `channel direction id [name] brs esi dlc length data… duration bits flags …`
    fn fd<'a>(
        &'a mut self,
        time: Timestamp,
        base: u32,
        words: &mut (impl Iterator<Item = &'a [u8]> + Clone),
    ) -> Option<CaptureRecord<'a>> {
        let (interface, direction) = (words.next()?, words.next()?);
        number(interface, 10)?;
        let id = if matches!(direction, b"Rx" | b"Tx" | b"TxRq") { words.next()? } else { direction };
        if id == b"ErrorFrame" {
            return Some(CaptureRecord::Error);
        }
        let (id, extended) = identifier(id, base)?;
        let mut rate_switch = words.next()?;
        if !matches!(rate_switch, b"0" | b"1") {
            rate_switch = words.next()?;
        }
        let (_state, _code, length) = (words.next()?, words.next()?, number(words.next()?, 10)? as usize);
        let flags = number(words.clone().nth(length + 2)?, 16)?;
        if flags & FD_FORMAT != 0 || rate_switch == b"1" || length > 8 {
            return Some(CaptureRecord::Fd);
        }
        if flags & REMOTE != 0 {
            return Some(CaptureRecord::Remote);
        }
        let data = self.data(length, base, words)?;
        Some(CaptureRecord::Frame(Frame { time: Some(time), interface, id, extended, data }))
    }

    fn data<'a>(&mut self, length: usize, base: u32, words: &mut impl Iterator<Item = &'a [u8]>) -> Option<&[u8]> {
        let data = &mut self.data[..length];
        for byte in &mut *data {
            *byte = number(words.next()?, base)?.try_into().ok()?;
        }
        Some(data)
    }
}

fn identifier(text: &[u8], base: u32) -> Option<(u32, bool)> {
    let (digits, extended) = match text {
        [digits @ .., b'x' | b'X'] => (digits, true),
        digits => (digits, false),
    };
    // In decimal an extended identifier takes nine digits.
    let id = std::str::from_utf8(digits).ok().filter(|text| !text.starts_with('+'))?;
    let id = u32::from_str_radix(id, base).ok()?;
    is_identifier(id, extended).then_some((id, extended))
}
