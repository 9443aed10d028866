//! Data that waits to be sent over one byte stream, frame by frame.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use geu_protocol::serial::MAX_FRAME;
use nix::errno::Errno;

use super::interface::LinkInfo;
#[cfg(test)]
use super::interface::MAX_WAITING_REPLIES;
use super::port::Port;
use super::statistics::{LinkStatistics, Sending};
use crate::host::now_ns;
use geu_recorder::link_model::{TransmitQueue, WireData};

/// Maximum number of waiting bytes of replies: beyond, no commands are read for a while, then replies are dropped.
const REPLY_CAPACITY: usize = 512;
/// Maximum length of a response: a reply and the polled sample.
const MAX_RESPONSE: usize = 2 * MAX_FRAME;
/// Line time of one write to a paced line, ns.
const CHUNK_NS: i64 = 1_000_000;

/// Data that waits to be sent over a byte stream.
#[derive(Default)]
pub(super) struct SendBuffer {
    /// `None` without a client.
    pub port: Option<Port>,
    pub pending: Vec<u8>,
    /// Lengths of the frames in `pending`, and whether they are replies; the first may have left in part.
    frames: VecDeque<(usize, bool)>,
    /// Bytes of replies in `pending`.
    replies: usize,
    /// An incomplete frame was accepted, and whether it is of a reply: its rest precedes all other data.
    pub begun: Option<bool>,
    /// Data that waits for the end of that frame.
    waiting: Vec<Waiting>,
    /// The beginning of a sample was dropped, and therefore its rest.
    pub is_dropping: bool,
    /// Replies that wait for their time, wall clock.
    pub answers: TransmitQueue,
    /// Number of bytes written.
    pub written: u64,
    /// Time of a byte on the line, ns; 0 if the device or the network limits the rate.
    byte_ns: f64,
    /// Time at which the line has sent the written bytes.
    free_ns: i64,
    /// The client timed out: it gets the data that it accepts at once.
    pub is_stalled: bool,
    /// The client does not read its replies.
    pub drops_replies: bool,
    /// Last count of unread bytes, and the value of `written` then.
    pub unread: (u64, u64),
    /// Length of a sample without faults, and maximum number of waiting bytes of samples with the next one.
    sample_bytes: usize,
    capacity: usize,
    statistics: Arc<LinkStatistics>,
}

/// Bytes that wait for the end of a frame of the other thread.
struct Waiting {
    bytes: Vec<u8>,
    /// True for a reply, false for a cyclic sample.
    is_reply: bool,
    /// True if they end within a frame.
    more_fragments: bool,
}

/// The condition for the next write.
pub(super) enum Next {
    Bytes,
    Line(i64),
    Capacity,
    Closed,
}

impl SendBuffer {
    pub fn new(port: Option<Port>, byte_ns: f64, info: &LinkInfo) -> SendBuffer {
        let (sample_bytes, samples) = info.model.encoding.sample_bytes();
        let (capacity, statistics) = ((samples + 1) * sample_bytes, info.statistics.clone());
        SendBuffer { port, byte_ns, sample_bytes, capacity, statistics, ..SendBuffer::default() }
    }

    /// Writes the data that is due.
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
            match port.write(&self.pending[..length]) {
                Ok(written) => {
                    self.drop_front(written);
                    self.free_ns += (written as f64 * self.byte_ns) as i64;
                }
                Err(Errno::EAGAIN) => return Next::Capacity,
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

    /// Appends data, and writes the data that is due.
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

    /// True if no more waits than each limit permits.
    #[cfg(test)]
    pub fn is_bounded(&self) -> bool {
        self.pending.len() - self.replies + self.waiting(false) <= self.capacity
            && self.replies + self.waiting(true) <= REPLY_CAPACITY
            && self.answers.message_count() <= MAX_WAITING_REPLIES
    }

    /// True if a sample can be appended. A sample that a fault made longer needs the capacity of one frame;
    /// the rest of a frame needs none.
    pub fn accepts_data(&self, length: usize) -> bool {
        let data = self.pending.len() - self.replies + self.waiting(false);
        self.begun == Some(false) || data + length.min(self.sample_bytes) <= self.capacity
    }

    pub fn accepts_reply(&self) -> bool {
        self.port.is_none() || self.replies + self.waiting(true) + MAX_RESPONSE <= REPLY_CAPACITY
    }

    /// Drops bytes of a sample, and the rest of the frame with which they end.
    pub fn drop_data(&mut self, more_fragments: bool) -> Sending {
        self.is_dropping = more_fragments;
        Sending::Dropped
    }

    pub fn close(&mut self) {
        self.port = None;
        self.discard();
    }

    /// Discards waiting data, and counts the replies.
    pub fn discard(&mut self) {
        let replies = self.frames.iter().filter(|(_, is_reply)| *is_reply).count()
            + self.waiting.iter().filter(|it| it.is_reply).count()
            + self.answers.message_count();
        self.statistics.unread_replies.fetch_add(replies as u64, Relaxed);
        *self = SendBuffer {
            port: self.port.take(),
            written: self.written,
            byte_ns: self.byte_ns,
            free_ns: self.free_ns,
            is_stalled: self.is_stalled,
            unread: self.unread,
            sample_bytes: self.sample_bytes,
            capacity: self.capacity,
            statistics: self.statistics.clone(),
            ..SendBuffer::default()
        };
    }
}
