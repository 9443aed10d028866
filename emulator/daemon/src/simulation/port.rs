//! Byte streams as the kernel has them: a pty and a TCP connection, with their readiness.

use std::collections::VecDeque;
use std::future::{Future, poll_fn};
use std::io;
use std::sync::{Arc, Mutex, MutexGuard};
use std::task::{Poll, Waker};

use nix::errno::Errno;
use nix::poll::PollFlags;
use tokio::sync::Notify;

use super::world::host;
use crate::link::pty::Terminal;

/// Bytes that wait for a client of a pty: the buffer of the line discipline, and that of the driver before it.
const PTY_CAPACITY: usize = 4096 + 4096;
/// Bytes that wait for a client of a TCP connection, on both sides.
const TCP_CAPACITY: usize = 16_384;
/// Bytes that wait for the unit.
const UNIT_CAPACITY: usize = 4096;

/// One stream; clones share it.
#[derive(Clone)]
pub(crate) struct Port(Arc<Stream>);

struct Stream {
    state: Mutex<Kernel>,
    /// Bytes or the end came for the client.
    for_client: Notify,
    /// A client opened it (pty).
    opened: Notify,
}

#[derive(Default)]
struct Kernel {
    is_pty: bool,
    to_client: VecDeque<u8>,
    to_unit: VecDeque<u8>,
    /// Clients that have it open.
    clients: usize,
    /// The client sends no more (TCP).
    has_shut_down: bool,
    watches: Vec<Readiness>,
    next_watch: usize,
}

/// Readiness of a stream as the runtime knows it: set by events, cleared after a failed attempt. A hang-up stays.
#[derive(Default)]
struct Readiness {
    id: usize,
    readable: bool,
    writable: bool,
    hung_up: bool,
    wakers: [Option<Waker>; 2],
}

impl Kernel {
    /// An event of the stream: what is true now is seen by all watches.
    fn event(&mut self) {
        let (readable, writable, hung_up) = (self.is_readable(), self.is_writable(), self.is_hung_up());
        for watch in &mut self.watches {
            watch.readable |= readable;
            watch.writable |= writable;
            watch.hung_up |= hung_up;
            watch.wakers.iter_mut().filter_map(Option::take).for_each(Waker::wake);
        }
    }

    fn is_hung_up(&self) -> bool {
        self.clients == 0
    }

    fn is_readable(&self) -> bool {
        !self.to_unit.is_empty() || self.has_shut_down || self.is_hung_up()
    }

    fn is_writable(&self) -> bool {
        self.capacity() > 0 || self.is_hung_up() && !self.is_pty
    }

    fn capacity(&self) -> usize {
        (if self.is_pty { PTY_CAPACITY } else { TCP_CAPACITY }).saturating_sub(self.to_client.len())
    }
}

impl Port {
    fn new(is_pty: bool, clients: usize) -> Port {
        let state = Mutex::new(Kernel { is_pty, clients, ..Kernel::default() });
        Port(Arc::new(Stream { state, for_client: Notify::new(), opened: Notify::new() }))
    }

    fn lock(&self) -> MutexGuard<'_, Kernel> {
        self.0.state.lock().expect("no panic while locked")
    }

    /// Writes some of the bytes to the client.
    pub fn write(&self, bytes: &[u8]) -> nix::Result<usize> {
        let mut kernel = self.lock();
        if kernel.is_hung_up() && !kernel.is_pty {
            return Err(Errno::EPIPE);
        }
        let host = host().expect("simulated");
        if host.happens(0.01) {
            return Err(Errno::EINTR);
        }
        let mut length = bytes.len().min(kernel.capacity());
        if length == 0 {
            return Err(Errno::EAGAIN);
        }
        if host.happens(0.1) {
            length = host.draw(1..=length as i64) as usize;
        }
        kernel.to_client.extend(&bytes[..length]);
        host.changed();
        self.0.for_client.notify_waiters();
        Ok(length)
    }

    /// Reads some bytes of the client.
    pub fn read(&self, bytes: &mut [u8]) -> nix::Result<usize> {
        let mut kernel = self.lock();
        if kernel.to_unit.is_empty() {
            return match (kernel.is_pty, kernel.is_hung_up(), kernel.has_shut_down) {
                (true, true, _) => Err(Errno::EIO),
                (false, true, false) => Err(Errno::ECONNRESET),
                (false, _, true) => Ok(0),
                _ => Err(Errno::EAGAIN),
            };
        }
        let host = host().expect("simulated");
        let most = bytes.len().min(kernel.to_unit.len());
        let length = if host.happens(0.1) { host.draw(1..=most as i64) as usize } else { most };
        bytes.iter_mut().zip(kernel.to_unit.drain(..length)).for_each(|(to, byte)| *to = byte);
        host.changed();
        Ok(length)
    }

    pub fn state(&self) -> PollFlags {
        let kernel = self.lock();
        let input = !kernel.to_unit.is_empty() || !kernel.is_pty && (kernel.has_shut_down || kernel.is_hung_up());
        let mut state = if input { PollFlags::POLLIN } else { PollFlags::empty() };
        state.set(PollFlags::POLLHUP, kernel.is_hung_up());
        state
    }

    /// Number of bytes that the client has not read.
    pub fn count_unread(&self) -> u64 {
        self.lock().to_client.len() as u64
    }

    pub fn watch(&self) -> Watch {
        let mut kernel = self.lock();
        let id = kernel.next_watch;
        kernel.next_watch += 1;
        let (readable, writable, hung_up) = (kernel.is_readable(), kernel.is_writable(), kernel.is_hung_up());
        kernel.watches.push(Readiness { id, readable, writable, hung_up, wakers: [None, None] });
        Watch { port: self.clone(), id }
    }
}

