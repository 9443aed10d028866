//! From what a recording holds to what is sent: contents in their order and time, and which of them make a sample.

use std::collections::VecDeque;
use std::sync::mpsc::SyncSender;

use geu_daemon::link_model::WireData;
use geu_daemon::replay::{ReplayItem, ReplayItemKind, TrafficOrigin};
use geu_model::units::SAMPLE_INTERVAL_NS;
use geu_protocol::can::{Assembler, AssemblerEvent, Role};
use geu_protocol::capture::CaptureRecord;
use geu_protocol::serial::{
    BITS_PER_BYTE, DEFAULT_BAUD, Deframer, DeframerEvent, FrameType, MAX_FRAME, OVERHEAD, read_data,
};
use geu_protocol::{CanFrame, Sample};
use geu_recording::{Defect, ReceivedSample, Sink};

use crate::ReplaySelection;
use crate::clock::ReplayClock;
use crate::report::ReplayReport;

/// Items handed over at once.
const BATCH: usize = 64;
/// Batches handed over before it is told that there is something to send: less than may wait.
const MAX_SILENT_BATCHES: usize = crate::QUEUE / 2;
/// Frames that wait for their sample to be whole, or for the unit to show up on an interface.
const MAX_WAITING: usize = 4096;
/// Bytes without a frame that are kept for the next frame to tell their time.
const MAX_STRAY: usize = 4096;

#[derive(Debug, Clone)]
struct Waiting {
    frame: CanFrame,
    role: Role,
    time_ns: Option<i64>,
    is_whole: bool,
    /// The sample that begins with it.
    begins: Option<Sample>,
}

/// Takes what is read, and hands it over to be sent.
pub struct ReplaySource {
    choice: ReplaySelection,
    sender: SyncSender<Vec<ReplayItem>>,
    /// ReplayReport once that there is something to send.
    begins: Option<SyncSender<()>>,
    batch: Vec<ReplayItem>,
    clock: ReplayClock,
    report: ReplayReport,
    /// What the time stamps of passes before add up to, ns.
    passed_ns: i64,
    /// First and last in this pass that was sent, and the last sample, ns.
    span_ns: Option<(i64, i64)>,
    last_sample_ns: i64,
    is_after: bool,
    is_disconnected: bool,
    /// Whether anything was found that makes a recording of it: a record of a capture, or a serial frame.
    has_frame: bool,
    has_sample: bool,
    /// Whether anything was sent that a link carries.
    is_carried: bool,
    handed_over: usize,
    /// Before an interface is chosen.
    early: Vec<(Vec<u8>, Waiting)>,
    interface: Option<Vec<u8>>,
    assembler: Assembler<u64>,
    waiting: VecDeque<Waiting>,
    /// Number of the first frame that waits, and of the last INCREMENTS.
    first: u64,
    increments: u64,
    deframer: Deframer,
    /// Bytes that were not sent yet, and the offset of the first.
    bytes: Vec<u8>,
    offset: u64,
}

impl ReplaySource {
    pub fn new(choice: ReplaySelection, sender: SyncSender<Vec<ReplayItem>>, begins: SyncSender<()>) -> ReplaySource {
        ReplaySource {
            clock: ReplayClock::new(choice.longest_gap_ns),
            interface: choice.interface.clone(),
            choice,
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
            deframer: Deframer::default(),
            bytes: Vec::new(),
            offset: 0,
        }
    }

    /// Whether nothing more of this pass is sent.
    pub fn is_over(&self) -> bool {
        self.is_after || self.is_disconnected
    }

    /// Whether nobody takes any more.
    pub fn is_disconnected(&self) -> bool {
        self.is_disconnected
    }

    /// Ends a pass; whether anything of it was sent that a link carries. Another begins half a second behind its last sample.
    pub fn end_pass(&mut self) -> bool {
        if self.interface.is_none()
            && let Some((interface, _)) = self.early.first()
        {
            self.choose(interface.clone());
        }
        self.assembler = Assembler::default();
        self.send_waiting(0);
        self.end_bytes();
        self.report.length_ns = self.report.length_ns.max(self.clock.recorded_ns);
        let span_ns = self.span_ns.take();
        self.clock.rewind();
        self.interface = self.choice.interface.clone();
        self.is_after = false;
        if let Some((first_ns, last_ns)) = span_ns {
            self.passed_ns = self.passed_ns.saturating_add(last_ns - first_ns).saturating_add(SAMPLE_INTERVAL_NS);
            let next_ns = self.last_sample_ns.saturating_add(SAMPLE_INTERVAL_NS);
            self.clock.played_ns = self.clock.played_ns.max(next_ns);
        }
        // What is no recording at all is refused by its reader.
        self.has_frame = true;
        self.hand_over();
        span_ns.is_some() && self.is_carried
    }

