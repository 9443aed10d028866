//! Vector ASC, as Vector's tools, python-can and `log2asc` write it:
//! `   0.500932 1  1A0             Rx   d 8 FF FE 00 01 00 05 00 05`.
//!
//! Times are seconds since the measurement began, or (`timestamps relative`) since the line before. The interface is the
//! channel number.

use super::text::{Lines, number, seconds, words};
use super::{CaptureRecord, Frame, RecordPosition, Timestamp};

/// `CANFD` lines: this flag tells a frame in the FD format; without it the line holds a classic frame.
const FD_FORMAT: u32 = 0x1000;
/// `CANFD` lines: a remote frame.
const REMOTE: u32 = 0x10;
/// Words at the beginning of lines that are no events.
const HEADERS: [&[u8]; 8] = [b"date", b"base", b"internal", b"no", b"begin", b"end", b"previous", b"start"];

#[derive(Debug, Clone, Default)]
pub struct Asc {
    pub(super) lines: Lines,
    settings: Settings,
}

#[derive(Debug, Clone, Default)]
struct Settings {
    decimal: bool,
    relative: bool,
    /// Time of the line before, where times are relative.
    elapsed_ns: i64,
}

impl Asc {
    pub(super) fn run(
        &mut self,
        bytes: &[u8],
        last: bool,
        sink: &mut impl FnMut(RecordPosition, CaptureRecord),
    ) -> usize {
        let settings = &mut self.settings;
        self.lines.run(bytes, last, sink, |line, tell| read(line, settings, tell))
    }
}

fn read(line: &[u8], settings: &mut Settings, tell: &mut dyn FnMut(CaptureRecord)) -> Option<()> {
    let mut words = words(line);
    let Some(first) = words.next() else {
        tell(CaptureRecord::Remark);
        return Some(());
    };
    if first.eq_ignore_ascii_case(b"base") {
        let text = line.to_ascii_lowercase();
        settings.decimal = memchr::memmem::find(&text, b"base dec").is_some();
        settings.relative = memchr::memmem::find(&text, b"timestamps relative").is_some();
    }
    if first.starts_with(b"//") || HEADERS.iter().any(|header| first.eq_ignore_ascii_case(header)) {
        tell(CaptureRecord::Remark);
        return Some(());
    }
    let mut time = seconds(first)?;
    if settings.relative {
        settings.elapsed_ns = settings.elapsed_ns.checked_add(time.t_ns)?;
        time.t_ns = settings.elapsed_ns;
    }
    event(time, settings, &mut words, tell)
}

fn event<'a>(
    time: Timestamp,
    settings: &Settings,
    words: &mut (impl Iterator<Item = &'a [u8]> + Clone),
    tell: &mut dyn FnMut(CaptureRecord),
) -> Option<()> {
    let base = if settings.decimal { 10 } else { 16 };
    let mut data = [0; 8];
    let interface = words.next()?;
    if interface == b"CANFD" {
        tell(fd(time, base, words, &mut data)?);
        return Some(());
    }
    if number(interface, 10).is_none() {
        // `Start of measurement`, `CAN 1 Status:…`, `SV:`, `LIN`: events of other kinds.
        tell(CaptureRecord::Remark);
        return Some(());
    }
    let id = words.next()?;
    if id == b"ErrorFrame" {
        tell(CaptureRecord::Error);
        return Some(());
    }
    let Some((id, extended)) = identifier(id, base) else {
        // `Statistic:` and other events of the channel are words; a number that is no identifier is a broken frame.
        let word = id.iter().all(|byte| byte.is_ascii_alphabetic() || *byte == b':') && id.ends_with(b":");
        return word.then(|| tell(CaptureRecord::Remark));
    };
    let (_direction, kind) = (words.next()?, words.next()?);
    match kind {
        b"r" => tell(CaptureRecord::Remote),
        b"d" => {
            let length = number(words.next()?, 16).filter(|&length| length <= 15)?.min(8) as usize;
            read_data(base, words, &mut data[..length])?;
            tell(CaptureRecord::Frame(Frame { time: Some(time), interface, id, extended, data: &data[..length] }));
        }
        _ => return None,
    }
    Some(())
}

/// `channel direction id [name] brs esi dlc length data… duration bits flags …`
fn fd<'a, 'b>(
    time: Timestamp,
    base: u32,
    words: &mut (impl Iterator<Item = &'a [u8]> + Clone),
    data: &'b mut [u8; 8],
) -> Option<CaptureRecord<'b>>
where
    'a: 'b,
{
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
    read_data(base, words, &mut data[..length])?;
    Some(CaptureRecord::Frame(Frame { time: Some(time), interface, id, extended, data: &data[..length] }))
}

fn identifier(text: &[u8], base: u32) -> Option<(u32, bool)> {
    let (digits, extended) = match text {
        [digits @ .., b'x' | b'X'] => (digits, true),
        digits => (digits, false),
    };
    // In decimal an extended identifier takes nine digits.
    let id = std::str::from_utf8(digits).ok().filter(|text| !text.starts_with('+'))?;
    let id = u32::from_str_radix(id, base).ok()?;
    (id <= if extended { 0x1FFF_FFFF } else { 0x7FF }).then_some((id, extended))
}

fn read_data<'a>(base: u32, words: &mut impl Iterator<Item = &'a [u8]>, data: &mut [u8]) -> Option<()> {
    for byte in data {
        *byte = number(words.next()?, base)?.try_into().ok()?;
    }
    Some(())
}
