//! Serial frames: `EB 90 | type | length | payload | CRC`, and a deframer that finds them in any bytes.
//!
//! There is no byte stuffing: a receiver hunts for the sync, checks type, length and CRC, and on failure resumes one
//! byte after the sync it tried, so no good frame behind noise is lost.

use crate::command::{COMMAND_LENGTHS, COMMAND_SERIAL, REPLY_LENGTHS, REPLY_SERIAL};
use crate::crc::crc16;
use crate::field::Sample;
use crate::message::{Data, Message, MessageId};
use crate::named;

/// First two bytes of every frame.
pub const SYNC: [u8; 2] = [0xEB, 0x90];
/// Offset of the type in a frame.
pub const TYPE_AT: usize = SYNC.len();
/// Offset of the length in a frame.
pub const LENGTH_AT: usize = TYPE_AT + 1;
/// Bytes before the payload: sync, type, length.
pub const HEADER: usize = LENGTH_AT + 1;
/// Bytes of the CRC behind the payload.
pub const CRC: usize = 2;
/// Bytes around the payload of every frame.
pub const OVERHEAD: usize = HEADER + CRC;
pub const DATA_LENGTH: usize = Data::SPEC.length();
/// Longest frame, byte.
pub const MAX_FRAME: usize = OVERHEAD + DATA_LENGTH;
/// Default rate of a serial link, 8N1.
pub const DEFAULT_BAUD: u32 = 115_200;
/// Bits on the line for each byte at 8N1.
pub const BITS_PER_BYTE: u32 = 10;

/// Content of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameType {
    Data,
    Command,
    Reply,
}

impl FrameType {
    pub const fn code(self) -> u8 {
        let id = match self {
            FrameType::Data => Data::SPEC.id,
            FrameType::Command => COMMAND_SERIAL,
            FrameType::Reply => REPLY_SERIAL,
        };
        match id {
            MessageId::Serial(code) => code,
            MessageId::Can(_) => panic!("not a serial message"),
        }
    }

    #[inline]
    fn from_code(code: u8) -> Option<FrameType> {
        [FrameType::Data, FrameType::Command, FrameType::Reply].into_iter().find(|kind| kind.code() == code)
    }

    #[inline]
    fn accepts(self, length: usize) -> bool {
        match self {
            FrameType::Data => length == DATA_LENGTH,
            FrameType::Command => COMMAND_LENGTHS.contains(&length),
            FrameType::Reply => REPLY_LENGTHS.contains(&length),
        }
    }
}

/// A frame around `payload`.
pub fn frame(kind: FrameType, payload: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(OVERHEAD + payload.len());
    bytes.extend_from_slice(&SYNC);
    bytes.extend_from_slice(&[kind.code(), payload.len() as u8]);
    bytes.extend_from_slice(payload);
    bytes.extend_from_slice(&[0; CRC]);
    update_crc(&mut bytes);
    bytes
}

/// Writes the CRC of a whole frame; leaves fewer bytes than a frame unchanged.
pub fn update_crc(bytes: &mut [u8]) {
    let Some(end) = bytes.len().checked_sub(CRC).filter(|&end| end >= HEADER) else { return };
    let crc = crc16(&bytes[SYNC.len()..end]);
    bytes[end..].copy_from_slice(&crc.to_be_bytes());
}

/// The DATA frame of one sample.
pub fn data_frame(sample: &Sample) -> [u8; MAX_FRAME] {
    let mut bytes = [0; MAX_FRAME];
    bytes[..TYPE_AT].copy_from_slice(&SYNC);
    bytes[TYPE_AT..HEADER].copy_from_slice(&[FrameType::Data.code(), DATA_LENGTH as u8]);
    Data::write(sample, &mut bytes[HEADER..]);
    update_crc(&mut bytes);
    bytes
}

/// The sample in the payload of a DATA frame.
#[inline]
pub fn read_data(payload: &[u8]) -> Sample {
    let mut sample = Sample::default();
    Data::read(payload, &mut sample);
    sample
}

named! {
    /// Reason why bytes after a sync are no frame.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
    pub enum SerialDefect {
        /// Type byte that is not DATA, COMMAND or REPLY.
        UnknownType = "unknown-type",
        /// Length that the type does not have.
        WrongLength = "wrong-length",
        /// CRC that does not match.
        CrcMismatch = "crc-mismatch",
        /// The bytes end inside the frame.
        Cut = "cut",
    }
}

