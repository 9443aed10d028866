//! The sending side of byte streams: complete frames or nothing, never blocking, paced if the transport has no line rate.
//!
//! Two threads write: the cadence thread sends samples, the runtime sends replies and completes partial writes. Frames leave in
//! the order in which they were accepted; while a fault sends a frame in parts, data of the other thread waits for its end. So
//! no frame is ever interrupted by another.

use std::convert::Infallible;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use tokio::sync::Notify;

use super::interface::{Link, LinkInfo, MAX_WAITING_REPLIES, until_due};
use super::port::{Port, WatchedPort};
use super::send_buffer::{Next, SendBuffer};
use super::statistics::{LinkStatistics, Sending};
use crate::host::{self, Instant, now_ns};
use crate::patience::Patience;
use geu_recorder::link_model::{Transmission, WireData};

/// A client that accepts no byte for this time, while replies wait, does not read: further replies are dropped until it does.
/// Ten times the limit of the interface control document for a reply.
const UNREAD_TIMEOUT: Duration = Duration::from_millis(200);
/// Interval of checks for free capacity.
const POLL_INTERVAL: Duration = Duration::from_micros(100);
/// Buffer of the line discipline of a real port: maximum number of unread bytes in a pty, with the next sample.
const MAX_UNREAD: u64 = 4095;

/// A link of byte streams, with a sender for each client.
pub(crate) struct StreamLink {
    pub info: LinkInfo,
    pub senders: Senders,
    /// Outcome of a sample without a client.
    pub without_client: Sending,
}

#[cfg(test)]
impl StreamLink {
    /// Returns whether the data that waits for each client is within its limits; true while a thread has a lock of it.
    pub fn bounds(&self) -> Box<dyn Fn() -> bool + Send + Sync> {
        let senders = self.senders.clone();
        let is_beyond = |sender: &Arc<StreamSender>| sender.state.try_lock().is_ok_and(|state| !state.is_bounded());
        Box::new(move || senders.0.try_lock().map_or(true, |senders| !senders.iter().any(is_beyond)))
    }
}

/// The senders of a link.
#[derive(Clone, Default)]
pub(crate) struct Senders(Arc<Mutex<Vec<Arc<StreamSender>>>>);

impl Senders {
    pub fn one(sender: &Arc<StreamSender>) -> Senders {
        Senders(Arc::new(Mutex::new(vec![sender.clone()])))
    }

    pub fn lock(&self) -> MutexGuard<'_, Vec<Arc<StreamSender>>> {
        host::lock(&self.0)
    }
}

impl Link for StreamLink {
    fn info(&self) -> &LinkInfo {
        &self.info
    }

    fn send(&mut self, data: &[WireData], more_fragments: bool, patience: &Patience) {
        let senders = self.senders.lock().clone();
        if senders.is_empty() {
            self.info.statistics.count(self.without_client);
        }
        for sender in senders {
            let outcome = sender.send(data, more_fragments, patience);
            self.info.statistics.count(if outcome == Sending::Unread { self.without_client } else { outcome });
        }
    }

    fn send_answers(&mut self) {
        for sender in self.senders.lock().iter() {
            sender.send_answers(i64::MAX);
        }
    }

    fn is_drained(&self) -> bool {
        self.senders.lock().iter().all(|sender| sender.is_drained())
    }
}

/// Returns the number of bytes that a client has not read, where the kernel reports it.
pub(crate) type CountUnread = Box<dyn Fn() -> u64 + Send + Sync>;

/// The sending side of one byte stream.
pub(crate) struct StreamSender {
    state: Mutex<SendBuffer>,
    /// Bytes wait for the pump, or the port was closed.
    wake: Notify,
    /// Replies were sent, or the port was closed.
    left: Notify,
    /// Replies wait for their time.
    later: Notify,
    statistics: Arc<LinkStatistics>,
    count_unread: Option<CountUnread>,
    /// Maximum number of bytes in the kernel that the client has not read.
    max_unread: u64,
    /// The client has shut down its side, and perhaps is gone.
    pub has_ended: AtomicBool,
}

impl StreamSender {
    pub fn new(
        port: Option<Port>,
        byte_ns: f64,
        info: &LinkInfo,
        count_unread: Option<CountUnread>,
    ) -> Arc<StreamSender> {
        let (sample_bytes, _) = info.model.encoding.sample_bytes();
        Arc::new(StreamSender {
            state: Mutex::new(SendBuffer::new(port, byte_ns, info)),
            max_unread: MAX_UNREAD.saturating_sub(sample_bytes as u64),
            wake: Notify::new(),
            left: Notify::new(),
            later: Notify::new(),
            statistics: info.statistics.clone(),
            count_unread,
            has_ended: AtomicBool::new(false),
        })
    }

