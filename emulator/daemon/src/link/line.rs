//! The sending side of one byte stream: whole frames or nothing, never blocking, paced where there is no real line.
//!
//! Two threads write: the one that keeps time sends data, the runtime sends replies and finishes what did not fit.
//! Bytes leave in the order in which frames were taken, so no frame is ever cut by another.

use std::collections::VecDeque;
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

use super::{Sending, Tally, Watched};
use crate::cadence::now_ns;

/// Bytes of half seconds that may wait when another is offered: less than two.
const DATA_ROOM: usize = 2 * MAX_FRAME;
/// Bytes of replies that may wait: beyond, no more commands are read until the client has read replies.
const REPLY_ROOM: usize = 512;
/// The longest answer: a reply, and the half second that was polled.
const LONGEST_ANSWER: usize = 2 * MAX_FRAME;
/// A paced line takes so much of its time in one write, ns.
const CHUNK_NS: i64 = 1_000_000;
/// Between two looks for room.
const LOOK_AGAIN: Duration = Duration::from_micros(100);

/// A descriptor that both threads write to.
pub(super) type Port = Arc<OwnedFd>;

/// The sending side of a byte stream.
pub(super) struct Line {
    state: Mutex<State>,
    /// Bytes wait for the pump, or the port was closed.
    wake: Notify,
    /// Replies have left, or the port was closed.
    left: Notify,
    tally: Arc<Tally>,
}

struct State {
    /// Nothing while nobody is there.
    port: Option<Port>,
    pending: Vec<u8>,
    /// Lengths of the frames in `pending`, and whether they are replies; the first may have left in part.
    frames: VecDeque<(usize, bool)>,
    /// Bytes of replies in `pending`.
    replies: usize,
    /// Bytes written so far.
    written: u64,
    /// Time of a byte on the line, ns; 0 where the device or the network paces.
    byte_ns: f64,
    /// When the line is through with what was written.
    free_ns: i64,
    /// Patience with this client has run out: it gets what it has room for, and is not waited for again.
    is_stalled: bool,
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

    fn take(&mut self, bytes: &[u8], is_reply: bool) -> Next {
        if self.pending.is_empty() {
            self.free_ns = self.free_ns.max(now_ns());
        }
        self.pending.extend_from_slice(bytes);
        self.frames.push_back((bytes.len(), is_reply));
        self.replies += if is_reply { bytes.len() } else { 0 };
        self.write()
    }

    /// What is longer than a frame, because a fault made it so, has room where a frame has.
    fn has_data_room(&self, length: usize) -> bool {
        self.pending.len() - self.replies + length.min(MAX_FRAME) <= DATA_ROOM
    }

    fn has_reply_room(&self) -> bool {
        self.port.is_none() || self.replies + LONGEST_ANSWER <= REPLY_ROOM
    }

    fn close(&mut self) {
        self.port = None;
        self.pending.clear();
        self.frames.clear();
        self.replies = 0;
    }
}

impl Line {
    pub fn new(port: Option<Port>, byte_ns: f64, tally: Arc<Tally>) -> Line {
        let state = State {
            port,
            pending: Vec::new(),
            frames: VecDeque::new(),
            replies: 0,
            written: 0,
            byte_ns,
            free_ns: 0,
            is_stalled: false,
        };
        Line { state: Mutex::new(state), wake: Notify::new(), left: Notify::new(), tally }
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

    /// Sends a half second, whole or not at all.
    pub fn send(&self, frame: &[u8], patience: Duration) -> Sending {
        let mut asked = None;
        loop {
            let mut state = self.lock();
            if !state.has_data_room(frame.len()) {
                state.write();
            }
            if state.port.is_none() {
                return Sending::Unread;
            }
            if state.has_data_room(frame.len()) {
                let next = state.take(frame, false);
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
            if state.is_stalled || asked.get_or_insert_with(Instant::now).elapsed() >= patience {
                state.is_stalled = !patience.is_zero();
                return Sending::Dropped;
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

    /// Waits until there is room for an answer; there always is where nobody is there.
    pub async fn reply_room(&self) {
        while !self.lock().has_reply_room() {
            self.left.notified().await;
        }
    }

    /// Sends the reply to a command, behind what waits; [`Line::reply_room`] comes first.
    pub fn reply(&self, bytes: &[u8]) {
        let mut state = self.lock();
        if state.port.is_none() || bytes.is_empty() {
            return;
        }
        state.take(bytes, true);
        drop(state);
        self.wake.notify_one();
        self.tally.replies.fetch_add(1, Relaxed);
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

    /// Writes whatever waits as the line and the reader permit, until the port is closed.
    pub async fn pump(&self, port: &AsyncFd<Watched<Port>>) -> io::Result<()> {
        loop {
            let next = self.write();
            match next {
                Next::Bytes => self.wake.notified().await,
                Next::Line(free_ns) => {
                    let wait_ns = (free_ns - now_ns()).max(0) as u64;
                    tokio::time::sleep(Duration::from_nanos(wait_ns)).await;
                }
                Next::Room => {
                    // Readiness may be old news: forgotten first, a port that has room now tells so again.
                    port.writable().await?.clear_ready();
                    if matches!(self.write(), Next::Room) {
                        port.writable().await?.retain_ready();
                    }
                }
                Next::Closed => return Ok(()),
            }
        }
    }
}