impl SerialDefect {
    /// Number of bytes from a sync on that show this defect.
    fn length(self, bytes: &[u8]) -> usize {
        match self {
            SerialDefect::UnknownType => 3,
            SerialDefect::WrongLength => HEADER,
            SerialDefect::CrcMismatch => OVERHEAD + usize::from(bytes[LENGTH_AT]),
            SerialDefect::Cut => MAX_FRAME,
        }
    }
}

/// Result of the deframer. Frames and skipped runs together are all bytes, each once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeframerEvent<'a> {
    /// A frame with a correct CRC.
    Frame {
        /// Offset of its sync in the stream.
        at: u64,
        kind: FrameType,
        payload: &'a [u8],
    },
    /// A sync that no frame followed; its bytes are in a skipped run.
    Rejected {
        /// Offset of the sync in the stream.
        at: u64,
        defect: SerialDefect,
        /// The bytes tried, from the sync on, at most as long as the longest frame.
        bytes: &'a [u8],
    },
    /// A run of bytes outside of frames, reported at its end.
    Skipped {
        /// Offset of the first in the stream.
        at: u64,
        length: u64,
        /// The first of them, at most [`MAX_SKIPPED_EXCERPT`].
        first: &'a [u8],
    },
}

/// Bytes reported of a skipped run.
pub const MAX_SKIPPED_EXCERPT: usize = 16;

/// A run of bytes outside of frames.
#[derive(Debug, Clone, Copy)]
struct Run {
    at: u64,
    first: [u8; MAX_SKIPPED_EXCERPT],
    kept: u8,
}

impl Run {
    fn extend(&mut self, bytes: &[u8]) {
        let kept = usize::from(self.kept);
        let more = bytes.len().min(MAX_SKIPPED_EXCERPT - kept);
        self.first[kept..kept + more].copy_from_slice(&bytes[..more]);
        self.kept += more as u8;
    }
}

/// Finds frames in a stream that arrives in chunks.
#[derive(Debug, Clone, Default)]
pub struct Deframer {
    /// Offset in the stream of the first byte not yet consumed.
    offset: u64,
    /// The run of skipped bytes that reaches up to `offset`.
    skipping: Option<Run>,
}

enum Candidate {
    Frame(FrameType, usize),
    Rejected(SerialDefect),
    Incomplete,
}

#[inline]
fn candidate(bytes: &[u8]) -> Candidate {
    let (Some(&code), Some(&length)) = (bytes.get(TYPE_AT), bytes.get(LENGTH_AT)) else {
        return match bytes.get(TYPE_AT) {
            Some(&code) if FrameType::from_code(code).is_none() => Candidate::Rejected(SerialDefect::UnknownType),
            _ => Candidate::Incomplete,
        };
    };
    let length = usize::from(length);
    let Some(kind) = FrameType::from_code(code) else {
        return Candidate::Rejected(SerialDefect::UnknownType);
    };
    if !kind.accepts(length) {
        return Candidate::Rejected(SerialDefect::WrongLength);
    }
    let Some(bytes) = bytes.get(..OVERHEAD + length) else {
        return Candidate::Incomplete;
    };
    let (covered, crc) = bytes[SYNC.len()..].split_at(bytes.len() - SYNC.len() - CRC);
    if crc16(covered).to_be_bytes() == crc {
        Candidate::Frame(kind, OVERHEAD + length)
    } else {
        Candidate::Rejected(SerialDefect::CrcMismatch)
    }
}

impl Deframer {
    /// Offset in the stream of the first byte not yet consumed.
    pub fn offset(&self) -> u64 {
        self.offset
    }

    /// Reads the next bytes of the stream and returns the number of bytes consumed. The next call must begin with the rest,
    /// which is shorter than a frame.
    #[inline]
    pub fn consume(&mut self, bytes: &[u8], sink: &mut impl FnMut(DeframerEvent)) -> usize {
        self.run(bytes, false, sink)
    }

    /// Reads the last bytes; an incomplete frame is cut.
    pub fn finish(&mut self, bytes: &[u8], sink: &mut impl FnMut(DeframerEvent)) {
        self.run(bytes, true, sink);
        self.end_skipping(sink);
    }

