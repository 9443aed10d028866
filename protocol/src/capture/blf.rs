//! Vector BLF: a header, then objects. An object that is a container holds further objects, compressed by zlib or not; an object
//! may continue in the next container.
//!
//! Times are offsets from the start in the file's header, a date and time without a zone: python-can writes and reads UTC, as this
//! reader does; Vector's programs write local time. A file without it counts from 0. The interface is the channel number. Behind a
//! damaged container the next one is read. The memory is bounded whatever lengths a file claims.

use std::io::Write;

use flate2::{Decompress, FlushDecompress, Status};
use memchr::memmem;

use super::binary::Order;
use super::{CaptureRecord, Detection, Format, Frame, MAX_RECORD, Reader, RecordPosition, Timestamp, is_identifier};
use crate::calendar::days_since_1970;

pub(super) const FORMATS: &[Format] = &[Format {
    name: "blf",
    title: "Vector BLF",
    suffixes: &["blf"],
    detection: Detection::Signature(|head| head.starts_with(SIGNATURE)),
    new_reader: Some(|| Box::new(Blf::default())),
}];

type Sink<'a> = dyn FnMut(RecordPosition, CaptureRecord) + 'a;

const SIGNATURE: &[u8] = b"LOGG";
/// Signature, length, and up to here the numbers and dates that are read.
const HEADER: usize = 56;
const OBJECT_SIGNATURE: &[u8] = b"LOBJ";
/// Signature, length of the header, its version, length of the object, type.
const OBJECT_HEADER: usize = 16;
/// Largest number of bytes between two objects.
const MAX_PADDING: usize = 4;
/// Number of bytes that show the absence of an object: this number is reported, in any chunks.
const LOST_EXCERPT: usize = MAX_PADDING + OBJECT_SIGNATURE.len();

const CONTAINER: u32 = 10;
/// Header of the object, compression, length of the content.
const CONTAINER_HEADER: usize = 32;
const STORED: u16 = 0;
const ZLIB: u16 = 2;
/// Bytes that are decompressed at once.
const CHUNK: usize = 1 << 16;

const MESSAGE: u32 = 1;
const ERROR: u32 = 2;
const ERROR_EXTENDED: u32 = 73;
const MESSAGE_2: u32 = 86;
const FD_MESSAGE: u32 = 100;
const FD_MESSAGE_64: u32 = 101;
const FD_ERROR_64: u32 = 104;

const EXTENDED: u32 = 0x8000_0000;
/// In the flags of a message and of [`FD_MESSAGE`].
const REMOTE: u8 = 0x80;
/// In the object's flags: times in units of 10 µs, else nanoseconds.
const TEN_MICROSECONDS: u32 = 1;

#[derive(Debug)]
struct Blf {
    /// Offset of the first byte not consumed.
    offset: u64,
    is_begun: bool,
    /// True behind bytes that are no object, until one is found.
    is_lost: bool,
    /// The present object.
    content: Option<Content>,
    zlib: Decompress,
    objects: Objects,
}

/// Content of a container, or an object outside of containers.
#[derive(Debug)]
struct Content {
    encoding: Encoding,
    /// Bytes of the file still to come.
    left: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Stored,
    Zlib,
    /// Bytes behind the end of the compressed data: padding.
    Ended,
    /// Bytes of damaged data.
    Ignored,
}

/// Objects in decompressed bytes.
#[derive(Debug, Default)]
struct Objects {
    start_ns: i64,
    /// Offset of the container.
    position: u64,
    bytes: Vec<u8>,
    /// Bytes still to come of an object longer than [`MAX_RECORD`].
    skip: usize,
    is_lost: bool,
    records: u64,
    channel: Vec<u8>,
}

enum Next {
    /// More bytes are needed.
    Incomplete,
    Object {
        /// Number of bytes before it.
        padding: usize,
        length: usize,
    },
    /// Number of bytes to the next signature.
    Lost(usize),
}

