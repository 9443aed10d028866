//! A link and the transmissions that wait for it, on the cadence thread.

use std::sync::atomic::Ordering::Relaxed;

use geu_model::fault::acting::ActiveFault;
use geu_model::fault::catalogue::Transport;
use geu_protocol::Sample;

use crate::link::Link;
use crate::link_model::{TransmitQueue, WireData};
use crate::patience::Patience;
use crate::truth::Handed;

/// A link, and what waits for its time.
pub(super) struct LinkOutput {
    pub link: Box<dyn Link>,
    pub queue: TransmitQueue,
    /// Encoded for the deadline, and whether it ends within a frame.
    prepared: Option<(Vec<WireData>, bool)>,
    /// What was sent since that was asked last.
    handed: Handed,
}

impl LinkOutput {
    pub fn new(link: Box<dyn Link>) -> LinkOutput {
        LinkOutput { link, queue: TransmitQueue::default(), prepared: None, handed: Handed::default() }
    }

    pub fn has_client(&self) -> bool {
        self.link.info().statistics.clients.load(Relaxed) > 0
    }

    /// Adds a sample, `None` where none is sent.
    pub fn put(&mut self, sample: Option<&Sample>, frame: u64, end_ns: i64, acting: &[ActiveFault]) {
        let transmissions = self.link.info().model.carry(sample, frame, acting);
        self.queue.put(transmissions, frame, end_ns);
    }

    /// Sends what was due before, and takes what is due at `end_ns` from the queue.
    pub fn prepare(&mut self, end_ns: i64, patience: &Patience) {
        self.send_due(end_ns - 1, patience);
        self.prepared = self.take(end_ns);
    }

    /// What is due next, where that is not after `until_ns`.
    fn take(&mut self, until_ns: i64) -> Option<(Vec<WireData>, bool)> {
        let (_, data) = self.queue.take(until_ns)?;
        Some((data, self.queue.is_within_frame()))
    }

    /// Sends what was prepared.
    pub fn send_prepared(&mut self, patience: &Patience) {
        if let Some((data, more_fragments)) = self.prepared.take() {
            self.send(&data, more_fragments, patience);
        }
    }

    fn send(&mut self, data: &[WireData], more_fragments: bool, patience: &Patience) {
        let statistics = self.link.info().statistics.clone();
        let (sent, dropped) = (statistics.sent.load(Relaxed), statistics.dropped.load(Relaxed));
        self.link.send(data, more_fragments, patience);
        if statistics.sent.load(Relaxed) > sent {
            for data in data {
                match data {
                    WireData::Bytes(bytes) => self.handed.bytes += bytes.len() as u64,
                    WireData::Frame(_) => self.handed.frames += 1,
                }
            }
        }
        self.handed.dropped += statistics.dropped.load(Relaxed) - dropped;
    }

    /// What the link was handed since this was asked last: its name, whether it is a CAN bus, and how much.
    pub fn take_handed(&mut self) -> (String, bool, Handed) {
        let is_can = self.link.info().model.kind == Transport::Can;
        (self.link.info().statistics.name.clone(), is_can, std::mem::take(&mut self.handed))
    }

    pub fn forget_handed(&mut self) {
        self.handed = Handed::default();
    }

    /// Sends what is due by then: all that a fault has held back until now.
    pub fn send_due(&mut self, until_ns: i64, patience: &Patience) {
        while let Some((data, more_fragments)) = self.take(until_ns) {
            self.send(&data, more_fragments, patience);
        }
    }

    /// Sends at once, in order, what faults still hold back when the run ends; its last sample ended at `end_ns`.
    pub fn end(&mut self, end_ns: i64, patience: &Patience) {
        self.queue.end(end_ns);
        self.send_due(i64::MAX, patience);
        self.link.send_answers();
    }
}
