//! PEAK TRC, versions 1.0 to 1.3 and versions with a list of columns (2.0, 2.1):
//! `     1)      1059.9  Rx         01A0  8  FF FE 00 01 00 05 00 05`.
//!
//! Times are milliseconds since the start of the trace. `$STARTTIME` is that start in days since 1899-12-30, without a time zone:
//! python-can writes and reads UTC, as this reader does; PEAK's programs write local time. Version 1.0 has none, so that its times
//! count from 0. The interface is the bus number.

use super::text::{LineFormat, decimal, hex_byte, number, reader, words};
use super::{CaptureRecord, Detection, Format, Frame, is_identifier};

pub(super) const FORMATS: &[Format] = &[Format {
    name: "trc",
    title: "PEAK TRC",
    suffixes: &["trc"],
    detection: Detection::Lines,
    new_reader: Some(reader::<Trc>),
}];

/// Columns of the versions that do not list theirs, by the letters of `$COLUMNS`.
const COLUMNS: [(&[u8], &[u8]); 4] =
    [(b"1.0", b"NOILD"), (b"1.1", b"NOTILD"), (b"1.2", b"NOBTILD"), (b"1.3", b"NOBTIRLD")];
/// The format has ten columns.
const MAX_COLUMNS: usize = 16;
const DAYS_TO_1970: f64 = 25_569.0;

#[derive(Debug)]
struct Trc {
    start_ns: i64,
    /// A letter for each column.
    columns: Vec<u8>,
    data: [u8; 8],
}

impl Default for Trc {
    fn default() -> Trc {
        Trc { start_ns: 0, columns: COLUMNS[0].1.to_vec(), data: [0; 8] }
    }
}

impl LineFormat for Trc {
    fn read<'a>(&'a mut self, line: &'a [u8]) -> Option<CaptureRecord<'a>> {
        match line.trim_ascii() {
            [] => Some(CaptureRecord::Remark),
            [b';', header @ ..] => self.header(header).map(|()| CaptureRecord::Remark),
            line => self.event(line),
        }
    }
}

impl Trc {
    fn header(&mut self, line: &[u8]) -> Option<()> {
        if let Some(version) = line.strip_prefix(b"$FILEVERSION=") {
            if let Some((_, columns)) = COLUMNS.iter().find(|(known, _)| *known == version) {
                self.columns = columns.to_vec();
            }
        } else if let Some(days) = line.strip_prefix(b"$STARTTIME=") {
            // A semicolon follows it in version 1.2.
            let days: f64 = std::str::from_utf8(days).ok()?.trim_end_matches(';').parse().ok()?;
            let start_us = ((days - DAYS_TO_1970) * 86_400e6).round();
            self.start_ns = if start_us.abs() < 9e15 { start_us as i64 * 1_000 } else { return None };
        } else if let Some(columns) = line.strip_prefix(b"$COLUMNS=") {
            self.columns = columns
                .split(|&byte| byte == b',')
                .take(MAX_COLUMNS)
                .map(|name| if let [letter] = name { *letter } else { 0 })
                .collect();
        }
        Some(())
    }

    fn event<'a>(&'a mut self, line: &'a [u8]) -> Option<CaptureRecord<'a>> {
        let (mut words, mut cells) = (words(line), [b"" as &[u8]; 6]);
        for column in self.columns.iter().take_while(|column| **column != b'D') {
            let cell = words.next().unwrap_or_default();
            let letter = if *column == b'l' { b'L' } else { *column };
            if let Some(at) = b"NOTBIL".iter().position(|known| *known == letter) {
                cells[at] = cell;
            }
        }
        let [count, offset, kind, interface, id, length] = cells;
        let count = count.strip_suffix(b")").unwrap_or(count);
        if count.is_empty() || !count.iter().all(u8::is_ascii_digit) {
            return None;
        }
        let mut time = decimal(offset, 1_000_000)?;
        time.t_ns = time.t_ns.checked_add(self.start_ns)?;
        match (kind, words.clone().next()) {
            // Error frames, then changes of the hardware's state and of error counters, and the user's events.
            (b"Error" | b"ER", _) | (b"", Some(b"ERROR")) => return Some(CaptureRecord::Error),
            (b"Warng" | b"ST" | b"EC" | b"EV", _) => return Some(CaptureRecord::Remark),
            (b"", _) if id == b"FFFFFFFF" => return Some(CaptureRecord::Remark),
            _ => {}
        }
        let (value, length) = (number(id, 16)?, number(length, 10)?);
        let extended = id.len() > 4;
        if !is_identifier(value, extended) {
            return None;
        }
        match (kind, words.clone().next()) {
            (b"RR", _) | (b"" | b"Rx" | b"Tx", Some(b"RTR")) => return Some(CaptureRecord::Remote),
            (b"FD" | b"FB" | b"FE" | b"BI", _) => return Some(CaptureRecord::Fd),
            (b"" | b"Rx" | b"Tx" | b"DT", _) => {}
            _ => return None,
        }
        let data = &mut self.data[..length.min(8) as usize];
        for byte in &mut *data {
            let [high, low] = words.next()? else { return None };
            *byte = hex_byte(*high, *low)?;
        }
        if words.next().is_some() {
            // PCAN-Explorer writes messages of J1939 that several frames carry as one line.
            return (length > 8).then_some(CaptureRecord::Remark);
        }
        Some(CaptureRecord::Frame(Frame { time: Some(time), interface, id: value, extended, data }))
    }
}
