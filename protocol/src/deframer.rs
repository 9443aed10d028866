//! Finds frames in any bytes.
//!
//! There is no byte stuffing: a receiver hunts for the start of a frame, checks it, and on failure resumes one byte after the start it
//! tried, so no good frame behind noise is lost.

use crate::serial::SerialDefect;

/// The frames of a link.
pub trait Framing {
    /// Meaning of a frame.
    type Frame: Copy;

    /// Length of the longest frame, byte.
    fn max_length(&self) -> usize;

    /// Number of bytes before the next place at which a frame may begin; `bytes` is not empty.
    fn next(&self, bytes: &[u8]) -> usize;

    /// The frame at the start of `bytes`, where one may begin; no more bytes follow the `last`.
    fn candidate<'a>(&self, bytes: &'a [u8], is_last: bool) -> Candidate<'a, Self::Frame>;
}

/// Bytes at a place where a frame may begin.
pub enum Candidate<'a, K> {
    Frame {
        kind: K,
        length: usize,
        payload: &'a [u8],
    },
    /// No frame; `length` bytes show that.
    Rejected {
        defect: SerialDefect,
        length: usize,
    },
    /// More bytes decide, up to `length` in all.
    Incomplete {
        length: usize,
    },
}

/// Result of a finder. Frames and skipped runs together are all bytes, each once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameEvent<'a, K> {
    /// A frame with a correct check value.
    Frame {
        /// Offset of its start in the stream.
        at: u64,
        kind: K,
        payload: &'a [u8],
    },
    /// A start that no frame followed; its bytes are in a skipped run.
    Rejected {
        /// Offset of the start in the stream.
        at: u64,
        defect: SerialDefect,
        /// The bytes tried, from the start on, at most as long as the longest frame.
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
pub struct FrameFinder<F> {
    framing: F,
    /// Offset in the stream of the first byte not yet consumed.
    offset: u64,
    /// The run of skipped bytes that reaches up to `offset`.
    skipping: Option<Run>,
}

impl<F: Framing> FrameFinder<F> {
    /// A finder at the start of a stream.
    pub fn new(framing: F) -> FrameFinder<F> {
        FrameFinder { framing, offset: 0, skipping: None }
    }

    /// Offset in the stream of the first byte not yet consumed.
    pub fn offset(&self) -> u64 {
        self.offset
    }

    /// Reads the next bytes of the stream and returns the number of bytes consumed. The next call must begin with the rest,
    /// which is shorter than a frame.
    #[inline]
    pub fn consume(&mut self, bytes: &[u8], sink: &mut impl FnMut(FrameEvent<F::Frame>)) -> usize {
        self.run(bytes, false, sink)
    }

    /// Reads the last bytes; an incomplete frame is cut.
    pub fn finish(&mut self, bytes: &[u8], sink: &mut impl FnMut(FrameEvent<F::Frame>)) {
        self.run(bytes, true, sink);
        self.end_skipping(sink);
    }

    #[inline]
    fn run(&mut self, bytes: &[u8], last: bool, sink: &mut impl FnMut(FrameEvent<F::Frame>)) -> usize {
        let (start, mut at) = (self.offset, 0);
        while at < bytes.len() {
            let rest = &bytes[at..];
            let skipped = self.framing.next(rest);
            if skipped > 0 {
                self.skip(start + at as u64, &rest[..skipped]);
                at += skipped;
                continue;
            }
            let (defect, length) = match self.framing.candidate(rest, last) {
                Candidate::Frame { kind, length, payload } => {
                    self.offset = start + at as u64;
                    self.end_skipping(sink);
                    sink(FrameEvent::Frame { at: self.offset, kind, payload });
                    at += length;
                    continue;
                }
                Candidate::Incomplete { .. } if !last => break,
                Candidate::Incomplete { length } => (SerialDefect::Cut, length),
                Candidate::Rejected { defect, length } => (defect, length),
            };
            if rest.len() > 1 {
                let bytes = &rest[..rest.len().min(length)];
                sink(FrameEvent::Rejected { at: start + at as u64, defect, bytes });
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

    fn end_skipping(&mut self, sink: &mut impl FnMut(FrameEvent<F::Frame>)) {
        if let Some(run) = self.skipping.take() {
            let first = &run.first[..usize::from(run.kept)];
            sink(FrameEvent::Skipped { at: run.at, length: self.offset - run.at, first });
        }
    }
}

/// A finder that keeps the bytes of an incomplete frame.
#[derive(Debug, Clone, Default)]
pub struct FrameStream<F> {
    finder: FrameFinder<F>,
    /// Bytes not consumed, shorter than a frame.
    carry: Vec<u8>,
}

impl<F: Framing> FrameStream<F> {
    /// The start of a stream.
    pub fn new(framing: F) -> FrameStream<F> {
        FrameStream { finder: FrameFinder::new(framing), carry: Vec::new() }
    }

    /// Number of bytes pushed.
    pub fn offset(&self) -> u64 {
        self.finder.offset() + self.carry.len() as u64
    }

    /// Reads the next bytes.
    pub fn push(&mut self, bytes: &[u8], sink: &mut impl FnMut(FrameEvent<F::Frame>)) {
        let FrameStream { finder, carry } = self;
        // The carried bytes are completed with as many as settle them, so that only these are copied.
        let carried = carry.len();
        let mut rest = bytes;
        if carried > 0 {
            let joined = bytes.len().min(2 * finder.framing.max_length());
            carry.extend_from_slice(&bytes[..joined]);
            let used = finder.consume(carry, sink);
            if used < carried || joined == bytes.len() {
                carry.drain(..used);
                return;
            }
            carry.clear();
            rest = &bytes[used - carried..];
        }
        let used = finder.consume(rest, sink);
        carry.extend_from_slice(&rest[used..]);
    }

    /// Ends the stream; returns the number of bytes of an incomplete frame if `is_stopped`, else reports it as cut.
    pub fn finish(&mut self, is_stopped: bool, sink: &mut impl FnMut(FrameEvent<F::Frame>)) -> usize {
        let unfinished = if is_stopped { std::mem::take(&mut self.carry).len() } else { 0 };
        self.finder.finish(&std::mem::take(&mut self.carry), sink);
        unfinished
    }
}
