//! From records to items: contents with order and time, and the samples in them. Serial bytes are in `bytes.rs`.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::SyncSender;

use geu_daemon::replay::{ReplayItem, ReplayItemKind, TrafficOrigin};
use geu_model::device::Device;
use geu_protocol::can::{Assembler, AssemblerEvent, Role};
use geu_protocol::capture::CaptureRecord;
use geu_protocol::{CanFrame, Sample};
use geu_recorder::link_model::WireData;
use geu_recording::Sink;

use crate::ReplaySelection;
use crate::clock::ReplayClock;
use crate::frames::{Finder, Samples};
use crate::report::ReplayReport;

/// Items of a batch.
const BATCH: usize = 64;
/// Batches without a sample before the start is signalled; fewer than the capacity of the queue.
const MAX_SILENT_BATCHES: usize = crate::QUEUE / 2;
/// Largest number of frames that wait for a complete sample, or for the unit on an interface.
const MAX_WAITING: usize = 4096;

#[derive(Debug, Clone)]
struct Waiting {
    frame: CanFrame,
    role: Role,
    time_ns: Option<i64>,
    is_complete: bool,
    /// The sample that starts with it.
    begins: Option<Sample>,
}

/// Converts read records to items, and sends them to a queue.
pub struct ReplaySource {
    selection: ReplaySelection,
    sender: SyncSender<Vec<ReplayItem>>,
    /// Signals the start; `None` after that.
    begins: Option<SyncSender<()>>,
    batch: Vec<ReplayItem>,
    pub(crate) clock: ReplayClock,
    report: ReplayReport,
    /// Sum of the recorded times of earlier passes, ns.
    passed_ns: i64,
    /// First and last sent time in this pass, and that of the last sample, ns.
    span_ns: Option<(i64, i64)>,
    last_sample_ns: i64,
    is_after: bool,
    is_disconnected: bool,
    /// True after a record of a capture, or a serial frame.
    pub(crate) has_frame: bool,
    has_sample: bool,
    /// True after an item that a link sends.
    is_carried: bool,
    handed_over: usize,
    /// Frames before an interface is selected.
    early: Vec<(Vec<u8>, Waiting)>,
    interface: Option<Vec<u8>>,
    assembler: Assembler<u64>,
    waiting: VecDeque<Waiting>,
    /// Number of the first frame that waits, and of the last INCREMENTS.
    first: u64,
    increments: u64,
    pub(crate) device: Arc<Device>,
    /// Messages of a described unit.
    messages: Option<Samples>,
    pub(crate) finder: Finder,
    /// Bytes that are not yet sent, and the offset of the first.
    pub(crate) bytes: Vec<u8>,
    pub(crate) offset: u64,
}

impl ReplaySource {
    pub fn new(
        selection: ReplaySelection,
        sender: SyncSender<Vec<ReplayItem>>,
        begins: SyncSender<()>,
    ) -> ReplaySource {
        let device = selection.device.clone();
        ReplaySource {
            clock: ReplayClock::new(device.interval_ns(), selection.longest_gap_ns),
            interface: selection.interface.clone(),
            selection,
            sender,
            begins: Some(begins),
            batch: Vec::new(),
            report: ReplayReport::default(),
            passed_ns: 0,
            span_ns: None,
            last_sample_ns: 0,
            is_after: false,
            is_disconnected: false,
            has_frame: false,
            has_sample: false,
            is_carried: false,
            handed_over: 0,
            early: Vec::new(),
            assembler: Assembler::default(),
            waiting: VecDeque::new(),
            first: 0,
            increments: 0,
            messages: messages(&device),
            finder: Finder::new(&device),
            device,
            bytes: Vec::new(),
            offset: 0,
        }
    }

    /// True if no further item of this pass is sent.
    pub fn is_over(&self) -> bool {
        self.is_after || self.is_disconnected
    }

    /// True if the receiver is closed.
    pub fn is_disconnected(&self) -> bool {
        self.is_disconnected
    }

