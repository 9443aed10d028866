//! Capture formats as push readers over bytes: no files, no clock.
//!
//! A [`Reader`] is given the bytes of a capture in pieces of any size and tells one [`CaptureRecord`] for every record in them
//! (a line of text, a packet of a binary capture). Nothing in a capture stops it: what it cannot read is
//! [`CaptureRecord::Broken`], with its place and bytes.
//!
//! ```
//! use geu_protocol::capture::{CaptureRecord, Format, Reader};
//! let mut reader = Reader::new(Format::Candump);
//! let mut ids = Vec::new();
//! reader.finish(b"(1795020000.500932) can0 1A0#FFFE000100050005\n", &mut |_place, event| {
//!     if let CaptureRecord::Frame(frame) = event {
//!         ids.push((frame.id, frame.time.unwrap().t_ns));
//!     }
//! });
//! assert_eq!(ids, [(0x1A0, 1_795_020_000_500_932_000)]);
//! ```

mod asc;
mod candump;
mod console;
mod detect;
mod foreign;
mod packet;
mod pcap;
mod pcapng;
mod text;

pub use detect::{Detected, detect};
pub use foreign::{FOREIGN, Foreign};
pub use packet::frame_of_socketcan;

/// An instant, and how finely its source tells it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timestamp {
    /// Nanoseconds since the source's epoch.
    pub t_ns: i64,
    /// Digits behind the point of the second in the source, 0…9.
    pub digits: u8,
}

/// A classic CAN data frame as a capture tells it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Receive time, where the capture has one.
    pub time: Option<Timestamp>,
    /// Name of the interface or channel; empty where the capture has none.
    pub interface: &'a [u8],
    /// Identifier, 11 or 29 bits.
    pub id: u32,
    /// Whether the identifier has 29 bits.
    pub extended: bool,
    pub data: &'a [u8],
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
    /// What is no CAN frame: comments, blank lines, headers, packets of another link.
    Remark,
    /// The recorder says that it lost so many frames.
    Dropped(u64),
    /// A record that does not follow its format.
    Broken {
        /// Its first bytes, at most [`MAX_TOLD`].
        bytes: &'a [u8],
        /// Whether the capture ends inside it.
        cut: bool,
    },
}

/// How many bytes of a broken record are told.
pub const MAX_TOLD: usize = 256;
/// Longest record that is kept together, byte; what is longer is broken or skipped.
pub const MAX_RECORD: usize = 1 << 16;

/// The first bytes of a broken record.
fn told(bytes: &[u8]) -> &[u8] {
    &bytes[..bytes.len().min(MAX_TOLD)]
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum RecordPosition {
    /// Line of a text, from 1.
    Line(u64),
    Offset(u64),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// `candump -l` and `-L`.
    Candump,
    /// `candump` as it prints on a terminal.
    Console {
        /// Whether the times are differences to the line before (`-t d`).
        delta: bool,
    },
    Asc,
    /// pcap, with a SocketCAN or Linux cooked link.
    Pcap,
    Pcapng,
    /// Raw serial bytes; read by [`crate::serial::Deframer`].
    Serial,
}

impl Format {
    /// All, by the names users give.
    pub const NAMED: [(&'static str, Format); 7] = [
        ("candump", Format::Candump),
        ("console", Format::Console { delta: false }),
        ("console-delta", Format::Console { delta: true }),
        ("asc", Format::Asc),
        ("pcap", Format::Pcap),
        ("pcapng", Format::Pcapng),
        ("serial", Format::Serial),
    ];

    /// The name in [`Format::NAMED`].
    pub fn name(self) -> &'static str {
        Format::NAMED.iter().find(|(_, format)| *format == self).map_or("", |(name, _)| name)
    }

    pub fn named(name: &str) -> Option<Format> {
        Format::NAMED.iter().find(|(known, _)| *known == name).map(|(_, format)| *format)
    }
}

#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant)]
pub enum Reader {
    /// See [`Format::Candump`].
    Candump(candump::Candump),
    /// See [`Format::Console`].
    Console(console::Console),
    /// See [`Format::Asc`].
    Asc(asc::Asc),
    /// See [`Format::Pcap`].
    Pcap(pcap::Pcap),
    /// See [`Format::Pcapng`].
    Pcapng(pcapng::Pcapng),
}

impl Reader {
    /// A reader for the beginning of a capture.
    ///
    /// # Panics
    /// For [`Format::Serial`], whose bytes are no records.
    pub fn new(format: Format) -> Reader {
        match format {
            Format::Candump => Reader::Candump(Default::default()),
            Format::Console { delta } => Reader::Console(console::Console::new(delta)),
            Format::Asc => Reader::Asc(Default::default()),
            Format::Pcap => Reader::Pcap(Default::default()),
            Format::Pcapng => Reader::Pcapng(Default::default()),
            Format::Serial => panic!("serial bytes are read by the deframer"),
        }
    }

    /// Takes the capture on from where it stopped; returns how many bytes are consumed. The rest, at most
    /// [`MAX_RECORD`], must stand at the beginning of the next call's `bytes`.
    pub fn consume(&mut self, bytes: &[u8], sink: &mut impl FnMut(RecordPosition, CaptureRecord)) -> usize {
        self.run(bytes, false, sink)
    }

    /// Takes the last bytes: what is incomplete now is cut.
    pub fn finish(&mut self, bytes: &[u8], sink: &mut impl FnMut(RecordPosition, CaptureRecord)) {
        self.run(bytes, true, sink);
    }

    #[inline]
    fn run(&mut self, bytes: &[u8], last: bool, sink: &mut impl FnMut(RecordPosition, CaptureRecord)) -> usize {
        match self {
            Reader::Candump(reader) => reader.run(bytes, last, sink),
            Reader::Console(reader) => reader.run(bytes, last, sink),
            Reader::Asc(reader) => reader.run(bytes, last, sink),
            Reader::Pcap(reader) => reader.run(bytes, last, sink),
            Reader::Pcapng(reader) => reader.run(bytes, last, sink),
        }
    }

    /// Records told so far: as many as events.
    pub fn records(&self) -> u64 {
        match self {
            Reader::Candump(reader) => reader.lines.number(),
            Reader::Console(reader) => reader.lines.number(),
            Reader::Asc(reader) => reader.lines.number(),
            Reader::Pcap(reader) => reader.stream.records,
            Reader::Pcapng(reader) => reader.stream.records,
        }
    }
}

#[cfg(test)]
mod tests;
