//! What `candump` prints on a terminal: `  can0  1A0   [8]  FF FE 00 01 00 05 00 05`, with or without times (`-t`),
//! direction (`-x`) and characters (`-a`).

use super::candump::{identifier, remark};
use super::text::{Lines, hex_byte, number, seconds, words};
use super::{CaptureRecord, Frame, RecordPosition, Timestamp};
use crate::calendar::days_since_1970;

/// Reads `candump` console output.
#[derive(Debug, Clone, Default)]
pub struct Console {
    pub(super) lines: Lines,
    delta: bool,
    /// Sum of the differences so far.
    elapsed_ns: i64,
}

impl Console {
    pub(super) fn new(delta: bool) -> Console {
        Console { delta, ..Console::default() }
    }

    pub(super) fn run(
        &mut self,
        bytes: &[u8],
        last: bool,
        sink: &mut impl FnMut(RecordPosition, CaptureRecord),
    ) -> usize {
        let (delta, elapsed_ns) = (self.delta, &mut self.elapsed_ns);
        self.lines.run(bytes, last, sink, |line, tell| read(line, delta, elapsed_ns, tell))
    }
}

fn read(line: &[u8], delta: bool, elapsed_ns: &mut i64, tell: &mut dyn FnMut(CaptureRecord)) -> Option<()> {
    if let Some(event) = remark(line) {
        tell(event);
        return Some(());
    }
    // With -e, the explanation of an error frame stands indented on the lines behind it.
    if line.starts_with(b"\t") {
        tell(CaptureRecord::Remark);
        return Some(());
    }
    let (mut time, rest) = time(line)?;
    if let (true, Some(time)) = (delta, &mut time) {
        *elapsed_ns = elapsed_ns.checked_add(time.t_ns)?;
        time.t_ns = *elapsed_ns;
    }
    let mut words = words(rest);
    let interface = words.next()?;
    let mut word = words.next()?;
    if matches!(word, b"TX" | b"RX") {
        // -x: the direction, then one word each for the flags of the message.
        word = words.by_ref().find(|word| !matches!(word, [b'-' | b'B' | b'E' | b'P' | b'S']))?;
    }
    let (id, extended) = identifier(word)?;
    let length = words.next()?;
    let length = match length {
        [b'[', digits @ .., b']'] | [b'{', digits @ .., b'}'] => digits,
        _ => return None,
    };
    if length.len() == 2 {
        number(length, 10)?;
        tell(CaptureRecord::Fd);
        return Some(());
    }
    let length = number(length, 16)? as usize;
    let mut data = [0; 8];
    let mut rest = words;
    if extended && id & 0x2000_0000 != 0 {
        tell(CaptureRecord::Error);
        return Some(());
    }
    if rest.clone().next() == Some(b"remote") {
        tell(CaptureRecord::Remote);
        return Some(());
    }
    let length = length.min(8);
    for byte in &mut data[..length] {
        let [high, low] = rest.next()? else { return None };
        *byte = hex_byte(*high, *low)?;
    }
    // Behind the data may stand characters in quotes, nothing else.
    if rest.next().is_some_and(|word| !word.starts_with(b"'")) || id > 0x1FFF_FFFF {
        return None;
    }
    tell(CaptureRecord::Frame(Frame { time, interface, id, extended, data: &data[..length] }));
    Some(())
}

/// The time in brackets that a line may begin with, and what follows it.
pub(super) fn time(line: &[u8]) -> Option<(Option<Timestamp>, &[u8])> {
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

/// `2026-11-21 03:17:13.123456`; it names no time zone and is taken as UTC.
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
