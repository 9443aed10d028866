//! Output of `candump` on a terminal: `  can0  1A0   [8]  FF FE 00 01 00 05 00 05`, with or without times (`-t`),
//! direction (`-x`) and characters (`-a`).

use super::candump::{identifier, remark};
use super::text::{Content, LineFormat, Lines, hex_byte, number, reader, seconds, words};
use super::{CaptureRecord, Detection, Format, Frame, Timestamp};
use crate::calendar::days_since_1970;

pub(super) const FORMATS: &[Format] = &[
    Format {
        name: "console",
        title: "candump output",
        suffixes: &["txt"],
        detection: Detection::Variants(select),
        new_reader: Some(reader::<Console<false>>),
    },
    Format {
        name: "console-delta",
        title: "candump output with -t d",
        suffixes: &["txt"],
        detection: Detection::Variant,
        new_reader: Some(reader::<Console<true>>),
    },
];

/// Number of timed lines among which time differences decrease.
const LINES_FOR_DELTA: usize = 8;
/// Larger times are no differences.
const MAX_DELTA_NS: i64 = 100_000_000 * 1_000_000_000;

/// Selects the variant: times that are small and decrease are differences (`-t d`). `None` if more lines are needed.
fn select(head: &[u8], is_complete: bool) -> Option<&'static Format> {
    let (mut timed, mut before_ns, mut is_decreasing, mut is_absolute) = (0, i64::MIN, false, false);
    let (mut lines, mut at) = (Lines::default(), 0);
    while let Some(line) = lines.next(&head[at..], is_complete) {
        if let Content::Text(text) = line.content
            && let Some((Some(time), _)) = time(text)
        {
            is_decreasing |= time.t_ns < before_ns;
            is_absolute |= time.t_ns > MAX_DELTA_NS;
            (timed, before_ns) = (timed + 1, time.t_ns);
        }
        at += line.used;
    }
    let is_open = timed > 0 && timed < LINES_FOR_DELTA && !is_absolute && !is_decreasing && !is_complete;
    (!is_open).then_some(&FORMATS[usize::from(is_decreasing && !is_absolute)])
}

/// Reader of `candump` output; `IS_DELTA` if times are differences to the line before.
#[derive(Debug, Default)]
struct Console<const IS_DELTA: bool> {
    /// Sum of the differences.
    elapsed_ns: i64,
    data: [u8; 8],
}

impl<const IS_DELTA: bool> LineFormat for Console<IS_DELTA> {
    fn read<'a>(&'a mut self, line: &'a [u8]) -> Option<CaptureRecord<'a>> {
        if let Some(remark) = remark(line) {
            return Some(remark);
        }
        // With -e, indented lines explain the error frame before them.
        if line.starts_with(b"\t") {
            return Some(CaptureRecord::Remark);
        }
        let (mut time, rest) = time(line)?;
        if let (true, Some(time)) = (IS_DELTA, &mut time) {
            self.elapsed_ns = self.elapsed_ns.checked_add(time.t_ns)?;
            time.t_ns = self.elapsed_ns;
        }
        let mut words = words(rest);
        let interface = words.next()?;
        let mut word = words.next()?;
        if matches!(word, b"TX" | b"RX") {
            // -x: the direction, then one word each for the flags of the message.
            word = words.by_ref().find(|word| !matches!(word, [b'-' | b'B' | b'E' | b'P' | b'S']))?;
        }
        let (id, extended) = identifier(word)?;
        let ([b'[', length @ .., b']'] | [b'{', length @ .., b'}']) = words.next()? else {
            return None;
        };
        if length.len() == 2 {
            number(length, 10)?;
            return Some(CaptureRecord::Fd);
        }
        let length = number(length, 16)?.min(8) as usize;
        if extended && id & 0x2000_0000 != 0 {
            return Some(CaptureRecord::Error);
        }
        if words.clone().next() == Some(b"remote") {
            return Some(CaptureRecord::Remote);
        }
        let data = &mut self.data[..length];
        for byte in &mut *data {
            let [high, low] = words.next()? else { return None };
            *byte = hex_byte(*high, *low)?;
        }
        // Only characters in quotes may follow the data.
        if words.next().is_some_and(|word| !word.starts_with(b"'")) || id > 0x1FFF_FFFF {
            return None;
        }
        Some(CaptureRecord::Frame(Frame { time, interface, id, extended, data }))
    }
}

/// The optional time in brackets at the start of a line, and the rest of the line.
fn time(line: &[u8]) -> Option<(Option<Timestamp>, &[u8])> {
    let line = line.trim_ascii_start();
    let Some(text) = line.strip_prefix(b"(") else {
        return Some((None, line));
    };
    let (text, rest) = text.split_at(memchr::memchr(b')', text)?);
    let text = text.trim_ascii();
    let time = match memchr::memchr(b' ', text) {
        Some(blank) => date_and_time(&text[..blank], &text[blank + 1..])?,
        None => seconds(text)?,
    };
    Some((Some(time), &rest[1..]))
}

/// `2026-11-21 03:17:13.123456`; without a time zone; read as UTC.
fn date_and_time(date: &[u8], time: &[u8]) -> Option<Timestamp> {
    let mut parts = date.split(|&byte| byte == b'-').map(|part| number(part, 10).map(i64::from));
    let (year, month, day) = (parts.next()??, parts.next()??, parts.next()??);
    let mut parts = time.splitn(3, |&byte| byte == b':');
    let (hour, minute) = (i64::from(number(parts.next()?, 10)?), i64::from(number(parts.next()?, 10)?));
    let second = seconds(parts.next()?)?;
    if !(1..=9999).contains(&year) || !(1..=12).contains(&month) || !(1..=31).contains(&day) || hour > 23 || minute > 59
    {
        return None;
    }
    let t_s = ((days_since_1970(year, month, day) * 24 + hour) * 60 + minute) * 60;
    Some(Timestamp { t_ns: t_s.checked_mul(1_000_000_000)?.checked_add(second.t_ns)?, ..second })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calendar_times_are_those_of_date() {
        // `date -u -d "2026-11-21 03:17:13" +%s` and so on.
        for (text, unix_s) in [
            ("(2026-11-21 03:17:13.5)", 1_795_231_033),
            ("(1970-01-01 00:00:00.5)", 0),
            ("(2000-02-29 12:00:00.5)", 951_825_600),
        ] {
            let (read, _) = time(text.as_bytes()).unwrap();
            assert_eq!(read, Some(Timestamp { t_ns: unix_s * 1_000_000_000 + 500_000_000, digits: 1 }), "{text}");
        }
    }
}