impl Default for Blf {
    fn default() -> Blf {
        let (zlib, objects) = (Decompress::new(true), Objects::default());
        Blf { offset: 0, is_begun: false, is_lost: false, content: None, zlib, objects }
    }
}

impl Reader for Blf {
    fn read(&mut self, bytes: &[u8], is_last: bool, sink: &mut dyn FnMut(RecordPosition, CaptureRecord)) -> usize {
        let mut at = 0;
        while at < bytes.len()
            && let Some(used) = self.step(&bytes[at..], sink)
        {
            (at, self.offset) = (at + used, self.offset + used as u64);
        }
        if !is_last {
            return at;
        }
        let objects = &mut self.objects;
        let is_cut = !objects.is_lost && (objects.skip > 0 || !is_padding(&objects.bytes));
        if self.content.is_none() && !is_padding(&bytes[at..]) {
            self.lost(&bytes[at..], sink);
        } else if is_cut || self.content.as_ref().is_some_and(|content| content.encoding != Encoding::Ignored) {
            objects.abandon(sink);
        }
        bytes.len()
    }

    fn records(&self) -> u64 {
        self.objects.records
    }
}

impl Blf {
    /// Reads from the start of `bytes` and returns the number of bytes consumed; `None` if more are needed.
    fn step(&mut self, bytes: &[u8], sink: &mut Sink) -> Option<usize> {
        if self.content.is_some() {
            return Some(self.content(bytes, sink));
        }
        if !self.is_begun {
            return self.header(bytes);
        }
        let (padding, length) = match next_object(bytes) {
            Next::Object { padding, length } => (padding, length),
            Next::Incomplete => return None,
            Next::Lost(to) => {
                self.lost(bytes, sink);
                return Some(to);
            }
        };
        let object = &bytes[padding..];
        let mut content = Content { encoding: Encoding::Stored, left: length as u64 };
        let mut header = 0;
        if Order::Little.u32(object, 12) == CONTAINER {
            if length < CONTAINER_HEADER {
                self.lost(object, sink);
                return Some(padding + OBJECT_SIGNATURE.len());
            }
            if object.len() < CONTAINER_HEADER {
                return None;
            }
            header = CONTAINER_HEADER;
            content.left -= header as u64;
            content.encoding = match Order::Little.u16(object, OBJECT_HEADER) {
                STORED => Encoding::Stored,
                ZLIB => Encoding::Zlib,
                _ => Encoding::Ignored,
            };
        }
        self.is_lost = false;
        self.objects.position = self.offset + padding as u64;
        if content.encoding == Encoding::Ignored {
            self.objects.abandon(sink);
        }
        self.zlib.reset(true);
        self.content = Some(content).filter(|content| content.left > 0);
        Some(padding + header)
    }

    /// Reads the header of the file. Without one, objects are searched.
    fn header(&mut self, bytes: &[u8]) -> Option<usize> {
        let length = Order::Little.u32(bytes.get(..8)?, 4) as usize;
        if bytes.starts_with(SIGNATURE) && (HEADER..=MAX_RECORD).contains(&length) {
            self.objects.start_ns = start_ns(bytes.get(..length)?).unwrap_or(0);
            self.is_begun = true;
            return Some(length);
        }
        self.is_begun = true;
        Some(0)
    }

    /// Reads content and returns the number of bytes consumed.
    fn content(&mut self, bytes: &[u8], sink: &mut Sink) -> usize {
        let Some(Content { mut encoding, left }) = self.content else { return 0 };
        let used = left.min(bytes.len().min(CHUNK) as u64);
        let (bytes, left) = (&bytes[..used as usize], left - used);
        match encoding {
            Encoding::Stored => {
                self.objects.bytes.extend_from_slice(bytes);
                self.objects.read(sink);
            }
            Encoding::Zlib => {
                let (after, unread) = self.inflate(bytes, sink);
                encoding = after;
                if left == 0 && encoding == Encoding::Zlib {
                    self.objects.abandon(sink);
                }
                // A length that is damaged would reach over the containers behind the compressed data.
                if encoding == Encoding::Ended && left + unread as u64 > MAX_PADDING as u64 {
                    self.objects.abandon(sink);
                    self.content = None;
                    return bytes.len() - unread;
                }
            }
            Encoding::Ignored | Encoding::Ended => {}
        }
        self.content = (left > 0).then_some(Content { encoding, left });
        bytes.len()
    }

