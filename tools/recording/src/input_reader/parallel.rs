//! Captures of text with independent lines: parts are cut at line ends and read by several threads, their records
//! decoded in order.

use std::io::{self, ErrorKind, Read};

use geu_protocol::capture::{MAX_RECORD, Reader};

use super::records::Records;
use super::{Capture, Decode, Stop};
use crate::pool::{Ordered, pool};
use crate::row::Sink;

/// Bytes of a part, which stay in the cache of a core.
const PART: usize = 1 << 18;

/// End of a parallel reading.
#[derive(Default)]
pub struct Ending {
    /// Bytes read.
    pub length: u64,
    pub error: Option<io::Error>,
}

struct Part {
    bytes: Vec<u8>,
    /// Number of bytes in use.
    length: usize,
    records: Records,
}

impl Default for Part {
    fn default() -> Part {
        Part { bytes: vec![0; PART], length: 0, records: Records::default() }
    }
}

/// Reads as far as lines can be read in parallel: to the end of the input, to a line that is longer than a record, to a stop, or
/// not at all. Before and after it, `buffer` has `filled` bytes that are not read.
pub fn read<D: Decode>(
    source: &mut impl Read,
    (buffer, filled): (&mut [u8], &mut usize),
    capture: &mut Capture,
    decoder: &mut D,
    sink: &mut impl Sink<D::Row>,
    stop: Stop,
) -> Ending {
    let mut ending = Ending::default();
    if *filled > MAX_RECORD || capture.reader.fork().is_none() {
        return ending;
    }
    let Some(pool) = pool() else { return ending };
    let (mut pending, mut spare, mut part) = (Ordered::new(pool), Vec::new(), Part::default());
    part.append(&buffer[..*filled]);
    loop {
        let is_end = part.fill(source, &mut ending);
        let cut = memchr::memrchr(b'\n', &part.bytes[..part.length]).map_or(0, |at| at + 1);
        let mut next: Part = spare.pop().unwrap_or_default();
        next.append(&part.bytes[cut..part.length]);
        if let Some(reader) = capture.reader.fork().filter(|_| cut > 0) {
            part.length = cut;
            pending.start(move || part.parsed(reader));
        }
        part = next;
        let is_last = is_end || cut == 0 || stop.is_due() || sink.is_closed();
        while (is_last || pending.is_full())
            && let Some(mut parsed) = pending.wait()
        {
            let Capture { reader, seen, .. } = &mut *capture;
            let first = reader.records() + 1;
            reader.skip(parsed.records.count());
            parsed.records.replay(first, |place, event| seen.event(place, &event, decoder, sink));
            parsed.length = 0;
            spare.push(parsed);
        }
        if is_last {
            break;
        }
    }
    buffer[..part.length].copy_from_slice(&part.bytes[..part.length]);
    *filled = part.length;
    ending
}

impl Part {
    fn append(&mut self, bytes: &[u8]) {
        self.bytes[self.length..self.length + bytes.len()].copy_from_slice(bytes);
        self.length += bytes.len();
    }

    /// Fills the part; true at the end of the source.
    fn fill(&mut self, source: &mut impl Read, ending: &mut Ending) -> bool {
        while self.length < self.bytes.len() {
            match source.read(&mut self.bytes[self.length..]) {
                Ok(0) => return true,
                Ok(length) => (self.length, ending.length) = (self.length + length, ending.length + length as u64),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => {
                    ending.error = Some(error);
                    return true;
                }
            }
        }
        false
    }

    fn parsed(mut self, mut reader: Box<dyn Reader>) -> Part {
        self.records.clear();
        reader.read(&self.bytes[..self.length], false, &mut |_, record| self.records.push(&record));
        self
    }
}
