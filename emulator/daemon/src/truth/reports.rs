//! Reports of the bytes sent in each sample interval, to a simulator that subscribed.
//!
//! A simulator in a closed loop waits for the unit's data. If a fault silences the link there are none; a report ends each
//! interval in any case. It is a JSON line over the connection of the truth, written after the links have their bytes.
//!
//! Reports need a subscription: if a TCP peer closes its socket with unread bytes, its kernel discards what the peer has
//! sent, so a simulator that never reads would lose its last samples. The cadence thread never waits: if the queue is full
//! because the peer does not read, reports are dropped and counted.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Mutex, MutexGuard};

use serde_json::{Map, Value, json};
use tokio::sync::mpsc::{Receiver, Sender, channel};

/// Capacity of the queue: over eight minutes in real time.
const QUEUE: usize = 1000;

/// Data handed to a link in one sample interval.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Handed {
    /// Bytes of a byte stream.
    pub bytes: u64,
    /// CAN frames.
    pub frames: u64,
    /// Dropped transmissions, counted per client: full buffer or missing device.
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
    /// Name of each link, true if it is a CAN bus, and its data.
    pub links: Vec<(String, bool, Handed)>,
}

impl SampleReport {
    /// The line, with the end in source time.
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

/// Queue of reports to the peer that subscribed.
#[derive(Debug)]
pub(super) struct Reports {
    is_wanted: AtomicBool,
    sender: Sender<String>,
    /// `None` once the writing task has taken it.
    receiver: Mutex<Option<Receiver<String>>>,
    /// Destination of datagrams.
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
    /// The receiver, on the first call.
    pub fn receiver(&self) -> Option<Receiver<String>> {
        self.receiver.lock().expect("no holder panics").take()
    }

    /// Starts reports to a peer.
    pub fn subscribe(&self, peer: Option<SocketAddr>) {
        *self.peer() = peer;
        self.is_wanted.store(true, Relaxed);
    }

    /// Stops reports.
    pub fn unsubscribe(&self) {
        self.is_wanted.store(false, Relaxed);
    }

    pub fn is_wanted(&self) -> bool {
        self.is_wanted.load(Relaxed)
    }

    pub fn peer(&self) -> MutexGuard<'_, Option<SocketAddr>> {
        self.peer.lock().expect("no holder panics")
    }

    /// Queues a report without waiting.
    pub fn push(&self, report: &SampleReport, source_s: f64) {
        match self.sender.try_send(report.line(source_s)) {
            Ok(()) => self.sent.fetch_add(1, Relaxed),
            Err(_) => self.dropped.fetch_add(1, Relaxed),
        };
    }

    /// Counts a queued report that was not written as dropped.
    pub fn count_lost(&self) {
        self.sent.fetch_sub(1, Relaxed);
        self.dropped.fetch_add(1, Relaxed);
    }

    /// Numbers of reports queued and dropped.
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
    fn a_report_counts_bytes_or_frames_of_each_link() {
        let line: Value = serde_json::from_str(&report(3).line(100.5)).expect("JSON");
        let expected = json!({
            "half_second": 3, "t_s": 100.5, "sequence": 7, "clock_count": 500_000,
            "sent": { "tcp 127.0.0.1:1": { "bytes": 28, "dropped": 1 }, "can vcan0": { "frames": 3, "dropped": 1 } },
        });
        assert_eq!(line, expected);
    }

    #[test]
    fn unread_reports_are_counted_and_dropped() {
        let reports = Reports::default();
        (0..3000).for_each(|index| reports.push(&report(index), 0.0));
        assert_eq!(reports.counts(), (QUEUE as u64, 3000 - QUEUE as u64));
    }
}
