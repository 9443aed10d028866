//! The sending side of one byte stream: whole frames or nothing, never blocking, paced where there is no real line.
//!
//! Two threads write: the one that keeps time sends data, the runtime sends answers and finishes what did not fit.
//! Bytes leave in the order in which frames were taken; where a fault has a frame come in parts, what comes from the other
//! thread waits for its end. So no frame is ever cut by another.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::io;
use std::os::fd::OwnedFd;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread;
use std::time::{Duration, Instant};

use geu_protocol::serial::MAX_FRAME;
use nix::errno::Errno;
use nix::unistd;
use tokio::io::unix::AsyncFd;
use tokio::sync::Notify;
use tokio::time::timeout;

use super::interface::{LATE_ANSWERS, Watched, until_due};
use super::statistics::{LinkStatistics, Sending};
use crate::cadence::now_ns;
use crate::link_model::{Transmission, TransmitQueue, WireData};
use crate::patience::Patience;

/// Bytes of half seconds that may wait when another is offered: less than two.
const DATA_ROOM: usize = 2 * MAX_FRAME;
/// Bytes of replies that may wait: beyond, no more commands are read for [`UNREAD`], then replies are dropped.
const REPLY_ROOM: usize = 512;
/// A client that takes no byte for so long, while replies have no room, does not read: further replies are dropped until it
/// does. Ten times what the interface control document gives a reply.
const UNREAD: Duration = Duration::from_millis(200);
/// The longest answer: a reply, and the half second that was polled.
const LONGEST_ANSWER: usize = 2 * MAX_FRAME;
/// A paced line takes so much of its time in one write, ns.
const CHUNK_NS: i64 = 1_000_000;
/// Between two looks for room.
const LOOK_AGAIN: Duration = Duration::from_micros(100);

/// A descriptor that both threads write to.
pub(super) type Port = Arc<OwnedFd>;

/// The sending side of a byte stream.
pub(super) struct StreamSender {
    state: Mutex<State>,
    /// Bytes wait for the pump, or the port was closed.
    wake: Notify,
    /// Answers have left, or the port was closed.
    left: Notify,
    /// Answers wait for their time.
    later: Notify,
    statistics: Arc<LinkStatistics>,
}

struct State {
    /// Nothing while nobody is there.
    port: Option<Port>,
    pending: Vec<u8>,
    /// Lengths of the frames in `pending`, and whether they are replies; the first may have left in part.
    frames: VecDeque<(usize, bool)>,
    /// Bytes of replies in `pending`.
    replies: usize,
    /// A frame that was taken goes on, and whether it is of an answer: nothing is taken before its rest.
    begun: Option<bool>,
    /// What waits for the end of that frame.
    waiting: Vec<Waiting>,
    /// The beginning of a half second was dropped, so its rest is too.
    is_dropping: bool,
    /// Answers whose time has not come, by the wall clock.
    answers: TransmitQueue,
    /// Bytes written so far.
    written: u64,
    /// Time of a byte on the line, ns; 0 where the device or the network paces.
    byte_ns: f64,
    /// When the line is through with what was written.
    free_ns: i64,
    /// Patience with this client has run out: it gets what it has room for, and is not waited for again.
    is_stalled: bool,
    /// The client does not read its replies.
    drops_replies: bool,
    statistics: Arc<LinkStatistics>,
}

/// Bytes that wait for the end of a frame of the other thread.
struct Waiting {
    bytes: Vec<u8>,
    /// Whether they are of an answer, not of a half second that is sent by itself.
    is_reply: bool,
    /// Whether they end within a frame.
    more_fragments: bool,
}

/// What the pump has to wait for.
enum Next {
    Bytes,
    Line(i64),
    Room,
    Closed,
}