/// A stream that the runtime watches.
pub(crate) struct Watch {
    port: Port,
    id: usize,
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.port.lock().watches.retain(|watch| watch.id != self.id);
    }
}

impl Watch {
    async fn ready(&self, direction: usize) -> Ready<'_> {
        poll_fn(|context| {
            let mut kernel = self.port.lock();
            let watch = kernel.watches.iter_mut().find(|watch| watch.id == self.id).expect("watched");
            let is_ready = watch.hung_up || if direction == 0 { watch.readable } else { watch.writable };
            if is_ready {
                return Poll::Ready(Ready { watch: self, direction, is_hung_up: watch.hung_up });
            }
            watch.wakers[direction] = Some(context.waker().clone());
            Poll::Pending
        })
        .await
    }

    pub fn readable(&self) -> impl Future<Output = Ready<'_>> {
        self.ready(0)
    }

    pub fn writable(&self) -> impl Future<Output = Ready<'_>> {
        self.ready(1)
    }
}

pub(crate) struct Ready<'a> {
    watch: &'a Watch,
    direction: usize,
    is_hung_up: bool,
}

impl Ready<'_> {
    pub fn is_hung_up(&self) -> bool {
        self.is_hung_up
    }

    pub fn clear(&mut self) {
        let mut kernel = self.watch.port.lock();
        let watch = kernel.watches.iter_mut().find(|watch| watch.id == self.watch.id).expect("watched");
        *(if self.direction == 0 { &mut watch.readable } else { &mut watch.writable }) = false;
    }
}

/// A pty under a path.
#[derive(Clone)]
pub(crate) struct Pty {
    master: crate::link::port::Port,
    stream: Port,
}

impl Pty {
    pub fn new() -> Pty {
        let stream = Port::new(true, 0);
        Pty { master: crate::link::port::Port::Simulated(stream.clone()), stream }
    }

    pub fn count_unread(&self) -> u64 {
        self.stream.count_unread()
    }

    /// A client opens the slave.
    pub fn open(&self) -> ClientEnd {
        let mut kernel = self.stream.lock();
        kernel.clients += 1;
        kernel.event();
        drop(kernel);
        self.stream.0.opened.notify_waiters();
        ClientEnd(self.stream.clone())
    }
}

impl Terminal for Pty {
    fn master(&self) -> &crate::link::port::Port {
        &self.master
    }

    fn reset(&mut self) -> io::Result<()> {
        if host().expect("simulated").happens(0.02) {
            return Err(Errno::EIO.into());
        }
        self.stream.lock().to_client.clear();
        Ok(())
    }

    async fn opened(&self) -> io::Result<()> {
        loop {
            let opened = self.stream.0.opened.notified();
            if self.stream.state() != PollFlags::POLLHUP {
                return Ok(());
            }
            opened.await;
        }
    }
}

/// A TCP connection: the unit's side, and the client's.
pub(crate) fn connection() -> (crate::link::port::Port, ClientEnd) {
    let stream = Port::new(false, 1);
    (crate::link::port::Port::Simulated(stream.clone()), ClientEnd(stream))
}

/// The client's side of a stream; dropping it closes it.
pub(crate) struct ClientEnd(Port);

impl ClientEnd {
    /// Takes up to `most` bytes that have come.
    pub fn read(&self, most: usize) -> Vec<u8> {
        let mut kernel = self.0.lock();
        let length = kernel.to_client.len().min(most);
        let bytes: Vec<u8> = kernel.to_client.drain(..length).collect();
        if !bytes.is_empty() {
            kernel.event();
            host().expect("simulated").changed();
        }
        bytes
    }

    /// Waits until bytes may have come.
    pub async fn readable(&self) {
        let arrived = self.0.0.for_client.notified();
        if self.0.count_unread() == 0 {
            arrived.await;
        }
    }

    /// Sends bytes until the buffer is full, and returns their number.
    pub fn write(&self, bytes: &[u8]) -> usize {
        let mut kernel = self.0.lock();
        let length = bytes.len().min(UNIT_CAPACITY.saturating_sub(kernel.to_unit.len()));
        kernel.to_unit.extend(&bytes[..length]);
        kernel.event();
        length
    }

    /// True once the unit has dropped its side (TCP).
    pub fn is_closed_by_unit(&self) -> bool {
        Arc::strong_count(&self.0.0) == 1
    }

    /// Sends no more (TCP).
    pub fn shut_down(&self) {
        let mut kernel = self.0.lock();
        if !kernel.is_pty {
            kernel.has_shut_down = true;
            kernel.event();
        }
    }
}

impl Drop for ClientEnd {
    fn drop(&mut self) {
        let mut kernel = self.0.lock();
        kernel.clients -= 1;
        if kernel.clients == 0 {
            if !kernel.is_pty {
                kernel.to_client.clear();
            }
            kernel.event();
        }
    }
}
