//! What waits to be sent over one byte stream, frame by frame.

use std::collections::VecDeque;
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use geu_protocol::serial::MAX_FRAME;
use nix::errno::Errno;
use nix::unistd;

use super::statistics::{LinkStatistics, Sending};
use crate::cadence::now_ns;
use crate::link_model::{TransmitQueue, WireData};

/// Bytes of samples that may wait when another is offered: less than two.
const DATA_ROOM: usize = 2 * MAX_FRAME;
/// Bytes of replies that may wait: beyond, no more commands are read for a while, then replies are dropped.
const REPLY_ROOM: usize = 512;
/// The longest answer: a reply, and the sample that was polled.
const LONGEST_ANSWER: usize = 2 * MAX_FRAME;
/// A paced line takes so much of its time in one write, ns.
const CHUNK_NS: i64 = 1_000_000;

/// A descriptor that both threads write to.
pub(super) type Port = Arc<OwnedFd>;

/// What waits to be sent over a byte stream.
pub(super) struct SendBuffer {
    /// Nothing while nobody is there.
    pub port: Option<Port>,
    pub pending: Vec<u8>,
    /// Lengths of the frames in `pending`, and whether they are replies; the first may have left in part.
    frames: VecDeque<(usize, bool)>,
    /// Bytes of replies in `pending`.
    replies: usize,
    /// A frame that was taken goes on, and whether it is of an answer: nothing is taken before its rest.
    pub begun: Option<bool>,
    /// What waits for the end of that frame.
    waiting: Vec<Waiting>,
    /// The beginning of a sample interval was dropped, so its rest is too.
    pub is_dropping: bool,
    /// Answers whose time has not come, by the wall clock.
    pub answers: TransmitQueue,
    /// Bytes written so far.
    pub written: u64,
    /// Time of a byte on the line, ns; 0 where the device or the network paces.
    byte_ns: f64,
    /// When the line is through with what was written.
    free_ns: i64,
    /// Patience with this client has run out: it gets what it has room for, and is not waited for again.
    pub is_stalled: bool,
    /// The client does not read its replies.
    pub drops_replies: bool,
    statistics: Arc<LinkStatistics>,
}

/// Bytes that wait for the end of a frame of the other thread.
struct Waiting {
    bytes: Vec<u8>,
    /// Whether they are of an answer, not of a sample that is sent by itself.
    is_reply: bool,
    /// Whether they end within a frame.
    more_fragments: bool,
}

/// What the pump has to wait for.
pub(super) enum Next {
    Bytes,
    Line(i64),
    Room,
    Closed,
}

impl SendBuffer {
    pub fn new(port: Option<Port>, byte_ns: f64, statistics: Arc<LinkStatistics>) -> SendBuffer {
        SendBuffer {
            port,
            pending: Vec::new(),
            frames: VecDeque::new(),
            replies: 0,
            written: 0,
            byte_ns,
            free_ns: 0,
            is_stalled: false,
            drops_replies: false,
            begun: None,
            waiting: Vec::new(),
            is_dropping: false,
            answers: TransmitQueue::default(),
            statistics,
        }
    }

    /// Writes what is due.
    pub fn write(&mut self) -> Next {
        while let Some(port) = &self.port {
            if self.pending.is_empty() {
                return Next::Bytes;
            }
            let mut length = self.pending.len();
            if self.byte_ns > 0.0 {
                let ahead_ns = now_ns() + CHUNK_NS - self.free_ns;
                let chunk = ((CHUNK_NS as f64 / self.byte_ns) as usize).clamp(1, length);
                length = ((ahead_ns as f64 / self.byte_ns).max(0.0) as usize).min(length);
                if length < chunk {
                    return Next::Line(self.free_ns);
                }
            }
            match unistd::write(port, &self.pending[..length]) {
                Ok(written) => {
                    self.drop_front(written);
                    self.free_ns += (written as f64 * self.byte_ns) as i64;
                }
                Err(Errno::EAGAIN) => return Next::Room,
                Err(Errno::EINTR) => {}
                Err(_) => self.close(),
            }
        }
        Next::Closed
    }

    fn drop_front(&mut self, length: usize) {
        self.pending.drain(..length);
        self.written += length as u64;
        let mut left = length;
        while let Some((frame, is_reply)) = self.frames.front_mut()
            && left > 0
        {
            let part = left.min(*frame);
            (left, *frame) = (left - part, *frame - part);
            self.replies -= if *is_reply { part } else { 0 };
            if *frame == 0 {
                self.frames.pop_front();
            }
        }
    }

    /// Adds data behind what waits, and writes what is due.
    pub fn push(&mut self, data: &[WireData], is_reply: bool, more_fragments: bool) -> Next {
        if self.begun.is_some_and(|begun| begun != is_reply) {
            let bytes = data.iter().flat_map(WireData::bytes).copied().collect();
            self.waiting.push(Waiting { bytes, is_reply, more_fragments });
            return self.write();
        }
        self.append(data.iter().map(WireData::bytes), is_reply, more_fragments);
        while let Some(place) = self.waiting.iter().position(|it| self.begun.is_none_or(|begun| begun == it.is_reply)) {
            let Waiting { bytes, is_reply, more_fragments } = self.waiting.remove(place);
            self.append(std::iter::once(&bytes[..]), is_reply, more_fragments);
        }
        self.write()
    }

    fn append<'a>(&mut self, data: impl Iterator<Item = &'a [u8]>, is_reply: bool, more_fragments: bool) {
        if self.pending.is_empty() {
            self.free_ns = self.free_ns.max(now_ns());
        }
        let before = self.pending.len();
        data.for_each(|bytes| self.pending.extend_from_slice(bytes));
        let length = self.pending.len() - before;
        self.frames.push_back((length, is_reply));
        self.replies += if is_reply { length } else { 0 };
        self.begun = more_fragments.then_some(is_reply);
    }

    /// Bytes that wait for the end of a frame of the other thread.
    fn waiting(&self, is_reply: bool) -> usize {
        self.waiting.iter().filter(|it| it.is_reply == is_reply).map(|it| it.bytes.len()).sum()
    }

    /// What is longer than a frame, because a fault made it so, has room where a frame has; the rest of a frame always.
    pub fn has_data_room(&self, length: usize) -> bool {
        let data = self.pending.len() - self.replies + self.waiting(false);
        self.begun == Some(false) || data + length.min(MAX_FRAME) <= DATA_ROOM
    }

    pub fn has_reply_room(&self) -> bool {
        self.port.is_none() || self.replies + self.waiting(true) + LONGEST_ANSWER <= REPLY_ROOM
    }

    /// Drops bytes of a sample; the rest of the frame with which they end must not come alone.
    pub fn drop_data(&mut self, more_fragments: bool) -> Sending {
        self.is_dropping = more_fragments;
        Sending::Dropped
    }

    pub fn close(&mut self) {
        self.port = None;
        self.discard();
    }

    /// Forgets what waits, and counts the replies.
    pub fn discard(&mut self) {
        let replies = self.frames.iter().filter(|(_, is_reply)| *is_reply).count()
            + self.waiting.iter().filter(|it| it.is_reply).count()
            + self.answers.len();
        self.statistics.unread_replies.fetch_add(replies as u64, Relaxed);
        self.pending.clear();
        self.frames.clear();
        self.replies = 0;
        self.begun = None;
        self.waiting.clear();
        self.is_dropping = false;
        self.drops_replies = false;
        self.answers = TransmitQueue::default();
    }
}