    #[inline]
    fn run(&mut self, bytes: &[u8], last: bool, sink: &mut impl FnMut(DeframerEvent)) -> usize {
        let (start, mut at) = (self.offset, 0);
        while at < bytes.len() {
            let rest = &bytes[at..];
            if rest[0] != SYNC[0] || rest.get(1).is_some_and(|&second| second != SYNC[1]) {
                let skipped = memchr::memchr(SYNC[0], &rest[1..]).map_or(rest.len(), |next| next + 1);
                self.skip(start + at as u64, &rest[..skipped]);
                at += skipped;
                continue;
            }
            let defect = match candidate(rest) {
                Candidate::Frame(kind, length) => {
                    self.offset = start + at as u64;
                    self.end_skipping(sink);
                    sink(DeframerEvent::Frame { at: self.offset, kind, payload: &rest[HEADER..length - CRC] });
                    at += length;
                    continue;
                }
                Candidate::Incomplete if !last => break,
                Candidate::Incomplete => SerialDefect::Cut,
                Candidate::Rejected(defect) => defect,
            };
            if rest.len() > 1 {
                let bytes = &rest[..rest.len().min(defect.length(rest))];
                sink(DeframerEvent::Rejected { at: start + at as u64, defect, bytes });
            }
            self.skip(start + at as u64, &rest[..1]);
            at += 1;
        }
        self.offset = start + at as u64;
        at
    }

    fn skip(&mut self, at: u64, bytes: &[u8]) {
        self.skipping.get_or_insert(Run { at, first: [0; MAX_SKIPPED_EXCERPT], kept: 0 }).extend(bytes);
    }

    fn end_skipping(&mut self, sink: &mut impl FnMut(DeframerEvent)) {
        if let Some(run) = self.skipping.take() {
            let first = &run.first[..usize::from(run.kept)];
            sink(DeframerEvent::Skipped { at: run.at, length: self.offset - run.at, first });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Frames, defects and number of skipped bytes.
    type Seen = (Vec<(u64, FrameType, Vec<u8>)>, Vec<SerialDefect>, u64);

    fn deframe(chunks: &[&[u8]]) -> Seen {
        let (mut frames, mut defects, mut skipped) = (Vec::new(), Vec::new(), 0);
        let mut sink = |found: DeframerEvent| match found {
            DeframerEvent::Frame { at, kind, payload } => frames.push((at, kind, payload.to_vec())),
            DeframerEvent::Rejected { defect, .. } => defects.push(defect),
            DeframerEvent::Skipped { length, .. } => skipped += length,
        };
        let (mut deframer, mut buffer) = (Deframer::default(), Vec::new());
        for chunk in chunks {
            buffer.extend_from_slice(chunk);
            let used = deframer.consume(&buffer, &mut sink);
            buffer.drain(..used);
            assert!(buffer.len() < MAX_FRAME);
        }
        deframer.finish(&buffer, &mut sink);
        (frames, defects, skipped)
    }

    #[test]
    fn a_good_frame_behind_a_false_sync_is_not_lost() {
        let good = frame(FrameType::Command, &[1]);
        for noise in
            [&[0xEB][..], &[0xEB, 0x90], &[0xEB, 0x90, 0x01], &[0xEB, 0x90, 0x10, 8], &[0xEB, 0x90, 1, 22, 0xEB]]
        {
            let bytes = [noise, &good].concat();
            let (frames, _, skipped) = deframe(&[&bytes]);
            assert_eq!(frames, [(noise.len() as u64, FrameType::Command, vec![1])], "{noise:02X?}");
            assert_eq!(skipped, noise.len() as u64);
        }
    }

    #[test]
    fn a_cut_frame_at_the_end_is_reported_and_counted() {
        let bytes = data_frame(&Sample::default());
        let (frames, defects, skipped) = deframe(&[&bytes[..27]]);
        assert_eq!((frames.len(), defects, skipped), (0, vec![SerialDefect::Cut], 27));
    }

    proptest! {
        #[test]
        fn any_chunks_give_the_same_frames_and_every_byte_is_accounted_for(
            parts in proptest::collection::vec(prop_oneof![
                proptest::collection::vec(prop_oneof![Just(0xEBu8), Just(0x90), Just(1), Just(22), any::<u8>()], 0..40),
                proptest::collection::vec(any::<u8>(), 1..=8).prop_map(|payload| frame(FrameType::Command, &payload)),
                any::<[i16; 4]>().prop_map(|increments| data_frame(&Sample { increments, ..Sample::default() }).to_vec()),
            ], 0..20),
            length in 1usize..50,
        ) {
            let bytes = parts.concat();
            let whole = deframe(&[&bytes]);
            let chunks: Vec<&[u8]> = bytes.chunks(length).collect();
            prop_assert_eq!(&whole, &deframe(&chunks));
            let framed: usize = whole.0.iter().map(|(_, _, payload)| OVERHEAD + payload.len()).sum();
            prop_assert_eq!(framed as u64 + whole.2, bytes.len() as u64);
        }
    }
}
