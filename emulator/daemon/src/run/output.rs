//! The links of a run on the cadence thread, with the transmissions that wait for them.

use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use geu_model::CompletedSample;
use geu_model::fault::catalogue::Transport;
use geu_model::fault::engine::ActiveFault;

use super::session::Session;
use crate::cadence::DeadlineTimer;
use crate::host::now_ns;
use crate::link::Link;
use crate::patience::{LAST_WORDS, Patience};
use crate::truth::Handed;
use geu_recorder::link_model::{TransmitQueue, WireData};

/// The links of a run, and the clock of its on-board time.
pub(super) struct TimedLinks {
    pub session: Session,
    pub outputs: Vec<LinkOutput>,
    pub timer: DeadlineTimer,
    pub patience: Patience,
    /// Start of on-board time on the monotonic clock, ns.
    pub start_ns: i64,
}

impl TimedLinks {
    /// On the cadence thread: the timer is its own.
    pub fn new(session: Session, outputs: Vec<LinkOutput>, spin: Duration) -> TimedLinks {
        let patience = session.patience();
        TimedLinks { session, outputs, timer: DeadlineTimer::new(spin), patience, start_ns: 0 }
    }

    pub fn start(&mut self) {
        self.start_ns = now_ns();
    }

    /// Converts on-board time to the monotonic clock; `None` without deadlines.
    pub fn wall_ns(&self, on_board_ns: i64) -> Option<i64> {
        self.session.speed.wall_ns(on_board_ns).map(|wall_ns| self.start_ns.saturating_add(wall_ns))
    }

    /// Earliest time of a waiting transmission, on-board time.
    pub fn next_due_ns(&self) -> Option<i64> {
        self.outputs.iter().filter_map(|output| output.queue.next_ns()).min()
    }

    /// Sends the transmissions that are due by `until_ns`.
    pub fn send_due(&mut self, until_ns: i64) {
        self.outputs.iter_mut().for_each(|output| output.send_due(until_ns, &self.patience));
    }

    /// Sends at once, in order, the transmissions that faults delay; the last sample ended at `end_ns`.
    pub fn end(&mut self, end_ns: i64) {
        let patience = self.patience.clone().at_least(LAST_WORDS);
        for output in &mut self.outputs {
            output.queue.end(end_ns);
            output.send_due(i64::MAX, &patience);
            output.link.send_answers();
        }
    }
}

/// A link with its queue.
pub(crate) struct LinkOutput {
    pub link: Box<dyn Link>,
    pub queue: TransmitQueue,
    /// Encoded for the deadline, and whether it ends within a frame.
    prepared: Option<(Vec<WireData>, bool)>,
    /// Data passed to the link since the last report.
    handed: Handed,
}

impl LinkOutput {
    pub fn new(link: Box<dyn Link>, interval_ns: i64) -> LinkOutput {
        LinkOutput { link, queue: TransmitQueue::new(interval_ns), prepared: None, handed: Handed::default() }
    }

    pub fn has_client(&self) -> bool {
        self.link.info().statistics.clients.load(Relaxed) > 0
    }

    /// Adds a sample, `None` if none is sent.
    pub fn put(&mut self, sample: Option<&CompletedSample>, frame: u64, end_ns: i64, acting: &[ActiveFault]) {
        let transmissions = self.link.info().model.carry(sample, frame, acting);
        self.queue.put(transmissions, frame, end_ns);
    }

    /// Sends the transmissions due before `end_ns`, and prepares those due at `end_ns`.
    pub fn prepare(&mut self, end_ns: i64, patience: &Patience) {
        self.send_due(end_ns - 1, patience);
        self.prepared = self.next_due(end_ns);
    }

    pub fn send_prepared(&mut self, patience: &Patience) {
        if let Some((data, more_fragments)) = self.prepared.take() {
            self.send(&data, more_fragments, patience);
        }
    }

    pub fn send_due(&mut self, until_ns: i64, patience: &Patience) {
        while let Some((data, more_fragments)) = self.next_due(until_ns) {
            self.send(&data, more_fragments, patience);
        }
    }

    fn next_due(&mut self, until_ns: i64) -> Option<(Vec<WireData>, bool)> {
        let (_, data) = self.queue.next_due(until_ns)?;
        Some((data, self.queue.is_within_frame()))
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

    /// Name of the link, whether it is a CAN bus, and the data passed to it since the last call.
    pub fn take_handed(&mut self) -> (String, bool, Handed) {
        let is_can = self.link.info().model.kind == Transport::Can;
        (self.link.info().statistics.name.clone(), is_can, std::mem::take(&mut self.handed))
    }
}
