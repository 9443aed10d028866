//! Text formats: lines from chunks of any size, numbers from digits.

use std::fmt::Debug;

use wide::{bytemuck, i16x8, u8x16};

use super::{CaptureRecord, Frame, MAX_RECORD, Reader, RecordPosition, Timestamp};

/// Editors and shells on Windows write it before a text in UTF-8.
const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";

/// A text format.
pub trait LineFormat: Debug + Default + Send + 'static {
    /// True if a line means the same behind any other.
    const IS_INDEPENDENT: bool = false;

    /// Reads a line without its end; `None` if it is broken.
    fn read<'a>(&'a mut self, line: &'a [u8]) -> Option<CaptureRecord<'a>>;

    /// Fast path: reads the line at the start of `bytes` and returns its length; `None` leaves it to [`LineFormat::read`].
    #[inline]
    fn read_usual<'a>(&'a mut self, _bytes: &'a [u8]) -> Option<(Frame<'a>, usize)> {
        None
    }
}

/// Reader of a text format.
#[derive(Debug, Default)]
pub struct TextReader<F> {
    lines: Lines,
    format: F,
}

/// Constructor of the reader of a text format.
pub fn reader<F: LineFormat>() -> Box<dyn Reader> {
    Box::new(TextReader::<F>::default())
}

impl<F: LineFormat> Reader for TextReader<F> {
    fn read(&mut self, bytes: &[u8], is_last: bool, sink: &mut dyn FnMut(RecordPosition, CaptureRecord)) -> usize {
        let Self { lines, format } = self;
        let mut at = 0;
        loop {
            while !lines.is_discarding
                && let Some((frame, used)) = format.read_usual(&bytes[at..])
            {
                lines.number += 1;
                sink(RecordPosition::Line(lines.number), CaptureRecord::Frame(frame));
                at += used;
            }
            let Some(line) = lines.next(&bytes[at..], is_last) else {
                return at;
            };
            at += line.used;
            let record = match line.content {
                Content::Text(text) => format.read(text).unwrap_or(CaptureRecord::broken(text, line.is_cut)),
                Content::TooLong(text) => CaptureRecord::broken(text, false),
                Content::Discarded => continue,
            };
            sink(RecordPosition::Line(lines.number), record);
        }
    }

    fn records(&self) -> u64 {
        self.lines.number
    }

    fn fork(&self) -> Option<Box<dyn Reader>> {
        // A byte order mark is part of the first line only.
        let lines = Lines { number: 1, is_discarding: false };
        let is_possible = F::IS_INDEPENDENT && !self.lines.is_discarding;
        is_possible.then(|| Box::new(TextReader { lines, format: F::default() }) as Box<dyn Reader>)
    }

    fn skip(&mut self, records: u64) {
        self.lines.number += records;
    }
}

/// Splits a stream into lines and counts them.
#[derive(Debug, Default)]
pub struct Lines {
    number: u64,
    /// True inside a line that is too long and already reported.
    is_discarding: bool,
}

pub struct Line<'a> {
    /// Number of bytes, with the end of the line.
    pub used: usize,
    pub content: Content<'a>,
    /// True if it has no end.
    is_cut: bool,
}

pub enum Content<'a> {
    Text(&'a [u8]),
    /// First bytes of a line longer than [`MAX_RECORD`].
    TooLong(&'a [u8]),
    /// Further bytes of it.
    Discarded,
}

impl Lines {
    /// Takes one line off `bytes`; `None` if it is incomplete.
    #[inline]
    pub fn next<'a>(&mut self, bytes: &'a [u8], is_last: bool) -> Option<Line<'a>> {
        let end = memchr::memchr(b'\n', bytes);
        let used = match end {
            Some(end) => end + 1,
            None if bytes.is_empty() || (!is_last && bytes.len() <= MAX_RECORD) => return None,
            None => bytes.len(),
        };
        let mut text = &bytes[..end.unwrap_or(used)];
        if self.number == 0 {
            text = text.strip_prefix(BYTE_ORDER_MARK).unwrap_or(text);
        }
        let was_discarding = self.is_discarding;
        self.is_discarding = end.is_none() && !is_last;
        self.number += u64::from(!was_discarding);
        let content = if was_discarding {
            Content::Discarded
        } else if text.len() > MAX_RECORD {
            Content::TooLong(text)
        } else {
            Content::Text(text.strip_suffix(b"\r").unwrap_or(text))
        };
        Some(Line { used, content, is_cut: end.is_none() })
    }
}

const NO_DIGIT: u8 = 0xFF;

/// Value of each hexadecimal digit; [`NO_DIGIT`] for any other byte.
const HEX: [u8; 256] = {
    let mut table = [NO_DIGIT; 256];
    let mut value = 0;
    while value < 16 {
        table[b"0123456789ABCDEF"[value as usize] as usize] = value;
        table[b"0123456789abcdef"[value as usize] as usize] = value;
        value += 1;
    }
    table
};

