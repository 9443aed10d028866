//! The sending side of one byte stream: whole frames or nothing, never blocking, paced where there is no real line.
//!
//! Two threads write: the one that keeps time sends data, the runtime sends answers and finishes what did not fit.
//! Bytes leave in the order in which frames were taken; where a fault has a frame come in parts, what comes from the other
//! thread waits for its end. So no frame is ever cut by another.

use std::convert::Infallible;
use std::io;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread;
use std::time::{Duration, Instant};

use tokio::io::unix::AsyncFd;
use tokio::sync::Notify;
use tokio::time::timeout;

use super::interface::{LATE_ANSWERS, Watched, until_due};
use super::send_buffer::{Next, Port, SendBuffer};
use super::statistics::{LinkStatistics, Sending};
use crate::cadence::now_ns;
use crate::link_model::{Transmission, WireData};
use crate::patience::Patience;

/// A client that takes no byte for so long, while replies have no room, does not read: further replies are dropped until it
/// does. Ten times what the interface control document gives a reply.
const UNREAD: Duration = Duration::from_millis(200);
/// Between two looks for room.
const LOOK_AGAIN: Duration = Duration::from_micros(100);

/// The sending side of a byte stream.
pub(super) struct StreamSender {
    state: Mutex<SendBuffer>,
    /// Bytes wait for the pump, or the port was closed.
    wake: Notify,
    /// Answers have left, or the port was closed.
    left: Notify,
    /// Answers wait for their time.
    later: Notify,
    statistics: Arc<LinkStatistics>,
}

impl StreamSender {
    pub fn new(port: Option<Port>, byte_ns: f64, statistics: Arc<LinkStatistics>) -> StreamSender {
        let state = SendBuffer::new(port, byte_ns, statistics.clone());
        StreamSender {
            state: Mutex::new(state),
            wake: Notify::new(),
            left: Notify::new(),
            later: Notify::new(),
            statistics,
        }
    }

    fn lock(&self) -> MutexGuard<'_, SendBuffer> {
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

    /// Whether a frame of the sample that was sent last goes on, or was dropped and its rest is too.
    pub fn is_within_frame(&self) -> bool {
        let state = self.lock();
        state.is_dropping || state.begun == Some(false)
    }

    /// Drops bytes of a sample that have no room elsewhere.
    pub fn drop_data(&self, more_fragments: bool) -> Sending {
        self.lock().drop_data(more_fragments)
    }

    /// Sends a sample, whole or not at all.
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
    fn tell_room(&self, state: MutexGuard<SendBuffer>) {
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
