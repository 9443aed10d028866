//! Binary formats: records of known length from chunks of any size.

use std::fmt::Debug;

use super::{CaptureRecord, MAX_EXCERPT, MAX_RECORD, Reader, RecordPosition};

/// A length beyond this is wrong.
pub const MAX_LENGTH: u32 = 1 << 26;

/// A binary format.
pub trait BinaryFormat: Debug + Default + Send + 'static {
    /// Finds the end of the record at the start of `bytes`.
    fn next(&mut self, bytes: &[u8]) -> Next;

    /// Reads a record.
    fn read<'a>(&'a mut self, record: &'a [u8]) -> CaptureRecord<'a>;
}

pub enum Next {
    /// The header of the record is incomplete.
    Incomplete,
    /// Bytes of a file header, which is no record.
    Header(usize),
    /// Length of the record.
    Record(u64),
    /// No record; the rest of the capture is unreadable.
    Lost,
}

/// Reader of a binary format.
#[derive(Debug, Default)]
pub struct BinaryReader<F> {
    format: F,
    /// Offset of the first byte not consumed.
    offset: u64,
    records: u64,
    /// Bytes still to come of a record longer than [`MAX_RECORD`].
    skip: u64,
    is_lost: bool,
}

/// Constructor of the reader of a binary format.
pub fn reader<F: BinaryFormat>() -> Box<dyn Reader> {
    Box::new(BinaryReader::<F>::default())
}

impl<F: BinaryFormat> Reader for BinaryReader<F> {
    fn read(&mut self, bytes: &[u8], is_last: bool, sink: &mut dyn FnMut(RecordPosition, CaptureRecord)) -> usize {
        let mut at = 0;
        loop {
            let rest = &bytes[at..];
            let position = RecordPosition::Offset(self.offset);
            if rest.is_empty() && (self.skip == 0 || !is_last) {
                return at;
            }
            let length = if self.is_lost {
                rest.len() as u64
            } else if self.skip > 0 {
                if rest.is_empty() {
                    self.skip = 0;
                    self.records += 1;
                    sink(position, CaptureRecord::broken(&[], true));
                    return at;
                }
                self.skip
            } else {
                match self.format.next(rest) {
                    Next::Header(length) => length as u64,
                    Next::Record(length) if length > MAX_RECORD as u64 => {
                        self.records += 1;
                        sink(position, CaptureRecord::Remark);
                        length
                    }
                    Next::Record(length) if length <= rest.len() as u64 => {
                        self.records += 1;
                        sink(position, self.format.read(&rest[..length as usize]));
                        length
                    }
                    // Whatever the bytes arrive with, the same of them are reported.
                    Next::Lost if rest.len() < MAX_EXCERPT && !is_last => return at,
                    Next::Lost => {
                        self.records += 1;
                        self.is_lost = true;
                        sink(position, CaptureRecord::broken(rest, false));
                        continue;
                    }
                    Next::Incomplete | Next::Record(_) if is_last => {
                        self.records += 1;
                        sink(position, CaptureRecord::broken(rest, true));
                        rest.len() as u64
                    }
                    Next::Incomplete | Next::Record(_) => return at,
                }
            };
            let used = length.min(rest.len() as u64);
            self.skip = length - used;
            self.offset += used;
            at += used as usize;
        }
    }

    fn records(&self) -> u64 {
        self.records
    }
}

/// Byte order of the machine that wrote a capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Order {
    #[default]
    Little,
    Big,
}

impl Order {
    /// The two bytes at `at`, 0 beyond the end.
    pub fn u16(self, bytes: &[u8], at: usize) -> u16 {
        let bytes = bytes.get(at..).and_then(|rest| rest.first_chunk()).copied().unwrap_or_default();
        if self == Order::Big { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) }
    }

    /// The four bytes at `at`, 0 beyond the end.
    pub fn u32(self, bytes: &[u8], at: usize) -> u32 {
        let bytes = bytes.get(at..).and_then(|rest| rest.first_chunk()).copied().unwrap_or_default();
        if self == Order::Big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
    }

    pub fn other(self) -> Order {
        if self == Order::Big { Order::Little } else { Order::Big }
    }
}
