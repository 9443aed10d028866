//! Texts of any origin, compressed or not, within bounds: a document is read whole, a series row by row.
//!
//! A megabyte of gzip can hold a gigabyte of text, and a kilobyte of zstd as much again. So every bound counts bytes as they leave the
//! decompressor, and what is beyond it is never read.

use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, Cursor, Read};
use std::path::Path;

use geu_model::units::TIME_UNITS;
use geu_protocol::capture::{Foreign, Timestamp};

use crate::input::{claim, unpack};
use crate::parquet_text::open_table;

/// Bytes of a document (configuration, plan, description, result as JSON): the `run.toml` of a run with 200 000 commands. Parsed, a
/// document takes up to a hundred times its length.
pub const MAX_DOCUMENT_BYTES: usize = 16 << 20;
/// Lines of a document; a command of a `run.toml` takes five.
pub const MAX_DOCUMENT_LINES: usize = 1 << 20;
/// Bytes of one row of a series, comments and blank lines before it included.
pub const MAX_ROW_BYTES: usize = 1 << 20;
/// Rows of a series, which are kept in memory, some 64 bytes each: half a year of samples, nine hours at 1 kHz.
pub const MAX_ROWS: u64 = 1 << 25;
/// Editors and spreadsheets on Windows write it before a text.
const BYTE_ORDER_MARK: &[u8] = "\u{feff}".as_bytes();
/// Bytes from which the kind of a series is detected.
const HEAD: u64 = 4096;

/// The text of a document, which may be compressed, without its byte order mark.
///
/// # Errors
/// A file that cannot be opened or read to its end, has no byte, as after a write that failed, is longer than a document may be, or is no
/// UTF-8. Devices may be empty: /dev/null is so on purpose.
pub fn read_text(path: &Path) -> io::Result<String> {
    if fs::metadata(path).is_ok_and(|metadata| metadata.is_file() && metadata.len() == 0) {
        return Err(invalid("it is empty".to_owned()));
    }
    let mut bytes = Vec::new();
    open_bytes(path)?.take(MAX_DOCUMENT_BYTES as u64 + 1).read_to_end(&mut bytes)?;
    if bytes.len() > MAX_DOCUMENT_BYTES {
        return Err(invalid(format!(
            "expected at most {MAX_DOCUMENT_BYTES} bytes of text, got more; check that this is the file meant"
        )));
    }
    let lines = memchr::memchr_iter(b'\n', &bytes).count();
    if lines > MAX_DOCUMENT_LINES {
        return Err(invalid(format!(
            "expected at most {MAX_DOCUMENT_LINES} lines, got {lines}; check that this is the file meant"
        )));
    }
    if bytes.starts_with(BYTE_ORDER_MARK) {
        bytes.drain(..BYTE_ORDER_MARK.len());
    }
    String::from_utf8(bytes).map_err(|error| {
        let (valid, bytes) = (error.utf8_error().valid_up_to(), error.as_bytes());
        let line = memchr::memchr_iter(b'\n', &bytes[..valid]).count() + 1;
        invalid(format!("line {line}: expected UTF-8, got the byte {:02X}", bytes[valid]))
    })
}

/// Opens a series, which may be compressed or Parquet.
///
/// # Errors
/// A file that cannot be opened.
pub fn open_rows(path: &Path) -> io::Result<RowReader<Box<dyn Read>>> {
    Ok(RowReader::new(open_table(claimed(path)?)?.reader))
}

/// A number of units of time as nanoseconds; `unit_ns` is a power of ten, unless the text states a unit itself. Decimals are exact, digits
/// beyond the nanosecond are dropped.
pub(crate) fn timestamp(text: &str, unit_ns: i64) -> Option<Timestamp> {
    let (text, unit_ns) = match text.split_once(' ') {
        Some((number, unit)) => {
            (number, TIME_UNITS.iter().find(|(name, _)| *name == unit).map(|(_, s)| (s * 1e9).round() as i64)?)
        }
        None => (text, unit_ns),
    };
    let places = unit_ns.ilog10() as usize;
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    let digits = (fraction.len() + 9 - places).min(9);
    let is_decimal = fraction.bytes().all(|byte| byte.is_ascii_digit());
    let Some(whole_units) = whole.parse::<i64>().ok().filter(|_| is_decimal) else {
        let t_ns = text.parse::<f64>().ok()? * unit_ns as f64;
        return (t_ns.abs() < i64::MAX as f64).then_some(Timestamp { t_ns: t_ns.round() as i64, digits: 9 });
    };
    let part = fraction.bytes().chain(std::iter::repeat(b'0')).take(places);
    let part_ns = part.fold(0, |sum, digit| 10 * sum + i64::from(digit - b'0'));
    let part_ns = if whole.starts_with('-') { -part_ns } else { part_ns };
    Some(Timestamp { t_ns: whole_units.checked_mul(unit_ns)?.checked_add(part_ns)?, digits })
}