    /// Ends a pass; true if a link sent an item of it. The next pass starts a sample interval after its last sample.
    pub fn end_pass(&mut self) -> bool {
        if self.interface.is_none()
            && let Some((interface, _)) = self.early.first()
        {
            self.select_interface(interface.clone());
        }
        self.assembler = Assembler::default();
        self.messages = messages(&self.device);
        self.send_waiting(0);
        self.end_bytes();
        self.report.length_ns = self.report.length_ns.max(self.clock.recorded_ns);
        let span_ns = self.span_ns.take();
        self.clock.rewind();
        self.interface = self.selection.interface.clone();
        self.is_after = false;
        if let Some((first_ns, last_ns)) = span_ns {
            self.passed_ns =
                self.passed_ns.saturating_add(last_ns - first_ns).saturating_add(self.device.interval_ns());
            let next_ns = self.last_sample_ns.saturating_add(self.device.interval_ns());
            self.clock.played_ns = self.clock.played_ns.max(next_ns);
        }
        // The reader refuses an input without any frame.
        self.has_frame = true;
        self.hand_over();
        span_ns.is_some() && self.is_carried
    }

    /// The report; `is_stopped`: reading ended before the recording.
    pub fn finish(mut self, is_stopped: bool) -> ReplayReport {
        self.report.anomalies = self.clock.anomalies;
        self.report.nothing_carried = !self.is_carried && !self.is_disconnected && !is_stopped;
        self.report
    }

    /// Signals that there are items to send.
    pub fn begin(&mut self) {
        if let Some(begins) = self.begins.take() {
            let _ = begins.send(());
        }
    }

    fn hand_over(&mut self) {
        // Bytes wait for the first frame: without one the input is not a recording.
        if self.batch.is_empty() || self.is_disconnected || !self.has_frame {
            return;
        }
        self.handed_over += 1;
        if self.has_sample || self.handed_over >= MAX_SILENT_BATCHES {
            self.begin();
        }
        self.is_disconnected = self.sender.send(std::mem::take(&mut self.batch)).is_err();
    }

    /// Sends an item at the present time if it is selected.
    pub(crate) fn send(&mut self, what: ReplayItemKind) {
        let recorded_ns = self.clock.recorded_ns;
        self.is_after |= recorded_ns >= self.selection.to_ns;
        if recorded_ns < self.selection.from_ns || self.is_over() {
            return;
        }
        if self.selection.is_only
            && matches!(what, ReplayItemKind::Content(_, TrafficOrigin::Command | TrafficOrigin::Other))
        {
            return;
        }
        self.clock.is_playing = true;
        self.span_ns.get_or_insert((recorded_ns, recorded_ns)).1 = recorded_ns;
        let (carries_frames, carries_bytes) = self.selection.carries;
        self.is_carried |= match &what {
            ReplayItemKind::Sample { is_can, .. } => {
                self.last_sample_ns = self.clock.played_ns;
                self.has_sample = true;
                // The other encoding is made anew, of the default unit alone.
                self.device.is_iras() || if *is_can { carries_frames } else { carries_bytes }
            }
            ReplayItemKind::Content(WireData::Frame(_), _) => carries_frames,
            ReplayItemKind::Content(WireData::Bytes(_), _) => carries_bytes,
            ReplayItemKind::Note(_) => false,
        };
        let played_ns = self.clock.played_ns;
        self.batch.push(ReplayItem { recorded_ns: self.passed_ns.saturating_add(recorded_ns), played_ns, what });
        if self.batch.len() >= BATCH {
            self.hand_over();
        }
    }

    pub(crate) fn note(&mut self, note: Option<String>) {
        if let Some(note) = note {
            self.send(ReplayItemKind::Note(note));
        }
    }

    /// Selects an interface; waiting frames of others are dropped.
    fn select_interface(&mut self, interface: Vec<u8>) {
        for (own, waiting) in std::mem::take(&mut self.early) {
            if own == interface { self.push(waiting) } else { self.report.elsewhere += 1 }
        }
        self.interface = Some(interface);
    }

