//! What a link has done, for the status line and the end.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed};

/// What a link has done, for the status line and the end.
#[derive(Debug)]
pub struct LinkStatistics {
    /// Kind and address, as in its ready line.
    pub name: String,
    /// Clients attached now; a bus or a port counts as none.
    pub clients: AtomicUsize,
    /// Sendings, one for each client: all that leaves at one time, a sample where no fault makes it more or less.
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

    pub(super) fn count(&self, outcome: Sending) {
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
pub(super) enum Sending {
    Sent,
    Dropped,
    /// Nobody is there to read.
    Unread,
}
