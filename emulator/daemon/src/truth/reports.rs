//! What left in each sample interval, reported to a simulator that asked for it.
//!
//! A simulator in a closed loop waits for the unit's data before it goes on. Where a fault keeps a link silent there are
//! none, and a wait on the link has no end; a report ends each interval. It is a JSON line, written after the links were
//! handed their bytes, over the truth's own connection.
//!
//! Nothing is sent unasked: a TCP peer that closes its socket with unread bytes in it makes its kernel discard what it
//! has sent itself, so a simulator that never reads would lose its last samples. The thread that keeps time never waits:
//! a report that has no room, because the peer does not read, is dropped and counted.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Mutex, MutexGuard};

use serde_json::{Map, Value, json};
use tokio::sync::mpsc::{Receiver, Sender, channel};

/// Reports that may wait for a peer that does not read: over eight minutes in real time.
const QUEUE: usize = 1000;

/// What a link was handed in one sample interval.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Handed {
    /// Bytes over a byte stream; CAN has frames.
    pub bytes: u64,
    /// CAN frames.
    pub frames: u64,
    /// Sendings that were dropped, one for each client: no room, or the device was gone.
    pub dropped: u64,
}

/// The end of one sample interval.
#[derive(Debug)]
pub(crate) struct SampleReport {
    /// Index from 0.
    pub sample: u64,
    /// Its end, true time since the start of the run.
    pub end_s: f64,
    pub sequence: u16,
    pub clock_count: u64,
    /// Each link by name, whether it is a CAN bus, and what it was handed.
    pub links: Vec<(String, bool, Handed)>,
}

impl SampleReport {
    /// The line, with the end on the source's time scale.
    fn line(&self, source_s: f64) -> String {
        let link = |(name, is_can, handed): &(String, bool, Handed)| {
            let Handed { bytes, frames, dropped } = handed;
            let value = match is_can {
                true => json!({ "frames": frames, "dropped": dropped }),
                false => json!({ "bytes": bytes, "dropped": dropped }),
            };
            (name.clone(), value)
        };
        let links: Map<String, Value> = self.links.iter().map(link).collect();
        let line = json!({
            "half_second": self.sample,
            "t_s": source_s,
            "sequence": self.sequence,
            "clock_count": self.clock_count,
            "sent": links,
        });
        format!("{line}\n")
    }
}

/// Reports on their way to the peer that asked for them.
#[derive(Debug)]
pub(super) struct Reports {
    is_wanted: AtomicBool,
    sender: Sender<String>,
    /// Until the task that writes takes it.
    receiver: Mutex<Option<Receiver<String>>>,
    /// Whom datagrams go to.
    peer: Mutex<Option<SocketAddr>>,
    sent: AtomicU64,
    dropped: AtomicU64,
}

impl Default for Reports {
    fn default() -> Reports {
        let (sender, receiver) = channel(QUEUE);
        Reports {
            is_wanted: AtomicBool::new(false),
            sender,
            receiver: Mutex::new(Some(receiver)),
            peer: Mutex::new(None),
            sent: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
        }
    }
}

impl Reports {
    /// The end that is written from; there is one.
    pub fn receiver(&self) -> Option<Receiver<String>> {
        self.receiver.lock().expect("nothing panics with the end").take()
    }

    /// A peer asks for them from now on.
    pub fn subscribe(&self, peer: Option<SocketAddr>) {
        *self.peer() = peer;
        self.is_wanted.store(true, Relaxed);
    }

    /// The peer is gone.
    pub fn unsubscribe(&self) {
        self.is_wanted.store(false, Relaxed);
    }

    pub fn is_wanted(&self) -> bool {
        self.is_wanted.load(Relaxed)
    }

    /// Whom datagrams go to.
    pub fn peer(&self) -> MutexGuard<'_, Option<SocketAddr>> {
        self.peer.lock().expect("nothing panics with an address")
    }

    /// Hands a report on, without waiting.
    pub fn put(&self, report: &SampleReport, source_s: f64) {
        match self.sender.try_send(report.line(source_s)) {
            Ok(()) => self.sent.fetch_add(1, Relaxed),
            Err(_) => self.dropped.fetch_add(1, Relaxed),
        };
    }

    /// One could not be written.
    pub fn lost(&self) {
        self.sent.fetch_sub(1, Relaxed);
        self.dropped.fetch_add(1, Relaxed);
    }

    /// Handed on, and dropped.
    pub fn counts(&self) -> (u64, u64) {
        (self.sent.load(Relaxed), self.dropped.load(Relaxed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(sample: u64) -> SampleReport {
        let handed = |bytes, frames| Handed { bytes, frames, dropped: 1 };
        SampleReport {
            sample,
            end_s: 0.5,
            sequence: 7,
            clock_count: 500_000,
            links: vec![
                ("tcp 127.0.0.1:1".to_owned(), false, handed(28, 0)),
                ("can vcan0".to_owned(), true, handed(0, 3)),
            ],
        }
    }

    #[test]
    fn a_report_says_what_each_link_was_handed_in_its_own_measure() {
        let line: Value = serde_json::from_str(&report(3).line(100.5)).expect("JSON");
        let expected = json!({
            "half_second": 3, "t_s": 100.5, "sequence": 7, "clock_count": 500_000,
            "sent": { "tcp 127.0.0.1:1": { "bytes": 28, "dropped": 1 }, "can vcan0": { "frames": 3, "dropped": 1 } },
        });
        assert_eq!(line, expected);
    }

    #[test]
    fn reports_that_nobody_takes_are_counted_and_take_no_more_room() {
        let reports = Reports::default();
        (0..3000).for_each(|index| reports.put(&report(index), 0.0));
        assert_eq!(reports.counts(), (QUEUE as u64, 3000 - QUEUE as u64));
    }
}