fn open_bytes(path: &Path) -> io::Result<Box<dyn Read>> {
    Ok(unpack(claimed(path)?)?.reader)
}

fn claimed(path: &Path) -> io::Result<File> {
    let file = File::open(path)?;
    claim(&path.display().to_string(), &file)?;
    Ok(file)
}

fn invalid(message: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, message)
}

/// The bytes of a series. Its reader reports the end of each row; a row or a series beyond the bounds is an error.
pub struct RowReader<R> {
    head: Cursor<Vec<u8>>,
    reader: R,
    bytes: usize,
    rows: u64,
}

impl<R: Read> RowReader<R> {
    pub fn new(reader: R) -> RowReader<R> {
        RowReader { head: Cursor::default(), reader, bytes: 0, rows: 0 }
    }

    /// The first lines within the first kilobytes, before anything is read.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn first_lines(&mut self) -> io::Result<Vec<String>> {
        if self.head.get_ref().is_empty() {
            self.reader.by_ref().take(HEAD).read_to_end(self.head.get_mut())?;
        }
        let head = self.head.get_ref();
        if head.starts_with(Foreign::PARQUET.signature) {
            return Err(invalid(Foreign::PARQUET.to_string()));
        }
        let head = head.strip_prefix(BYTE_ORDER_MARK).unwrap_or(head);
        Ok(String::from_utf8_lossy(head).lines().map(str::to_owned).collect())
    }

    pub fn lines(self) -> RowLines<R> {
        RowLines { reader: BufReader::new(self), number: 0, is_whole: true }
    }

    pub fn table(self, builder: &csv::ReaderBuilder) -> Table<R> {
        Table { reader: builder.from_reader(self) }
    }

    fn end_row(&mut self) {
        (self.bytes, self.rows) = (0, self.rows + 1);
    }
}

impl<R: Read> Read for RowReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let rows = self.rows;
        if self.bytes > MAX_ROW_BYTES {
            return Err(invalid(format!(
                "after row {rows}: expected a row within {MAX_ROW_BYTES} bytes, comments and blank lines before it included, got none; check that this is the file meant"
            )));
        }
        if rows > MAX_ROWS {
            return Err(invalid(format!(
                "expected at most {MAX_ROWS} rows, got more; cut the series into shorter ones"
            )));
        }
        let length = match self.head.read(buffer)? {
            0 => self.reader.read(buffer)?,
            length => length,
        };
        self.bytes += length;
        Ok(length)
    }
}

/// The lines of a series, without their ends.
pub struct RowLines<R> {
    reader: BufReader<RowReader<R>>,
    number: u64,
    is_whole: bool,
}

impl<R> RowLines<R> {
    /// Drops a last line without an end: its writer was interrupted.
    pub fn of_unfinished(self) -> RowLines<R> {
        RowLines { is_whole: false, ..self }
    }
}

impl<R: Read> Iterator for RowLines<R> {
    type Item = io::Result<String>;

    fn next(&mut self) -> Option<io::Result<String>> {
        let mut line = Vec::new();
        match self.reader.read_until(b'\n', &mut line) {
            Ok(0) => return None,
            Ok(_) if !self.is_whole && !line.ends_with(b"\n") => return None,
            Ok(_) => {}
            Err(error) => return Some(Err(error)),
        }
        self.reader.get_mut().end_row();
        self.number += 1;
        let text = line.strip_suffix(b"\n").unwrap_or(&line);
        let text = text.strip_suffix(b"\r").unwrap_or(text);
        let text = if self.number == 1 { text.strip_prefix(BYTE_ORDER_MARK).unwrap_or(text) } else { text };
        let number = self.number;
        Some(
            str::from_utf8(text)
                .map(str::to_owned)
                .map_err(|_| invalid(format!("line {number}: expected UTF-8, got other bytes"))),
        )
    }
}