/// Value of a hexadecimal digit; above 15 for any other byte, so that `|` checks several at once.
#[inline]
pub fn hex_digit(digit: u8) -> u8 {
    HEX[usize::from(digit)]
}

/// The byte of two hexadecimal digits.
#[inline]
pub fn hex_byte(high: u8, low: u8) -> Option<u8> {
    let (high, low) = (hex_digit(high), hex_digit(low));
    (high | low < 16).then_some(high << 4 | low)
}

/// The bytes of 16 hexadecimal digits, all at once.
#[inline]
pub fn hex_data(text: &[u8; 16]) -> Option<[u8; 8]> {
    let text = u8x16::new(*text);
    let up_to = |values: u8x16, max| values.min(u8x16::splat(max)).simd_eq(values);
    let is_decimal = up_to(text - u8x16::splat(b'0'), 9);
    let is_letter = up_to((text | u8x16::splat(0x20)) - u8x16::splat(b'a'), 5);
    if !(is_decimal | is_letter).all() {
        return None;
    }
    let values = (text & u8x16::splat(0x0F)) + (is_letter & u8x16::splat(9));
    let values: i16x8 = bytemuck::cast(values);
    let pairs = if cfg!(target_endian = "little") { values << 4 | values >> 8 } else { values >> 4 | values };
    let pairs = pairs & i16x8::splat(0xFF);
    u8x16::narrow_i16x8(pairs, pairs).to_array().first_chunk().copied()
}

/// A number in base 10 or 16, of one to eight digits.
pub fn number(text: &[u8], base: u32) -> Option<u32> {
    if text.is_empty() || text.len() > 8 {
        return None;
    }
    text.iter().try_fold(0u32, |sum, &digit| {
        let digit = u32::from(hex_digit(digit));
        if digit < base { sum.checked_mul(base)?.checked_add(digit) } else { None }
    })
}

/// `seconds[.fraction]`; decimals beyond the nanosecond are dropped.
pub fn seconds(text: &[u8]) -> Option<Timestamp> {
    decimal(text, 1_000_000_000)
}

/// A time in a unit of this number of nanoseconds, a power of ten; decimals beyond the nanosecond are dropped.
// Inlined, so that the unit is a constant.
#[inline(always)]
pub fn decimal(text: &[u8], unit_ns: i64) -> Option<Timestamp> {
    let (sign, text) = text.strip_prefix(b"-").map_or((1, text), |rest| (-1, rest));
    let point = memchr::memchr(b'.', text).unwrap_or(text.len());
    let (whole, fraction) = (&text[..point], text.get(point + 1..).unwrap_or_default());
    if whole.is_empty() || (point < text.len() && fraction.is_empty()) {
        return None;
    }
    let mut t_ns = whole.iter().try_fold(0i64, |sum, digit| {
        if digit.is_ascii_digit() { sum.checked_mul(10)?.checked_add(i64::from(digit - b'0')) } else { None }
    })?;
    t_ns = t_ns.checked_mul(unit_ns)?;
    let mut weight = unit_ns / 10;
    for digit in fraction {
        if !digit.is_ascii_digit() {
            return None;
        }
        t_ns = t_ns.checked_add(i64::from(digit - b'0') * weight)?;
        weight /= 10;
    }
    let digits = fraction.len() + 9 - unit_ns.ilog10() as usize;
    Some(Timestamp { t_ns: sign * t_ns, digits: digits.min(9) })
}

pub fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> + Clone {
    line.split(|byte| matches!(byte, b' ' | b'\t')).filter(|word| !word.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hexadecimal_digits_are_read_together_as_alone() {
        for other in 0..=255u8 {
            for place in 0..16 {
                let mut text = *b"0123456789abCDEF";
                text[place] = other;
                let mut alone = [0; 8];
                let is_hex = alone.iter_mut().zip(text.chunks_exact(2)).all(|(byte, pair)| {
                    hex_byte(pair[0], pair[1]).is_some_and(|value| {
                        *byte = value;
                        true
                    })
                });
                assert_eq!(hex_data(&text), is_hex.then_some(alone), "{other} at {place}");
            }
        }
    }

    #[test]
    fn seconds_keep_every_digit_up_to_the_nanosecond() {
        let time = |text: &str| seconds(text.as_bytes()).map(|time| (time.t_ns, time.digits));
        assert_eq!(time("1795020000.500932"), Some((1_795_020_000_500_932_000, 6)));
        assert_eq!(time("0.123456789"), Some((123_456_789, 9)));
        assert_eq!(time("0.1234567899"), Some((123_456_789, 9)));
        assert_eq!(time("-0.5"), Some((-500_000_000, 1)));
        assert_eq!(time("7"), Some((7_000_000_000, 0)));
        for wrong in ["", ".", "1.", ".5", "1.x", "x.1", "99999999999999999999.0", "9999999999.0"] {
            assert_eq!(time(wrong), None, "{wrong}");
        }
    }
}