    fn lock(&self) -> MutexGuard<'_, SendBuffer> {
        host::lock(&self.state)
    }

    /// A client is attached.
    pub fn open(&self, port: Port) {
        let mut state = self.lock();
        state.close();
        (state.port, state.is_stalled) = (Some(port), false);
    }

    /// The client is gone; waiting data is discarded.
    pub fn close(&self) {
        self.lock().close();
        self.wake.notify_one();
        self.left.notify_one();
    }

    pub fn is_open(&self) -> bool {
        self.lock().port.is_some()
    }

    /// True if no data waits, here or unread in the kernel.
    fn is_drained(&self) -> bool {
        let (is_open, is_empty) = (self.is_open(), self.lock().pending.is_empty());
        is_empty && (!is_open || self.count_unread.as_ref().is_none_or(|count_unread| count_unread() == 0))
    }

    /// True if the client has too many unread bytes for another sample. The kernel is asked only if all bytes since the last
    /// time may be unread: to open a pty takes a lock of all terminals, which another process may hold for milliseconds.
    fn is_unread(&self) -> bool {
        let Some(count_unread) = &self.count_unread else { return false };
        let state = self.lock();
        // The rest of a frame follows its beginning.
        if state.port.is_none() || state.is_dropping || state.begun == Some(false) {
            return false;
        }
        let (mut unread, mut counted_at) = state.unread;
        let written = state.written;
        drop(state);
        if unread + (written - counted_at) > self.max_unread {
            (unread, counted_at) = (count_unread(), written);
            self.lock().unread = (unread, counted_at);
        }
        unread > self.max_unread
    }

    /// Sends a sample, completely or not at all.
    fn send(&self, data: &[WireData], more_fragments: bool, patience: &Patience) -> Sending {
        let length = data.iter().map(|data| data.bytes().len()).sum();
        let start = Instant::now();
        loop {
            let is_unread = self.is_unread();
            let mut state = self.lock();
            if !state.accepts_data(length) {
                state.write();
            }
            if state.port.is_none() {
                return Sending::Unread;
            }
            if state.is_dropping {
                return state.drop_data(more_fragments);
            }
            if !is_unread && state.accepts_data(length) {
                let next = state.push(data, false, more_fragments);
                self.notify_capacity(state);
                if !matches!(next, Next::Bytes) {
                    self.wake.notify_one();
                }
                return if matches!(next, Next::Closed) { Sending::Dropped } else { Sending::Sent };
            }
            if state.is_stalled || patience.is_over(start) {
                state.is_stalled = !patience.is_none();
                return state.drop_data(more_fragments);
            }
            drop(state);
            host::sleep_thread(POLL_INTERVAL);
        }
    }

    /// Notifies the task that waits for capacity, if there is some.
    fn notify_capacity(&self, state: MutexGuard<SendBuffer>) {
        let accepts_reply = state.accepts_reply();
        drop(state);
        if accepts_reply {
            self.left.notify_one();
        }
    }

    /// Waits for capacity for a reply while the client reads; returns at once without a client.
    pub async fn reply_capacity(&self) {
        loop {
            let written = {
                let mut state = self.lock();
                state.drops_replies &= !state.accepts_reply();
                if state.drops_replies || state.accepts_reply() {
                    return;
                }
                state.written
            };
            let is_over = host::timeout(UNREAD_TIMEOUT, self.left.notified()).await.is_none();
            let mut state = self.lock();
            state.drops_replies = is_over && state.written == written;
        }
    }

    /// Queues the transmissions of a reply, with delays from now on the wall clock, or drops them without capacity;
    /// call [`StreamSender::reply_capacity`] first.
    pub fn answer(&self, transmissions: Vec<Transmission>) {
        let mut state = self.lock();
        if state.port.is_none() || transmissions.is_empty() {
            return;
        }
        if state.drops_replies || state.answers.message_count() >= MAX_WAITING_REPLIES {
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

    /// Sends the replies that are due by `until_ns`, after the waiting data, and returns the time of the next one.
    fn send_answers(&self, until_ns: i64) -> Option<i64> {
        let mut state = self.lock();
        while let Some((_, data)) = state.answers.next_due(until_ns) {
            let more_fragments = state.answers.is_within_frame();
            state.push(&data, true, more_fragments);
        }
        let next_ns = state.answers.next_ns();
        self.notify_capacity(state);
        self.wake.notify_one();
        next_ns
    }

    /// Sends replies at their time.
    async fn answer_later(&self) -> Infallible {
        loop {
            until_due(&self.later, self.send_answers(now_ns())).await;
        }
    }

    /// Number of bytes written.
    pub fn written(&self) -> u64 {
        self.lock().written
    }

    fn write(&self) -> Next {
        let mut state = self.lock();
        let next = state.write();
        self.notify_capacity(state);
        next
    }

    /// Writes waiting data as the line rate and the reader permit, and replies at their time, until the port is closed.
    pub async fn pump(&self, port: &WatchedPort) -> io::Result<()> {
        tokio::select! {
            biased;
            end = self.write_on(port) => end,
            never = self.answer_later() => match never {},
        }
    }

    async fn write_on(&self, port: &WatchedPort) -> io::Result<()> {
        loop {
            match self.write() {
                Next::Bytes => self.wake.notified().await,
                Next::Line(free_ns) => {
                    let wait_ns = (free_ns - now_ns()).max(0) as u64;
                    host::sleep(Duration::from_nanos(wait_ns)).await;
                }
                Next::Capacity => {
                    let mut guard = port.writable().await?;
                    // Readiness may be outdated: after it is cleared, a writable port reports it again.
                    let is_hung_up = guard.is_hung_up();
                    guard.clear();
                    if matches!(self.write(), Next::Capacity) {
                        // The readiness of a port that is hung up stays, and it never accepts data. Data from its client may
                        // still be read.
                        if is_hung_up {
                            self.lock().discard();
                        } else {
                            port.writable().await?.retain();
                        }
                    }
                }
                Next::Closed => return Ok(()),
            }
        }
    }
}