/// The rows of a series as fields.
pub struct Table<R> {
    reader: csv::Reader<RowReader<R>>,
}

impl<R: Read> Table<R> {
    /// The header.
    ///
    /// # Errors
    /// The file cannot be read, or the header is too long.
    pub fn header(&mut self) -> csv::Result<csv::StringRecord> {
        let header = self.reader.headers()?.clone();
        self.reader.get_mut().end_row();
        Ok(header)
    }

    /// Reads the next row; false at the end.
    ///
    /// # Errors
    /// The file cannot be read; a row is too long or has another number of fields; too many rows.
    pub fn read(&mut self, record: &mut csv::StringRecord) -> csv::Result<bool> {
        let is_row = self.reader.read_record(record)?;
        self.reader.get_mut().end_row();
        Ok(is_row)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_document_is_read_without_its_mark_and_its_bad_byte_is_placed() {
        let directory = tempfile::tempdir().expect("a directory");
        let path = directory.path().join("text.toml");
        std::fs::write(&path, "\u{feff}seed = 1\n").expect("a file");
        assert_eq!(read_text(&path).expect("text"), "seed = 1\n");
        std::fs::write(&path, b"seed = 1\nname = \"\xFF\"\n").expect("a file");
        let message = read_text(&path).expect_err("no UTF-8").to_string();
        assert_eq!(message, "line 2: expected UTF-8, got the byte FF");
    }

    #[test]
    fn a_time_keeps_its_decimals_in_any_unit() {
        for (text, unit_ns, t_ns, digits) in [
            ("1693838903.25", 1_000_000_000, 1_693_838_903_250_000_000, 2),
            ("-0.5", 1_000_000_000, -500_000_000, 1),
            ("1693838903123.4567", 1_000_000, 1_693_838_903_123_456_700, 7),
            ("1693838903123456789.9", 1, 1_693_838_903_123_456_789, 9),
            ("1.5e3", 1_000_000, 1_500_000_000, 9),
            (".5", 1_000, 500, 9),
        ] {
            assert_eq!(timestamp(text, unit_ns), Some(Timestamp { t_ns, digits }), "{text}");
        }
        for text in ["", "x", "nan", "inf", "-", "1.5x", "9223372036.9", "1e300", "99999999999999999999"] {
            assert_eq!(timestamp(text, 1_000_000_000), None, "{text}");
        }
    }

    #[test]
    fn first_lines_are_read_again() {
        let text = format!("\u{feff}t_s\r\n{}", "1\n".repeat(5000));
        let mut rows = RowReader::new(text.as_bytes());
        assert_eq!(rows.first_lines().expect("lines")[0], "t_s");
        let lines: Vec<String> = rows.lines().collect::<io::Result<_>>().expect("lines");
        assert_eq!((lines.len(), lines[0].as_str(), lines[5000].as_str()), (5001, "t_s", "1"));
    }

    #[test]
    fn a_row_that_does_not_end_and_rows_without_end_are_errors() {
        let long = "x".repeat(MAX_ROW_BYTES + (1 << 17));
        let text = format!("a\nb\n{long}");
        let error = RowReader::new(text.as_bytes()).lines().find_map(Result::err).expect("too long").to_string();
        assert!(error.starts_with("after row 2: expected a row within"), "{error}");
        // Rows, each within its bound, are more than a row's bound together.
        let rows = "0,0\n".repeat(MAX_ROW_BYTES);
        assert_eq!(RowReader::new(rows.as_bytes()).lines().filter_map(Result::ok).count(), MAX_ROW_BYTES);
        let mut endless = RowReader::new(io::repeat(b'\n'));
        endless.rows = MAX_ROWS;
        let error = endless.lines().find_map(Result::err).expect("too many").to_string();
        assert!(error.contains("rows, got more"), "{error}");
    }
}