    fn push(&mut self, mut waiting: Waiting) {
        if let Some(messages) = &mut self.messages {
            if waiting.role != Role::Other {
                (waiting.begins, waiting.is_complete) = messages.begin(&waiting.frame);
            }
            self.waiting.push_back(waiting);
            return self.send_waiting(0);
        }
        let number = self.first + self.waiting.len() as u64;
        let (role, frame) = (waiting.role, waiting.frame);
        self.waiting.push_back(waiting);
        if role == Role::Increments {
            self.increments = number;
        }
        let mut complete = None;
        self.assembler.push(role, number, frame.data(), &mut |assembled| {
            if let AssemblerEvent::Row(row) = assembled {
                complete = Some(row).filter(|row| row.has_clock);
            }
        });
        if let Some(row) = complete
            && let Some(begin) = row.stamp.checked_sub(self.first).map(|begin| begin as usize)
            && begin < self.waiting.len()
        {
            // INCREMENTS, the last STATUS after it, and CLOCK, the present frame.
            let status = self.waiting.iter().rposition(|waiting| waiting.role == Role::Status).unwrap_or(begin);
            for index in [begin, status, self.waiting.len() - 1] {
                self.waiting[index].is_complete = true;
            }
            self.waiting[begin].begins = Some(row.sample);
        }
        let kept = if self.assembler.is_waiting() { number + 1 - self.increments } else { 0 };
        self.send_waiting(if kept as usize > MAX_WAITING { 0 } else { kept as usize });
    }

    /// Sends all waiting frames but the last `kept`.
    fn send_waiting(&mut self, kept: usize) {
        while self.waiting.len() > kept
            && let Some(waiting) = self.waiting.pop_front()
        {
            self.first += 1;
            let note = match (waiting.time_ns, &waiting.begins) {
                (Some(time_ns), _) => self.clock.stamp(time_ns),
                (None, Some(sample)) => self.clock.step(self.clock.by_clock(sample)),
                (None, None) => None,
            };
            self.note(note);
            if let Some(sample) = waiting.begins {
                self.clock.update(&sample);
                self.send(ReplayItemKind::Sample { sample, is_can: true });
            }
            let origin = match waiting.role {
                _ if waiting.is_complete => TrafficOrigin::Sample,
                Role::Other => TrafficOrigin::Other,
                Role::Command => TrafficOrigin::Command,
                _ => TrafficOrigin::Unit,
            };
            self.send(ReplayItemKind::Content(WireData::Frame(waiting.frame), origin));
        }
    }
}

/// Finds the samples of a described unit in its messages.
fn messages(device: &Device) -> Option<Samples> {
    device.can.as_ref().map(|can| Samples::new(&can.frames))
}

impl<R> Sink<R> for ReplaySource {
    fn record(&mut self, event: &CaptureRecord) {
        self.has_frame = true;
        let classic = match event {
            CaptureRecord::Frame(frame) => match (frame.extended, &self.messages) {
                (false, _) => u16::try_from(frame.id).ok().and_then(|id| CanFrame::new(id, frame.data)),
                (true, Some(_)) => CanFrame::extended(frame.id, frame.data),
                (true, None) => None,
            }
            .map(|classic| (frame, classic)),
            CaptureRecord::Remote | CaptureRecord::Fd | CaptureRecord::Error | CaptureRecord::Line(_) => None,
            CaptureRecord::Broken { .. } => {
                self.report.broken += 1;
                return;
            }
            CaptureRecord::Remark | CaptureRecord::Dropped(_) => return,
        };
        let Some((frame, classic)) = classic else {
            self.report.other_frames += 1;
            return;
        };
        let role = match &self.messages {
            Some(messages) if messages.has(frame.id, frame.extended) => Role::Increments,
            Some(_) => Role::Other,
            None => self.selection.plan.role(frame.id),
        };
        let waiting = Waiting {
            frame: classic,
            role,
            time_ns: frame.time.map(|time| time.t_ns),
            is_complete: false,
            begins: None,
        };
        match &self.interface {
            Some(interface) if interface == frame.interface => self.push(waiting),
            Some(_) => self.report.elsewhere += 1,
            None => {
                self.early.push((frame.interface.to_vec(), waiting));
                if matches!(role, Role::Increments | Role::Status | Role::Clock) {
                    self.select_interface(frame.interface.to_vec());
                } else if self.early.len() > MAX_WAITING {
                    self.select_interface(self.early[0].0.clone());
                }
            }
        }
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.push_bytes(bytes);
    }

    fn row(&mut self, _row: &R) {}

    fn flush(&mut self) {
        self.hand_over();
    }

    fn is_closed(&self) -> bool {
        self.is_over()
    }
}