    /// The report; `is_stopped` where reading ended before the recording did.
    pub fn finish(mut self, is_stopped: bool) -> ReplayReport {
        self.report.anomalies = self.clock.anomalies;
        self.report.nothing_carried = !self.is_carried && !self.is_disconnected && !is_stopped;
        self.report
    }

    /// Tells that there is something to send.
    pub fn begin(&mut self) {
        if let Some(begins) = self.begins.take() {
            let _ = begins.send(());
        }
    }

    fn hand_over(&mut self) {
        // Bytes alone may turn out to be no recording: they wait for the first frame.
        if self.batch.is_empty() || self.is_disconnected || !self.has_frame {
            return;
        }
        self.handed_over += 1;
        if self.has_sample || self.handed_over >= MAX_SILENT_BATCHES {
            self.begin();
        }
        self.is_disconnected = self.sender.send(std::mem::take(&mut self.batch)).is_err();
    }

    /// Sends something at the present time, unless that is not chosen.
    fn send(&mut self, what: ReplayItemKind) {
        let recorded_ns = self.clock.recorded_ns;
        self.is_after |= recorded_ns >= self.choice.to_ns;
        if recorded_ns < self.choice.from_ns || self.is_over() {
            return;
        }
        if self.choice.is_only
            && matches!(what, ReplayItemKind::Content(_, TrafficOrigin::Command | TrafficOrigin::Other))
        {
            return;
        }
        self.clock.is_playing = true;
        self.span_ns.get_or_insert((recorded_ns, recorded_ns)).1 = recorded_ns;
        let (carries_frames, carries_bytes) = self.choice.carries;
        self.is_carried |= match &what {
            ReplayItemKind::Sample { .. } => {
                self.last_sample_ns = self.clock.played_ns;
                self.has_sample = true;
                true
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

    fn note(&mut self, note: Option<String>) {
        if let Some(note) = note {
            self.send(ReplayItemKind::Note(note));
        }
    }

    /// Takes the frames of this interface; those of others that waited go.
    fn choose(&mut self, interface: Vec<u8>) {
        for (own, waiting) in std::mem::take(&mut self.early) {
            if own == interface { self.push(waiting) } else { self.report.elsewhere += 1 }
        }
        self.interface = Some(interface);
    }

    fn push(&mut self, waiting: Waiting) {
        let number = self.first + self.waiting.len() as u64;
        let (role, frame) = (waiting.role, waiting.frame);
        self.waiting.push_back(waiting);
        if role == Role::Increments {
            self.increments = number;
        }
        let mut whole = None;
        self.assembler.push(role, number, frame.data(), &mut |assembled| {
            if let AssemblerEvent::Row(row) = assembled {
                whole = Some(row).filter(|row| row.has_clock);
            }
        });
        if let Some(row) = whole
            && let Some(begin) = row.stamp.checked_sub(self.first).map(|begin| begin as usize)
            && begin < self.waiting.len()
        {
            // INCREMENTS, the last STATUS behind it, and CLOCK, which came now.
            let status = self.waiting.iter().rposition(|waiting| waiting.role == Role::Status).unwrap_or(begin);
            for index in [begin, status, self.waiting.len() - 1] {
                self.waiting[index].is_whole = true;
            }
            self.waiting[begin].begins = Some(row.sample);
        }
        let kept = if self.assembler.is_waiting() { number + 1 - self.increments } else { 0 };
        self.send_waiting(if kept as usize > MAX_WAITING { 0 } else { kept as usize });
    }

    /// Sends what waits, but for the last so many.
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
                self.clock.read(&sample);
                self.send(ReplayItemKind::Sample { sample, is_can: true });
            }
            let whose = match waiting.role {
                _ if waiting.is_whole => TrafficOrigin::Sample,
                Role::Other => TrafficOrigin::Other,
                Role::Command => TrafficOrigin::Command,
                _ => TrafficOrigin::Unit,
            };
            self.send(ReplayItemKind::Content(WireData::Frame(waiting.frame), whose));
        }
    }

    /// Sends bytes that belong to no frame, before a sample that follows by so much, and says how much is left of that.
    ///
    /// Where samples are missing these most likely are theirs: a frame's length for each, at its time.
    fn send_stray(&mut self, end: usize, until_next_ns: i64) -> i64 {
        let stray: Vec<u8> = self.bytes[..end].to_vec();
        let missing =
            (until_next_ns / SAMPLE_INTERVAL_NS - 1).clamp(0, stray.len().div_ceil(MAX_FRAME) as i64) as usize;
        let (mut rest, mut left_ns) = (&stray[..], until_next_ns);
        for index in 0..missing {
            let length = if index + 1 == missing { rest.len() } else { MAX_FRAME.min(rest.len()) };
            let (now, later) = rest.split_at(length);
            (rest, left_ns) = (later, left_ns - SAMPLE_INTERVAL_NS);
            let note = self.clock.step(SAMPLE_INTERVAL_NS);
            self.note(note);
            self.send(ReplayItemKind::Content(WireData::Bytes(now.to_vec()), TrafficOrigin::Unit));
        }
        if missing == 0 && !stray.is_empty() {
            let note = self.clock.step(left_ns);
            self.note(note);
            left_ns = 0;
            self.send(ReplayItemKind::Content(WireData::Bytes(stray), TrafficOrigin::Unit));
        }
        self.drop_bytes(end);
        left_ns
    }