    /// Decompresses and reads `bytes`; returns the encoding of the bytes behind them, and the number of bytes behind the compressed data.
    fn inflate(&mut self, mut bytes: &[u8], sink: &mut Sink) -> (Encoding, usize) {
        loop {
            let (read, written) = (self.zlib.total_in(), self.zlib.total_out());
            self.objects.bytes.reserve(CHUNK);
            let status = self.zlib.decompress_vec(bytes, &mut self.objects.bytes, FlushDecompress::None);
            bytes = &bytes[(self.zlib.total_in() - read) as usize..];
            self.objects.read(sink);
            match status {
                Ok(Status::StreamEnd) => return (Encoding::Ended, bytes.len()),
                Ok(_) if self.zlib.total_in() == read && self.zlib.total_out() == written => {
                    return (Encoding::Zlib, 0);
                }
                Ok(_) => {}
                Err(_) => {
                    self.objects.abandon(sink);
                    return (Encoding::Ignored, 0);
                }
            }
        }
    }

    /// Reports bytes of the file that are no object, once.
    fn lost(&mut self, bytes: &[u8], sink: &mut Sink) {
        if !self.is_lost {
            self.is_lost = true;
            self.objects.position = self.offset;
            self.objects.damaged(&bytes[..bytes.len().min(LOST_EXCERPT)], sink);
        }
    }
}

impl Objects {
    /// Reads the complete objects.
    fn read(&mut self, sink: &mut Sink) {
        let (position, mut at) = (RecordPosition::Offset(self.position), 0);
        loop {
            let skipped = self.skip.min(self.bytes.len() - at);
            (at, self.skip) = (at + skipped, self.skip - skipped);
            let rest = &self.bytes[at..];
            match next_object(rest) {
                Next::Object { padding, length } if length > MAX_RECORD => {
                    (self.is_lost, self.skip) = (false, padding + length);
                    self.records += 1;
                    sink(position, CaptureRecord::Remark);
                }
                Next::Object { padding, length } if padding + length <= rest.len() => {
                    let object = &rest[padding..padding + length];
                    let record = record(object, self.start_ns, &mut self.channel);
                    sink(position, record.unwrap_or(CaptureRecord::broken(object, false)));
                    (self.is_lost, self.records, at) = (false, self.records + 1, at + padding + length);
                }
                Next::Lost(to) => {
                    if !self.is_lost {
                        self.is_lost = true;
                        self.records += 1;
                        sink(position, CaptureRecord::broken(&rest[..rest.len().min(LOST_EXCERPT)], true));
                    }
                    at += to;
                }
                Next::Object { .. } | Next::Incomplete => break,
            }
        }
        self.bytes.drain(..at);
    }

    /// Reports damaged data.
    fn damaged(&mut self, bytes: &[u8], sink: &mut Sink) {
        self.records += 1;
        sink(RecordPosition::Offset(self.position), CaptureRecord::broken(bytes, true));
    }

    /// Reports a damaged container; the next one may begin inside an object.
    fn abandon(&mut self, sink: &mut Sink) {
        let bytes = std::mem::take(&mut self.bytes);
        // Bytes behind which an object was searched are reported already.
        let start = padding(&bytes).unwrap_or(if self.is_lost { bytes.len() } else { 0 });
        self.damaged(&bytes[start..], sink);
        (self.skip, self.is_lost) = (0, true);
    }
}

/// Number of bytes before the object at the start of `bytes`; `None` if there is none.
fn padding(bytes: &[u8]) -> Option<usize> {
    (0..=MAX_PADDING).find(|at| bytes.get(*at..).is_some_and(|rest| rest.starts_with(OBJECT_SIGNATURE)))
}

