//! The sending side of one byte stream: whole frames or nothing, never blocking, paced where there is no real line.
//!
//! Two threads write: the one that keeps time sends data, the runtime sends replies and finishes what did not fit.
//! Bytes leave in the order in which frames were taken, so no frame is ever cut by another.

use std::io;
use std::os::fd::OwnedFd;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread;
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::unistd;
use tokio::io::unix::AsyncFd;
use tokio::sync::Notify;

use super::{Sending, Tally, Watched};
use crate::cadence::now_ns;

/// Bytes that may wait when a half second is offered: the rest of a frame, and a reply.
const DATA_ROOM: usize = 64;
/// Bytes that may wait when a reply is offered: a client that asks and does not read loses replies beyond.
const REPLY_ROOM: usize = 1024;
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
    tally: Arc<Tally>,
}

struct State {
    /// Nothing while nobody is there.
    port: Option<Port>,
    pending: Vec<u8>,
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
                    self.pending.drain(..written);
                    self.free_ns += (written as f64 * self.byte_ns) as i64;
                }
                Err(Errno::EAGAIN) => return Next::Room,
                Err(Errno::EINTR) => {}
                Err(_) => self.close(),
            }
        }
        Next::Closed
    }

    fn take(&mut self, bytes: &[u8]) -> Next {
        if self.pending.is_empty() {
            self.free_ns = self.free_ns.max(now_ns());
        }
        self.pending.extend_from_slice(bytes);
        self.write()
    }

    fn close(&mut self) {
        self.port = None;
        self.pending.clear();
    }
}

impl Line {
    pub fn new(port: Option<Port>, byte_ns: f64, tally: Arc<Tally>) -> Line {
        let state = State { port, pending: Vec::new(), byte_ns, free_ns: 0, is_stalled: false };
        Line { state: Mutex::new(state), wake: Notify::new(), tally }
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
            if state.pending.len() + frame.len() > DATA_ROOM {
                state.write();
            }
            if state.port.is_none() {
                return Sending::Unread;
            }
            if state.pending.len() + frame.len() <= DATA_ROOM {
                let next = state.take(frame);
                drop(state);
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

    /// Sends the reply to a command, behind what waits.
    pub fn reply(&self, bytes: &[u8]) {
        let mut state = self.lock();
        if state.pending.len() + bytes.len() > REPLY_ROOM {
            return;
        }
        state.take(bytes);
        drop(state);
        self.wake.notify_one();
        self.tally.replies.fetch_add(1, Relaxed);
    }

    /// Writes whatever waits as the line and the reader permit, until the port is closed.
    pub async fn pump(&self, port: &AsyncFd<Watched<Port>>) -> io::Result<()> {
        loop {
            let next = self.lock().write();
            match next {
                Next::Bytes => self.wake.notified().await,
                Next::Line(free_ns) => {
                    let wait_ns = (free_ns - now_ns()).max(0) as u64;
                    tokio::time::sleep(Duration::from_nanos(wait_ns)).await;
                }
                Next::Room => {
                    // Readiness may be old news: forgotten first, a port that has room now tells so again.
                    port.writable().await?.clear_ready();
                    if matches!(self.lock().write(), Next::Room) {
                        port.writable().await?.retain_ready();
                    }
                }
                Next::Closed => return Ok(()),
            }
        }
    }
}
