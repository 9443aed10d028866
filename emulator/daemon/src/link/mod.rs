//! The links: each its own file, all fed the same half second by the thread that keeps time.
//!
//! That thread writes to them directly, without ever blocking; whatever a link cannot take at once is finished, or
//! recovered from, by a task of the runtime on the other thread.

pub mod can;
pub mod pty;
mod receive;
pub mod serial;
mod stream_sender;
pub mod tcp;

use std::fmt;
use std::io;
use std::ops::Deref;
use std::os::fd::{AsFd, AsRawFd, RawFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed};

use geu_model::fault::catalogue::LinkKind;
use tokio::io::unix::AsyncFd;

use crate::link_model::{Encoding, LinkModel, WireData};
use crate::patience::Patience;
use crate::shared_unit::SharedUnit;

pub use can::CanAddress;
pub use serial::SerialAddress;
pub use tcp::TcpAddress;

/// Answers of a client that wait for their time, at most: beyond, they are dropped.
const LATE_ANSWERS: usize = 1000;

/// A link to be opened.
#[derive(Debug, Clone)]
pub enum LinkAddress {
    /// A pty with a symlink at this path.
    Pty(std::path::PathBuf),
    /// A serial port.
    Serial(SerialAddress),
    /// A CAN interface.
    Can(CanAddress),
    /// Serial bytes to every client of an address.
    Tcp(TcpAddress),
}

impl LinkAddress {
    /// What it carries, as a recording beside it tells it.
    pub fn model(&self) -> LinkModel {
        match self {
            LinkAddress::Pty(_) => LinkModel::serial(LinkKind::Pty),
            LinkAddress::Serial(address) => {
                LinkModel { kind: LinkKind::Serial, encoding: Encoding::Serial { baud: address.baud } }
            }
            LinkAddress::Can(address) => LinkModel::can(address.plan),
            LinkAddress::Tcp(_) => LinkModel::serial(LinkKind::Tcp),
        }
    }
}

/// A link that cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// Something other than a symlink stands where the link to the pty should.
    #[error(
        "--pty {0}: there is {1} at this path, which is never replaced; expected a free path, or an old link: remove it, or name another path"
    )]
    PathTaken(String, &'static str),
    /// The symlink leads to a device that lives.
    #[error(
        "--pty {0}: is a link to {1}, which is in use (another emulator?); expected a free path: end the other, remove the link, or name another path"
    )]
    PathBusy(String, String),
    /// The symlink cannot be made, or no pty to be had.
    #[error("--pty {0}: {1}; expected a path in a directory that exists and may be written")]
    Pty(String, io::Error),
    /// The serial port cannot be opened.
    #[error("--serial {0}: {1}; expected a serial device that exists and may be read and written")]
    Serial(String, io::Error),
    /// The address cannot be listened at.
    #[error("--tcp {0}: {1}; expected HOST:PORT of this machine, free, for example 127.0.0.1:5000")]
    Tcp(String, io::Error),
    /// Other machines could drive the unit.
    #[error(
        "--tcp {0}: other machines can reach this address, and whoever connects drives the unit; expected --tcp-allow with the addresses that may, for example --tcp-allow 192.168.7.0/24, or a loopback address"
    )]
    TcpOpenToAll(String),
    /// No such CAN interface.
    #[error(
        "--can {0}: no such interface; expected one of `ip link`, for example: ip link add dev vcan0 type vcan; ip link set vcan0 up"
    )]
    CanAbsent(String),
    /// Not a CAN interface.
    #[error("--can {0}: is not a CAN interface; expected one that `ip -details link` shows as can or vcan")]
    NotCan(String),
    /// No right to it.
    #[error("--can {0}: no permission to open a CAN socket ({1}); expected a user, or a container, that may")]
    CanPermission(String, io::Error),
    /// No SocketCAN at all.
    #[error(
        "--can {0}: this kernel has no SocketCAN ({1}); expected the module can_raw: modprobe can_raw, or another kernel"
    )]
    CanUnsupported(String, io::Error),
    /// Anything else.
    #[error("--can {0}: {1}")]
    Can(String, io::Error),
}

