//! The frames of a layout in serial bytes.

use std::sync::Arc;

use super::{Frame, FrameSet};
use crate::deframer::{Candidate, Framing};
use crate::serial::SerialDefect;

/// Finds the frames of a layout.
#[derive(Debug, Clone)]
pub struct SerialFrames {
    frames: Arc<FrameSet>,
    /// Constant at the start of each frame.
    starts: Vec<Vec<u8>>,
    /// First byte of every frame, if all have one and the same.
    first: Option<u8>,
    /// Length of the longest frame, byte.
    max_length: usize,
}

impl SerialFrames {
    pub fn new(frames: Arc<FrameSet>) -> SerialFrames {
        let starts: Vec<Vec<u8>> = frames.frames.iter().map(|frame| frame.start().to_vec()).collect();
        let mut firsts = starts.iter().map(|start| start.first().copied());
        let first = firsts.next().flatten().filter(|first| firsts.all(|other| other == Some(*first)));
        let max_length = frames.frames.iter().map(Frame::length).max().unwrap_or_default();
        SerialFrames { frames, starts, first, max_length }
    }

    /// True if a frame may begin with these bytes.
    fn may_begin(&self, bytes: &[u8]) -> bool {
        self.starts.iter().any(|start| begins(start, bytes))
    }
}

/// True if the bytes begin with this constant, as far as they go.
#[inline]
fn begins(start: &[u8], bytes: &[u8]) -> bool {
    start.iter().zip(bytes).all(|(own, byte)| own == byte)
}

impl Framing for SerialFrames {
    /// Number of the frame.
    type Frame = usize;

    fn max_length(&self) -> usize {
        self.max_length
    }

    #[inline]
    fn next(&self, bytes: &[u8]) -> usize {
        if self.may_begin(bytes) {
            return 0;
        }
        match self.first {
            Some(first) => memchr::memchr(first, &bytes[1..]).map_or(bytes.len(), |next| next + 1),
            None => (1..bytes.len()).find(|&at| self.may_begin(&bytes[at..])).unwrap_or(bytes.len()),
        }
    }

    /// The first frame listed that fits, whatever the bytes arrive with.
    #[inline]
    fn candidate<'a>(&self, bytes: &'a [u8], is_last: bool) -> Candidate<'a, usize> {
        let (mut length, mut defect) = (0, SerialDefect::UnknownType);
        let begun = |(kind, _): &(usize, &Frame)| begins(&self.starts[*kind], bytes);
        for (kind, frame) in self.frames.frames.iter().enumerate().filter(begun) {
            length = length.max(frame.length());
            match bytes.get(..frame.length()) {
                None if !is_last => return Candidate::Incomplete { length },
                None => defect = SerialDefect::Cut,
                Some(payload) if !frame.has_constants(payload) => {}
                Some(payload) if frame.checks_hold(payload) => {
                    return Candidate::Frame { kind, length: payload.len(), payload };
                }
                Some(_) => defect = SerialDefect::CrcMismatch,
            }
        }
        Candidate::Rejected { defect, length }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deframer::{FrameEvent, FrameStream};
    use crate::layout::{BitField, Check, Field, Number};
    use proptest::prelude::*;

    fn frames() -> Arc<FrameSet> {
        let number = |at, name| BitField::bytes(at, Number::from_name(name).unwrap());
        let mut data = Frame::new("DATA", 5);
        data.set_constant(0, &[0xA5]);
        data.fields.push(Field::new(0, number(1, "i16be")));
        data.checks.push(Check::new("CRC-16/XMODEM", number(3, "u16be"), 0..3).unwrap());
        let mut slow = Frame::new("SLOW", 4);
        slow.set_constant(0, &[0xA5, 0x5A]);
        slow.fields.push(Field::new(1, number(2, "u8")));
        slow.checks.push(Check::new("sum", number(3, "u8"), 0..3).unwrap());
        Arc::new(FrameSet { frames: vec![data, slow], values: Vec::new(), sequence: (1, 1) })
    }

    /// Places and numbers of frames, and number of skipped bytes.
    fn found(chunks: &[&[u8]]) -> (Vec<(u64, usize)>, u64) {
        let (mut frames_found, mut skipped) = (Vec::new(), 0);
        let mut sink = |event: FrameEvent<usize>| match event {
            FrameEvent::Frame { at, kind, .. } => frames_found.push((at, kind)),
            FrameEvent::Skipped { length, .. } => skipped += length,
            FrameEvent::Rejected { .. } => {}
        };
        let mut stream = FrameStream::new(SerialFrames::new(frames()));
        chunks.iter().for_each(|chunk| stream.push(chunk, &mut sink));
        stream.finish(false, &mut sink);
        (frames_found, skipped)
    }

    #[test]
    fn frames_of_several_lengths_are_distinguished_by_their_checks() {
        let frames = frames();
        let mut bytes = vec![0xA5, 0x5A];
        frames.frames[1].write(&[0.0, 9.0], &mut bytes);
        frames.frames[0].write(&[23130.0, 0.0], &mut bytes);
        assert_eq!(bytes[6..8], [0xA5, 0x5A]);
        assert_eq!(found(&[&bytes]), (vec![(2, 1), (6, 0)], 2));
    }

    proptest! {
        #[test]
        fn any_chunks_give_the_same_frames_and_every_byte_is_accounted_for(
            parts in proptest::collection::vec(prop_oneof![
                proptest::collection::vec(prop_oneof![Just(0xA5u8), Just(0x5A), any::<u8>()], 0..12).prop_map(|bytes| (None, bytes)),
                (0usize..2, prop_oneof![-300i16..300, 0x5A00i16..0x5AFF]).prop_map(|(kind, value)| {
                    let mut bytes = Vec::new();
                    frames().frames[kind].write(&[value.into(), value.into()], &mut bytes);
                    (Some(kind), bytes)
                }),
            ], 0..20),
            length in 1usize..9,
        ) {
            let bytes: Vec<u8> = parts.iter().flat_map(|(_, bytes)| bytes.iter().copied()).collect();
            let (whole, skipped) = found(&[&bytes]);
            prop_assert_eq!(&(whole.clone(), skipped), &found(&bytes.chunks(length).collect::<Vec<_>>()));
            let framed: usize = whole.iter().map(|(_, kind)| 5 - kind).sum();
            prop_assert_eq!(framed as u64 + skipped, bytes.len() as u64);
        }
    }
}
