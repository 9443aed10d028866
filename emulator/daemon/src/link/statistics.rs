//! Statistics of a link.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed};

/// Statistics of a link, for the status and the summary.
#[derive(Debug, Default)]
pub struct LinkStatistics {
    /// Transport and address, as in its ready line.
    pub name: String,
    /// Number of attached clients; 0 for a bus or a serial port.
    pub clients: AtomicUsize,
    /// Number of sends, one for each client: all data of one time, a sample without faults.
    pub sent: AtomicU64,
    /// Number of sends dropped: the client or the bus did not accept the data, or the device was gone.
    pub dropped: AtomicU64,
    /// Number of sends without a reader.
    pub unread: AtomicU64,
    /// Number of replies, including delayed ones.
    pub replies: AtomicU64,
    /// Number of replies dropped: the client did not read the previous ones.
    pub unread_replies: AtomicU64,
    /// Number of connections refused: their address is not allowed, or they use another protocol.
    pub refused: AtomicU64,
}

impl LinkStatistics {
    pub(crate) fn new(name: impl Into<String>) -> Arc<LinkStatistics> {
        Arc::new(LinkStatistics { name: name.into(), ..LinkStatistics::default() })
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
        for (count, meaning) in [
            (&self.unread, "not sent (no reader)"),
            (&self.unread_replies, "replies dropped"),
            (&self.refused, "connections refused"),
        ] {
            let count = count.load(Relaxed);
            if count > 0 {
                write!(f, ", {count} {meaning}")?;
            }
        }
        Ok(())
    }
}

/// Outcome of a send.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sending {
    Sent,
    Dropped,
    /// No client is attached.
    Unread,
}
