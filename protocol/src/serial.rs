//! Serial frames: `EB 90 | type | length | payload | CRC`, which a [`Deframer`] finds in any bytes.

use crate::command::{COMMAND_LENGTHS, COMMAND_SERIAL, REPLY_LENGTHS, REPLY_SERIAL};
use crate::crc::crc16;
pub use crate::deframer::MAX_SKIPPED_EXCERPT;
use crate::deframer::{Candidate, FrameEvent, FrameFinder, Framing};
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

/// Finds the frames of the interface control document.
pub type Deframer = FrameFinder<UnitFrames>;
/// Result of the deframer.
pub type DeframerEvent<'a> = FrameEvent<'a, FrameType>;

/// Frames of the interface control document.
#[derive(Debug, Clone, Copy, Default)]
pub struct UnitFrames;

impl Framing for UnitFrames {
    type Frame = FrameType;

    fn max_length(&self) -> usize {
        MAX_FRAME
    }

    #[inline]
    fn next(&self, bytes: &[u8]) -> usize {
        match bytes {
            [first, second, ..] if [*first, *second] == SYNC => 0,
            [first] if *first == SYNC[0] => 0,
            _ => memchr::memchr(SYNC[0], &bytes[1..]).map_or(bytes.len(), |next| next + 1),
        }
    }

    #[inline]
    fn candidate<'a>(&self, bytes: &'a [u8], _is_last: bool) -> Candidate<'a, FrameType> {
        let reject = |defect: SerialDefect| Candidate::Rejected { defect, length: defect.length(bytes) };
        let (Some(&code), Some(&length)) = (bytes.get(TYPE_AT), bytes.get(LENGTH_AT)) else {
            return match bytes.get(TYPE_AT) {
                Some(&code) if FrameType::from_code(code).is_none() => reject(SerialDefect::UnknownType),
                _ => Candidate::Incomplete { length: MAX_FRAME },
            };
        };
        let length = usize::from(length);
        let Some(kind) = FrameType::from_code(code) else {
            return reject(SerialDefect::UnknownType);
        };
        if !kind.accepts(length) {
            return reject(SerialDefect::WrongLength);
        }
        let Some(bytes) = bytes.get(..OVERHEAD + length) else {
            return Candidate::Incomplete { length: MAX_FRAME };
        };
        let (covered, crc) = bytes[SYNC.len()..].split_at(bytes.len() - SYNC.len() - CRC);
        if crc16(covered).to_be_bytes() == crc {
            Candidate::Frame { kind, length: bytes.len(), payload: &bytes[HEADER..HEADER + length] }
        } else {
            reject(SerialDefect::CrcMismatch)
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