fn next_object(bytes: &[u8]) -> Next {
    match padding(bytes) {
        Some(padding) if bytes.len() < padding + OBJECT_HEADER => Next::Incomplete,
        Some(padding) => match Order::Little.u32(bytes, padding + 8) as usize {
            length @ OBJECT_HEADER.. => Next::Object { padding, length },
            _ => Next::Lost(padding + OBJECT_SIGNATURE.len()),
        },
        None if bytes.len() < LOST_EXCERPT => Next::Incomplete,
        None => {
            let next = memmem::find(bytes, OBJECT_SIGNATURE);
            Next::Lost(next.unwrap_or(bytes.len() - OBJECT_SIGNATURE.len() + 1))
        }
    }
}

fn is_padding(bytes: &[u8]) -> bool {
    bytes.len() < LOST_EXCERPT && bytes.iter().all(|&byte| byte == 0)
}

/// Reads an object; `None` if it is shorter than its type requires, or its identifier longer than its flag.
fn record<'a>(object: &'a [u8], start_ns: i64, channel: &'a mut Vec<u8>) -> Option<CaptureRecord<'a>> {
    let order = Order::Little;
    let body = match order.u16(object, 6) {
        1 => object.get(32..)?,
        2 => object.get(40..)?,
        _ => return Some(CaptureRecord::Remark),
    };
    let (number, length, is_remote, is_fd, data) = match order.u32(object, 12) {
        MESSAGE | MESSAGE_2 => {
            (order.u16(body, 0), (*body.get(3)?).min(8), body[2] & REMOTE != 0, false, body.get(8..)?)
        }
        FD_MESSAGE => (order.u16(body, 0), *body.get(14)?, body[2] & REMOTE != 0, body[13] & 1 != 0, body.get(20..)?),
        FD_MESSAGE_64 => {
            let flags = order.u32(body, 12);
            (u16::from(*body.first()?), *body.get(2)?, flags & 0x10 != 0, flags & 0x1000 != 0, body.get(40..)?)
        }
        ERROR | ERROR_EXTENDED | FD_ERROR_64 => return Some(CaptureRecord::Error),
        _ => return Some(CaptureRecord::Remark),
    };
    if is_fd || length > 8 {
        return Some(CaptureRecord::Fd);
    }
    if is_remote {
        return Some(CaptureRecord::Remote);
    }
    let (unit_ns, digits) = if order.u32(object, 16) == TEN_MICROSECONDS { (10_000, 5) } else { (1, 9) };
    let ticks = i64::from_le_bytes(*object.get(24..)?.first_chunk()?);
    let t_ns = ticks.checked_mul(unit_ns)?.checked_add(start_ns)?;
    channel.clear();
    write!(channel, "{number}").ok()?;
    let id = order.u32(body, 4);
    let (extended, id) = (id & EXTENDED != 0, id & 0x1FFF_FFFF);
    let data = data.get(..length.into()).filter(|_| is_identifier(id, extended))?;
    Some(CaptureRecord::Frame(Frame { time: Some(Timestamp { t_ns, digits }), interface: channel, id, extended, data }))
}

/// Start of the measurement, ns since 1970: year, month, day of the week, day, hour, minute, second, millisecond; `None` if there is none.
fn start_ns(header: &[u8]) -> Option<i64> {
    let [year, month, _, day, hour, minute, second, millisecond] =
        [0, 1, 2, 3, 4, 5, 6, 7].map(|index| i64::from(Order::Little.u16(header, 40 + 2 * index)));
    if !((1..=12).contains(&month)
        && (1..=31).contains(&day)
        && hour < 24
        && minute < 60
        && second < 60
        && millisecond < 1000)
    {
        return None;
    }
    let seconds = days_since_1970(year, month, day) * 86_400 + hour * 3_600 + minute * 60 + second;
    (seconds * 1_000 + millisecond).checked_mul(1_000_000)
}
