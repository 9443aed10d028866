//! Capture formats as push readers over bytes: no files, no clock.
//!
//! A [`Reader`] takes the bytes of a capture in chunks of any size and reports one [`CaptureRecord`] for each record in them
//! (a line of text, a packet of a binary capture). No content stops it: an unreadable record is [`CaptureRecord::Broken`],
//! with its position and bytes.
//!
//! A format is one file here and one name in `formats!` below. Detection, `--input-format`, the help and the messages use that list.
//! The modules are declared by a macro, where `cargo fmt` does not look: `rustfmt protocol/src/capture/*.rs`.
//!
//! ```
//! use geu_protocol::capture::{CaptureRecord, Format};
//! let mut reader = Format::from_name("candump").unwrap().reader().unwrap();
//! let mut ids = Vec::new();
//! reader.read(b"(1795020000.500932) can0 1A0#FFFE000100050005\n", true, &mut |_position, record| {
//!     if let CaptureRecord::Frame(frame) = record {
//!         ids.push((frame.id, frame.time.unwrap().t_ns));
//!     }
//! });
//! assert_eq!(ids, [(0x1A0, 1_795_020_000_500_932_000)]);
//! ```

mod binary;
mod detect;
mod foreign;
mod socketcan;
#[cfg(test)]
mod tests;
mod text;

use std::fmt::{self, Debug, Display, Formatter};

pub use detect::{Detected, Detection, detect};
pub use foreign::{FOREIGN, Foreign};
pub use socketcan::socketcan_record;

macro_rules! formats {
    ($($module:ident),*) => {
        $(mod $module;)*
        const MODULES: &[&[Format]] = &[$($module::FORMATS),*];
    };
}

// Each module has its formats in `FORMATS`. If two formats read equally many lines of a text, detection takes the first.
formats!(candump, console, asc, trc, python_csv, blf, pcap, pcapng, serial, table);

/// A format of captures.
#[derive(Debug)]
pub struct Format {
    /// Name in `--input-format`.
    pub name: &'static str,
    /// Name in messages.
    pub title: &'static str,
    /// Usual endings of file names, for the help; detection uses the content.
    pub suffixes: &'static [&'static str],
    pub detection: Detection,
    /// Constructor of the reader; `None` for serial bytes, which [`crate::serial::Deframer`] reads.
    new_reader: Option<fn() -> Box<dyn Reader>>,
}

impl Format {
    pub fn all() -> impl DoubleEndedIterator<Item = &'static Format> {
        MODULES.iter().copied().flatten()
    }

    pub fn from_name(name: &str) -> Option<&'static Format> {
        Format::all().find(|format| format.name == name)
    }

    /// A reader for the start of a capture; `None` for serial bytes.
    pub fn reader(&self) -> Option<Box<dyn Reader>> {
        self.new_reader.map(|new_reader| new_reader())
    }

    /// Titles of the text formats or of the others, as `A, B or C`.
    pub fn titles(is_text: bool) -> String {
        let titles: Vec<&str> =
            Format::all().filter(|format| format.detection.is_text() == is_text).map(|format| format.title).collect();
        match titles.split_last() {
            Some((last, rest)) if !rest.is_empty() => format!("{} or {last}", rest.join(", ")),
            _ => titles.concat(),
        }
    }
}

/// Reader of one capture.
pub trait Reader: Debug + Send {
    /// Reads the records at the start of `bytes` and returns the number of bytes consumed. The next call must begin with the rest, at
    /// most [`MAX_RECORD`] bytes. If `is_last`, all bytes are consumed and an incomplete record is cut.
    fn read(&mut self, bytes: &[u8], is_last: bool, sink: &mut dyn FnMut(RecordPosition, CaptureRecord)) -> usize;

    /// Number of records reported.
    fn records(&self) -> u64;

    /// A reader of whole records further on, which counts the records before them as one; `None` if a record of this format
    /// depends on those before it.
    fn fork(&self) -> Option<Box<dyn Reader>> {
        None
    }

    /// Counts records that a fork has read.
    fn skip(&mut self, _records: u64) {}
}

/// A time stamp and its resolution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timestamp {
    /// Nanoseconds since the source's epoch.
    pub t_ns: i64,
    /// Decimals of the second in the source, 0…9. A word: copies of a structure with padding are slower.
    pub digits: usize,
}

impl Timestamp {
    /// The nearest microsecond, the resolution of a candump log, to a time since 1970.
    pub const fn micros(t_ns: i64) -> Timestamp {
        Timestamp { t_ns: (t_ns + 500) / 1000 * 1000, digits: 6 }
    }
}

/// Seconds with six to nine decimals.
impl Display for Timestamp {
    fn fmt(&self, out: &mut Formatter) -> fmt::Result {
        let (magnitude, digits) = (self.t_ns.unsigned_abs(), self.digits.clamp(6, 9));
        let (seconds, fraction) = (magnitude / 1_000_000_000, magnitude % 1_000_000_000);
        let (sign, fraction) = (if self.t_ns < 0 { "-" } else { "" }, fraction / 10_u64.pow(9 - digits as u32));
        write!(out, "{sign}{seconds}.{fraction:0digits$}")
    }
}

/// A classic CAN data frame of a capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Receive time, if recorded.
    pub time: Option<Timestamp>,
    /// Name of the interface or channel; empty if not recorded.
    pub interface: &'a [u8],
    /// Identifier, 11 or 29 bits.
    pub id: u32,
    /// True for an identifier of 29 bits.
    pub extended: bool,
    pub data: &'a [u8],
}

/// True for an identifier of 29 bits, or of 11 if it is not `extended`.
const fn is_identifier(id: u32, extended: bool) -> bool {
    id <= if extended { 0x1FFF_FFFF } else { 0x7FF }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CaptureRecord<'a> {
    /// A classic data frame.
    Frame(Frame<'a>),
    /// A remote frame.
    Remote,
    /// A CAN FD or CAN XL frame.
    Fd,
    /// An error frame.
    Error,
    /// No CAN frame: a comment, a blank line, a header, a packet of another link.
    Remark,
    /// A line of a table.
    Line(&'a [u8]),
    /// A note of the recorder that it lost this number of frames.
    Dropped(u64),
    /// A record that violates its format.
    Broken {
        /// First bytes, at most [`MAX_EXCERPT`].
        bytes: &'a [u8],
        /// True if the capture ends inside it, or compressed data of a binary capture is damaged.
        cut: bool,
    },
}

impl<'a> CaptureRecord<'a> {
    fn broken(bytes: &'a [u8], cut: bool) -> CaptureRecord<'a> {
        CaptureRecord::Broken { bytes: &bytes[..bytes.len().min(MAX_EXCERPT)], cut }
    }
}

/// Reported bytes of a broken record, at most.
pub const MAX_EXCERPT: usize = 256;
/// Longest record that is read, byte; a longer line is broken, a longer packet skipped.
pub const MAX_RECORD: usize = 1 << 16;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum RecordPosition {
    /// Line of a text, from 1.
    Line(u64),
    /// Offset of the record, or of its container.
    Offset(u64),
}