    fn drop_bytes(&mut self, count: usize) {
        self.bytes.drain(..count);
        self.offset += count as u64;
    }

    fn send_frames(&mut self, frames: Vec<(u64, FrameType, usize, Option<Sample>)>) {
        // Taken out of the buffer once: a frame at a time it would be moved for each.
        let all = std::mem::take(&mut self.bytes);
        let (start, mut used) = (self.offset, 0);
        for (at, kind, length, sample) in frames {
            let begin = (at - start) as usize;
            self.bytes = all[used..begin].to_vec();
            let step_ns = sample.as_ref().map_or(0, |sample| self.clock.by_clock(sample));
            let left_ns = self.send_stray(begin - used, step_ns);
            let note = self.clock.step(left_ns);
            self.note(note);
            let whose = match (kind, sample) {
                (_, Some(sample)) => {
                    self.clock.read(&sample);
                    self.send(ReplayItemKind::Sample { sample, is_can: false });
                    TrafficOrigin::Sample
                }
                (FrameType::Command, _) => TrafficOrigin::Command,
                _ => TrafficOrigin::Unit,
            };
            used = begin + length;
            self.send(ReplayItemKind::Content(WireData::Bytes(all[begin..used].to_vec()), whose));
            self.offset = start + used as u64;
            if self.is_over() {
                break;
            }
        }
        self.bytes = all[used..].to_vec();
    }

    /// At the end what is left comes as if it were the next sample.
    fn end_bytes(&mut self) {
        if !self.is_over() {
            self.send_stray(self.bytes.len(), SAMPLE_INTERVAL_NS);
        }
        self.bytes.clear();
        (self.deframer, self.offset) = (Deframer::default(), 0);
    }
}

impl Sink for ReplaySource {
    fn record(&mut self, event: &CaptureRecord) {
        self.has_frame = true;
        let whole = match event {
            CaptureRecord::Frame(frame) if !frame.extended => {
                u16::try_from(frame.id).ok().and_then(|id| CanFrame::new(id, frame.data)).map(|whole| (frame, whole))
            }
            CaptureRecord::Frame(_) | CaptureRecord::Remote | CaptureRecord::Fd | CaptureRecord::Error => None,
            CaptureRecord::Broken { .. } => {
                self.report.broken += 1;
                return;
            }
            CaptureRecord::Remark | CaptureRecord::Dropped(_) => return,
        };
        let Some((frame, whole)) = whole else {
            self.report.other_frames += 1;
            return;
        };
        let role = self.choice.plan.role(frame.id);
        let waiting =
            Waiting { frame: whole, role, time_ns: frame.time.map(|time| time.t_ns), is_whole: false, begins: None };
        match &self.interface {
            Some(interface) if interface == frame.interface => self.push(waiting),
            Some(_) => self.report.elsewhere += 1,
            None => {
                self.early.push((frame.interface.to_vec(), waiting));
                if matches!(role, Role::Increments | Role::Status | Role::Clock) {
                    self.choose(frame.interface.to_vec());
                } else if self.early.len() > MAX_WAITING {
                    self.choose(self.early[0].0.clone());
                }
            }
        }
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
        let (mut frames, start) = (Vec::new(), (self.deframer.offset() - self.offset) as usize);
        self.deframer.consume(&self.bytes[start..], &mut |found| {
            if let DeframerEvent::Frame { at, kind, payload } = found {
                let sample = (kind == FrameType::Data).then(|| read_data(payload));
                frames.push((at, kind, OVERHEAD + payload.len(), sample));
            }
        });
        self.has_frame |= !frames.is_empty();
        self.send_frames(frames);
        // Bytes that no frame tells the time of take that of the line.
        let end = |source: &ReplaySource| (source.deframer.offset() - source.offset) as usize;
        while !self.is_over() && end(self) > MAX_STRAY {
            let line_ns = MAX_STRAY as i64 * i64::from(BITS_PER_BYTE) * 1_000_000_000 / i64::from(DEFAULT_BAUD);
            self.send_stray(MAX_STRAY, line_ns);
        }
    }

    fn row(&mut self, _row: &ReceivedSample) {}

    fn defect(&mut self, _defect: &Defect) {}

    fn flush(&mut self) {
        self.hand_over();
    }

    fn is_closed(&self) -> bool {
        self.is_over()
    }
}
