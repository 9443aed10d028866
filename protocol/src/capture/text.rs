//! What the text formats share: lines out of pieces, numbers out of digits.

use super::{CaptureRecord, MAX_RECORD, RecordPosition, Timestamp, told};

/// What editors and shells on Windows write before a text in UTF-8.
const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";

/// Cuts a stream into lines and numbers them.
#[derive(Debug, Clone, Default)]
pub struct Lines {
    number: u64,
    /// Inside a line too long to keep, which has been told already.
    discarding: bool,
}

impl Lines {
    pub fn number(&self) -> u64 {
        self.number
    }

    /// Counts a line that was read without [`Lines::next`], and gives its place.
    #[inline]
    pub fn count(&mut self) -> RecordPosition {
        self.number += 1;
        RecordPosition::Line(self.number)
    }

    /// Whether the next byte begins a line.
    #[inline]
    pub fn at_beginning(&self) -> bool {
        !self.discarding
    }

    /// Takes one line off `bytes`; nothing when it is not complete yet.
    #[inline]
    pub fn next<'a>(&mut self, bytes: &'a [u8], last: bool) -> Option<Line<'a>> {
        let end = memchr::memchr(b'\n', bytes);
        let used = match end {
            Some(end) => end + 1,
            None if bytes.is_empty() || (!last && bytes.len() <= MAX_RECORD) => return None,
            None => bytes.len(),
        };
        let mut text = &bytes[..end.unwrap_or(used)];
        if self.number == 0 {
            text = text.strip_prefix(BYTE_ORDER_MARK).unwrap_or(text);
        }
        let discarded = self.discarding;
        self.discarding = end.is_none() && !last;
        let content = if discarded {
            Content::Discarded
        } else {
            self.number += 1;
            if text.len() > MAX_RECORD {
                Content::Broken(CaptureRecord::Broken { bytes: told(text), cut: false })
            } else {
                Content::Text(text.strip_suffix(b"\r").unwrap_or(text))
            }
        };
        Some(Line { used, place: RecordPosition::Line(self.number), content, cut: end.is_none() })
    }

    /// Runs through all lines of `bytes`, giving each to `read`; a line it does not understand is told as broken.
    pub fn run(
        &mut self,
        bytes: &[u8],
        last: bool,
        sink: &mut impl FnMut(RecordPosition, CaptureRecord),
        mut read: impl FnMut(&[u8], &mut dyn FnMut(CaptureRecord)) -> Option<()>,
    ) -> usize {
        let mut at = 0;
        while let Some(line) = self.next(&bytes[at..], last) {
            at += line.used;
            line.tell(sink, &mut read);
        }
        at
    }
}

/// One line, or the end of one too long.
pub struct Line<'a> {
    /// Bytes it takes, with its end.
    pub used: usize,
    place: RecordPosition,
    content: Content<'a>,
    cut: bool,
}

enum Content<'a> {
    Text(&'a [u8]),
    Broken(CaptureRecord<'a>),
    Discarded,
}

impl Line<'_> {
    /// Gives the text to `read`, and tells what it made of it.
    #[inline]
    pub fn tell(
        self,
        sink: &mut impl FnMut(RecordPosition, CaptureRecord),
        read: &mut impl FnMut(&[u8], &mut dyn FnMut(CaptureRecord)) -> Option<()>,
    ) {
        match self.content {
            Content::Text(text) => {
                if read(text, &mut |event| sink(self.place, event)).is_none() {
                    sink(self.place, CaptureRecord::Broken { bytes: told(text), cut: self.cut });
                }
            }
            Content::Broken(event) => sink(self.place, event),
            Content::Discarded => {}
        }
    }
}

const NO_DIGIT: u8 = 0xFF;

/// Value of each hexadecimal digit, [`NO_DIGIT`] for what is none.
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

/// The value of a hexadecimal digit; above 15 for what is none, so that several can be checked at once with `|`.
#[inline]
pub fn hex_digit(digit: u8) -> u8 {
    HEX[usize::from(digit)]
}

/// The byte that two hexadecimal digits write.
#[inline]
pub fn hex_byte(high: u8, low: u8) -> Option<u8> {
    let (high, low) = (hex_digit(high), hex_digit(low));
    (high | low < 16).then_some(high << 4 | low)
}

/// A number in base 10 or 16, of at least one and not more than eight digits.
pub fn number(text: &[u8], base: u32) -> Option<u32> {
    if text.is_empty() || text.len() > 8 {
        return None;
    }
    text.iter().try_fold(0u32, |sum, &digit| {
        let digit = u32::from(hex_digit(digit));
        if digit < base { sum.checked_mul(base)?.checked_add(digit) } else { None }
    })
}

/// `seconds[.fraction]`, with any number of digits behind the point (more than nine are cut off).
pub fn seconds(text: &[u8]) -> Option<Timestamp> {
    let (negative, text) = match text.strip_prefix(b"-") {
        Some(rest) => (true, rest),
        None => (false, text),
    };
    let point = memchr::memchr(b'.', text).unwrap_or(text.len());
    let (whole, fraction) = (&text[..point], text.get(point + 1..).unwrap_or_default());
    if whole.is_empty() || (point < text.len() && fraction.is_empty()) {
        return None;
    }
    let mut t_ns = whole.iter().try_fold(0i64, |sum, digit| {
        if digit.is_ascii_digit() { sum.checked_mul(10)?.checked_add(i64::from(digit - b'0')) } else { None }
    })?;
    t_ns = t_ns.checked_mul(1_000_000_000)?;
    let mut weight = 100_000_000;
    for digit in fraction {
        if !digit.is_ascii_digit() {
            return None;
        }
        t_ns = t_ns.checked_add(i64::from(digit - b'0') * weight)?;
        weight /= 10;
    }
    Some(Timestamp { t_ns: if negative { -t_ns } else { t_ns }, digits: fraction.len().min(9) as u8 })
}

pub fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> + Clone {
    line.split(|byte| matches!(byte, b' ' | b'\t')).filter(|word| !word.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

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