/// What a link has done, for the status line and the end.
#[derive(Debug)]
pub struct LinkStatistics {
    /// Kind and address, as in its ready line.
    pub name: String,
    /// Clients attached now; a bus or a port counts as none.
    pub clients: AtomicUsize,
    /// Sendings, one for each client: all that leaves at one time, a half second where no fault makes it more or less.
    pub sent: AtomicU64,
    /// Sendings dropped, whole: the client or the bus had no room, or the device was gone.
    pub dropped: AtomicU64,
    /// Sendings that were not sent: nobody was there to read.
    pub unread: AtomicU64,
    /// Commands answered over it, some of them late.
    pub replies: AtomicU64,
    /// Replies dropped: the client did not read those before.
    pub unread_replies: AtomicU64,
    /// Connections closed at once: of addresses that are not allowed, or of another protocol.
    pub refused: AtomicU64,
}

impl LinkStatistics {
    pub(crate) fn new(name: impl Into<String>) -> Arc<LinkStatistics> {
        Arc::new(LinkStatistics {
            name: name.into(),
            clients: AtomicUsize::new(0),
            sent: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            unread: AtomicU64::new(0),
            replies: AtomicU64::new(0),
            unread_replies: AtomicU64::new(0),
            refused: AtomicU64::new(0),
        })
    }

    fn count(&self, outcome: Sending) {
        match outcome {
            Sending::Sent => self.sent.fetch_add(1, Relaxed),
            Sending::Dropped => self.dropped.fetch_add(1, Relaxed),
            Sending::Unread => self.unread.fetch_add(1, Relaxed),
        };
    }
}

impl fmt::Display for LinkStatistics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (sent, dropped) = (self.sent.load(Relaxed), self.dropped.load(Relaxed));
        write!(f, "{}: {sent} sent, {dropped} dropped, {} replies", self.name, self.replies.load(Relaxed))?;
        for (count, what) in [
            (&self.unread, "not sent (no reader)"),
            (&self.unread_replies, "replies dropped"),
            (&self.refused, "connections refused"),
        ] {
            let count = count.load(Relaxed);
            if count > 0 {
                write!(f, ", {count} {what}")?;
            }
        }
        Ok(())
    }
}

/// What became of what was to be sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sending {
    Sent,
    Dropped,
    /// Nobody is there to read.
    Unread,
}

/// A link, as the thread that keeps time sees it.
pub(crate) trait Link: Send {
    /// How it writes, and whom a fault is on.
    fn model(&self) -> &LinkModel;
    /// Takes what is sent next, before its deadline; whether it ends within a frame, whose rest comes with the next.
    fn prepare(&mut self, contents: &[WireData], more_fragments: bool);
    /// Sends it, without blocking; a reader that has no room is given `patience` before it loses all of it.
    fn send(&mut self, patience: &Patience);
    /// Sends at once, as the run ends, the answers that faults still hold back.
    fn send_answers(&mut self);
    /// Whether it can be used at once; one that cannot tells by itself when it can.
    fn is_ready(&self) -> bool {
        true
    }
    /// Whether all that was taken has reached those who read.
    fn is_drained(&self) -> bool;
    /// What it has done.
    fn statistics(&self) -> Arc<LinkStatistics>;
}

/// The bytes of contents that go over a stream.
fn stream(contents: &[WireData]) -> Vec<u8> {
    let bytes = |content: &WireData| match content {
        WireData::Bytes(bytes) => bytes.clone(),
        WireData::Frame(_) => Vec::new(),
    };
    contents.iter().flat_map(bytes).collect()
}

/// Opens a link and starts its tasks on the runtime.
///
/// # Errors
/// What stands in the way, and what to do about it.
pub(crate) fn open(address: &LinkAddress, unit: &Arc<SharedUnit>, speedup: f64) -> Result<Box<dyn Link>, LinkError> {
    let model = address.model();
    Ok(match address {
        LinkAddress::Pty(path) => Box::new(pty::open(path, model, unit, speedup)?),
        LinkAddress::Serial(address) => Box::new(serial::open(address, model, unit)?),
        LinkAddress::Can(address) => Box::new(can::open(address, model, unit)?),
        LinkAddress::Tcp(address) => Box::new(tcp::open(address, model, unit, speedup > 1.0)?),
    })
}

/// A descriptor whose readiness the runtime tells.
struct Watched<T>(T);

impl<T: AsFd> Watched<T> {
    fn new(owner: T) -> io::Result<AsyncFd<Watched<T>>> {
        // SAFETY: the owner keeps its descriptor open, and the same, for as long as it is inside.
        Ok(unsafe { AsyncFd::register(Watched(owner)) }?)
    }
}

impl<T: AsFd> AsRawFd for Watched<T> {
    fn as_raw_fd(&self) -> RawFd {
        self.0.as_fd().as_raw_fd()
    }
}

impl<T> Deref for Watched<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.0
    }
}