impl State {
    /// Writes what is due.
    fn write(&mut self) -> Next {
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
    fn push(&mut self, data: &[WireData], is_reply: bool, more_fragments: bool) -> Next {
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
    fn has_data_room(&self, length: usize) -> bool {
        let data = self.pending.len() - self.replies + self.waiting(false);
        self.begun == Some(false) || data + length.min(MAX_FRAME) <= DATA_ROOM
    }

    fn has_reply_room(&self) -> bool {
        self.port.is_none() || self.replies + self.waiting(true) + LONGEST_ANSWER <= REPLY_ROOM
    }

    /// Drops bytes of a half second; the rest of the frame with which they end must not come alone.
    fn drop_data(&mut self, more_fragments: bool) -> Sending {
        self.is_dropping = more_fragments;
        Sending::Dropped
    }

    fn close(&mut self) {
        self.port = None;
        self.discard();
    }

    /// Forgets what waits, and counts the replies.
    fn discard(&mut self) {
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

impl StreamSender {
    pub fn new(port: Option<Port>, byte_ns: f64, statistics: Arc<LinkStatistics>) -> StreamSender {
        let state = State {
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
            statistics: statistics.clone(),
        };
        StreamSender {
            state: Mutex::new(state),
            wake: Notify::new(),
            left: Notify::new(),
            later: Notify::new(),
            statistics,
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().expect("nothing panics while it writes")
    }

    /// Somebody is there.
    pub fn open(&self, port: Port) {
        let mut state = self.lock();
        state.close();
        (state.port, state.is_stalled) = (Some(port), false);
    }

    /// Nobody is there any more; what waits is history.
    pub fn close(&self) {
        self.lock().close();
        self.wake.notify_one();
        self.left.notify_one();
    }

    pub fn is_open(&self) -> bool {
        self.lock().port.is_some()
    }

    /// Whether nothing waits.
    pub fn is_drained(&self) -> bool {
        self.lock().pending.is_empty()
    }

    /// Whether a frame of the half second that was sent last goes on, or was dropped and its rest is too.
    pub fn is_within_frame(&self) -> bool {
        let state = self.lock();
        state.is_dropping || state.begun == Some(false)
    }

    /// Drops bytes of a half second that have no room elsewhere.
    pub fn drop_data(&self, more_fragments: bool) -> Sending {
        self.lock().drop_data(more_fragments)
    }

    /// Sends a half second, whole or not at all.
    pub fn send(&self, data: &[WireData], more_fragments: bool, patience: &Patience) -> Sending {
        let length = data.iter().map(|data| data.bytes().len()).sum();
        let asked = Instant::now();
        loop {
            let mut state = self.lock();
            if !state.has_data_room(length) {
                state.write();
            }
            if state.port.is_none() {
                return Sending::Unread;
            }
            if state.is_dropping {
                return state.drop_data(more_fragments);
            }
            if state.has_data_room(length) {
                let next = state.push(data, false, more_fragments);
                self.tell_room(state);
                return match next {
                    Next::Closed => {
                        self.wake.notify_one();
                        Sending::Dropped
                    }
                    Next::Bytes => Sending::Sent,
                    _ => {
                        self.wake.notify_one();
                        Sending::Sent
                    }
                };
            }
            if state.is_stalled || patience.is_over(asked) {
                state.is_stalled = !patience.is_none();
                return state.drop_data(more_fragments);
            }
            drop(state);
            thread::sleep(LOOK_AGAIN);
        }
    }

    /// Tells who waits for room, if there is some.
    fn tell_room(&self, state: MutexGuard<State>) {
        let has_room = state.has_reply_room();
        drop(state);
        if has_room {
            self.left.notify_one();
        }
    }

    /// Waits until there is room for an answer, but only as long as the client reads; there always is where nobody is there.
    pub async fn reply_room(&self) {
        loop {
            let written = {
                let mut state = self.lock();
                state.drops_replies &= !state.has_reply_room();
                if state.drops_replies || state.has_reply_room() {
                    return;
                }
                state.written
            };
            let is_over = timeout(UNREAD, self.left.notified()).await.is_err();
            let mut state = self.lock();
            state.drops_replies = is_over && state.written == written;
        }
    }

    /// Takes the answer to a command in, each transmission so long, on the wall clock, after now, or drops it where there is no
    /// room; [`StreamSender::reply_room`] comes first.
    pub fn answer(&self, transmissions: Vec<Transmission>) {
        let mut state = self.lock();
        if state.port.is_none() || transmissions.is_empty() {
            return;
        }
        if state.drops_replies || state.answers.len() >= LATE_ANSWERS {
            self.statistics.unread_replies.fetch_add(1, Relaxed);
            return;
        }
        state.answers.put(transmissions, 0, now_ns());
        drop(state);
        self.statistics.replies.fetch_add(1, Relaxed);
        if self.send_answers(now_ns()).is_some() {
            self.later.notify_one();
        }
    }

    /// Sends the answers that are due until then, behind what waits; when the next is due.
    pub fn send_answers(&self, until_ns: i64) -> Option<i64> {
        let mut state = self.lock();
        while let Some((_, contents)) = state.answers.take(until_ns) {
            let more_fragments = state.answers.is_within_frame();
            state.push(&contents, true, more_fragments);
        }
        let next_ns = state.answers.next_ns();
        self.tell_room(state);
        self.wake.notify_one();
        next_ns
    }

    /// Sends answers at their time.
    async fn answer_later(&self) -> Infallible {
        loop {
            until_due(&self.later, self.send_answers(now_ns())).await;
        }
    }

    /// Bytes written so far.
    pub fn written(&self) -> u64 {
        self.lock().written
    }

    fn write(&self) -> Next {
        let mut state = self.lock();
        let next = state.write();
        self.tell_room(state);
        next
    }

    /// Writes whatever waits as the line and the reader permit, and answers at their time, until the port is closed.
    pub async fn pump(&self, port: &AsyncFd<Watched<Port>>) -> io::Result<()> {
        tokio::select! {
            end = self.write_on(port) => end,
            never = self.answer_later() => match never {},
        }
    }

    async fn write_on(&self, port: &AsyncFd<Watched<Port>>) -> io::Result<()> {
        loop {
            let next = self.write();
            match next {
                Next::Bytes => self.wake.notified().await,
                Next::Line(free_ns) => {
                    let wait_ns = (free_ns - now_ns()).max(0) as u64;
                    tokio::time::sleep(Duration::from_nanos(wait_ns)).await;
                }
                Next::Room => {
                    let mut guard = port.writable().await?;
                    // Readiness may be old news: forgotten first, a port that has room now tells so again.
                    let is_hung_up = guard.ready().is_write_closed();
                    guard.clear_ready();
                    if matches!(self.write(), Next::Room) {
                        // The readiness of a port that is hung up stays, and room never comes. What its client had
                        // sent may still be read.
                        if is_hung_up {
                            self.lock().discard();
                        } else {
                            port.writable().await?.retain_ready();
                        }
                    }
                }
                Next::Closed => return Ok(()),
            }
        }
    }
}
