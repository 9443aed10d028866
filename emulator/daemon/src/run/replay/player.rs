//! The thread that keeps the time of a recording.

use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use geu_model::fault::acting::{FaultEngine, FaultEvent};
use geu_model::fault::expression::ConditionInputs;
use geu_model::units::{SAMPLE_INTERVAL_NS, on_board_s};
use geu_protocol::field::unit_flag;
use geu_protocol::{CanFrame, CanIdMap, Sample};

use super::item::{ReplayItem, ReplayItemKind, ReplayOptions, Steps, TrafficOrigin};
use crate::cadence::{DeadlineTimer, doze_until, now_ns};
use crate::console;
use crate::lateness::DurationNs;
use crate::link_model::{Encoding, LinkModel, Transmission, WireData};
use crate::run::output::LinkOutput;
use crate::run::session::{LEAD_NS, Session};

/// A process held up for so long goes on from where it stood: what it did not send then is not sent in a burst.
const HELD_UP_NS: i64 = 1_000_000_000;
/// Between two looks whether to stop, where a recording or a step is waited for.
const WAIT: Duration = Duration::from_millis(50);

/// What was done, for the end.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Counts {
    pub samples: u64,
    /// Of these, with a fault of links acting.
    pub faulted: u64,
    /// Frames of the unit that a link of bytes could not carry.
    pub unit_frames: u64,
    /// Bytes that a CAN interface could not carry.
    pub unit_bytes: u64,
    /// Commands and other traffic that a link of the other form could not carry.
    pub other: u64,
    /// How often the process was held up.
    pub held_up: u64,
}

pub(super) struct Player {
    pub links: Vec<LinkOutput>,
    pub faults: FaultEngine,
    pub counts: Counts,
    /// The sample sent last, for the status line.
    pub shown: Arc<Mutex<Option<Sample>>>,
    items: Receiver<Vec<ReplayItem>>,
    steps: Option<Steps>,
    /// Samples that may go out before another step.
    allowed: u64,
    recorded_plan: CanIdMap,
    session: Session,
    /// Index of the sample that comes next.
    frame: u64,
    last: Option<Sample>,
    /// Of each link: whether the sample told last goes out as the link writes it, not as it was recorded.
    is_written_anew: Vec<bool>,
    start_ns: i64,
}

impl Player {
    pub fn new(
        settings: &ReplayOptions,
        links: Vec<LinkOutput>,
        items: Receiver<Vec<ReplayItem>>,
        steps: Option<Steps>,
        session: Session,
    ) -> Player {
        Player {
            is_written_anew: vec![false; links.len()],
            links,
            faults: FaultEngine::new(&settings.plan),
            counts: Counts::default(),
            shown: Arc::default(),
            items,
            steps,
            allowed: 0,
            recorded_plan: settings.recorded_plan,
            session,
            frame: 0,
            last: None,
            start_ns: 0,
        }
    }

    /// Plays until the items are over, or it is stopped.
    pub fn play(&mut self) {
        let timer = DeadlineTimer::new(Duration::ZERO);
        self.session.await_client(&self.links);
        self.start_ns = now_ns();
        let last_ns = self.play_items(&timer);
        self.session.end_links(&mut self.links, last_ns);
    }

    /// Plays the items; when the last one was due.
    fn play_items(&mut self, timer: &DeadlineTimer) -> i64 {
        let mut last_ns = 0;
        loop {
            let batch = match self.items.recv_timeout(WAIT) {
                Ok(batch) => batch,
                Err(RecvTimeoutError::Timeout) if !self.is_stopped() => continue,
                Err(_) => return last_ns,
            };
            for item in batch {
                self.send_held(item.played_ns - 1, timer);
                self.wait_until(item.played_ns, timer);
                if self.is_stopped() {
                    return last_ns;
                }
                last_ns = item.played_ns;
                let is_content = matches!(item.what, ReplayItemKind::Content(..));
                if !self.take(item) {
                    return last_ns;
                }
                if is_content && let Some(deadline_ns) = self.wall_ns(last_ns) {
                    self.session.monitor.record(now_ns() - deadline_ns);
                }
            }
        }
    }

    fn is_stopped(&self) -> bool {
        self.session.is_stopped()
    }

    fn wall_ns(&self, played_ns: i64) -> Option<i64> {
        self.session.speed.wall_ns(played_ns).map(|wall_ns| self.start_ns.saturating_add(wall_ns))
    }

    fn wait_until(&mut self, played_ns: i64, timer: &DeadlineTimer) {
        let Some(deadline_ns) = self.wall_ns(played_ns) else { return };
        while !self.is_stopped() && now_ns() < deadline_ns - LEAD_NS {
            doze_until(deadline_ns - LEAD_NS);
        }
        if !self.is_stopped() {
            timer.sleep_until(deadline_ns);
        }
        let late_ns = now_ns() - deadline_ns;
        if late_ns > HELD_UP_NS && !self.session.speed.is_faster_than_real() {
            self.counts.held_up += 1;
            self.start_ns += late_ns;
            let late = DurationNs(late_ns as u64);
            console::say(format_args!("held up for about {late}; the recording goes on where it stood"));
        }
    }

    /// Sends, each at its time, what a fault holds back until then.
    fn send_held(&mut self, until_ns: i64, timer: &DeadlineTimer) {
        let next = |links: &[LinkOutput]| links.iter().filter_map(|output| output.queue.next_ns()).min();
        while let Some(due_ns) = next(&self.links).filter(|&due_ns| due_ns <= until_ns) {
            self.wait_until(due_ns, timer);
            if self.is_stopped() {
                return;
            }
            let patience = self.session.patience();
            self.links.iter_mut().for_each(|output| output.send_due(due_ns, &patience));
        }
    }

    /// Takes an item whose time has come; false when no more is to be sent.
    fn take(&mut self, item: ReplayItem) -> bool {
        match item.what {
            ReplayItemKind::Note(text) => console::say(text),
            ReplayItemKind::Sample { sample, is_can } => {
                if !self.is_allowed() {
                    return false;
                }
                self.begin(&sample, is_can, &item);
            }
            ReplayItemKind::Content(content, whose) => self.send(&content, whose, item.played_ns),
        }
        true
    }

    /// Waits for a step where there are steps; false when none comes any more.
    fn is_allowed(&mut self) -> bool {
        let Some(steps) = &self.steps else { return true };
        while self.allowed == 0 {
            if let Some(last) = &self.last
                && matches!(steps.try_recv().map(|step| self.allowed += step), Err(TryRecvError::Empty))
            {
                let (done, sequence) = (self.counts.samples, last.sequence);
                console::say(format_args!("{done} samples sent, the last of sequence {sequence}"));
            }
            while self.allowed == 0 {
                match steps.recv_timeout(WAIT) {
                    Ok(step) => self.allowed += step,
                    Err(RecvTimeoutError::Timeout) if !self.session.is_stopped() => {}
                    Err(_) => return false,
                }
            }
        }
        self.allowed -= 1;
        true
    }

    /// A sample begins: decides what faults do to it, and sends it over links that write it themselves.
    fn begin(&mut self, sample: &Sample, is_can: bool, item: &ReplayItem) {
        // Where the recording has a gap, the faults have it too; samples a little long or short make none.
        let by_time = item.recorded_ns.max(0).saturating_add(SAMPLE_INTERVAL_NS / 2) / SAMPLE_INTERVAL_NS;
        let frame = if by_time as u64 > self.frame + 1 { by_time as u64 } else { self.frame };
        self.frame = frame + 1;
        if !self.faults.is_empty() {
            self.faults.begin(&mut self.moment(sample, frame), self.last);
            self.faults.take_happened().iter().for_each(tell);
        }
        let acting = self.faults.acting().clone();
        let (patience, mut is_faulted) = (self.session.patience(), false);
        for (output, is_written_anew) in self.links.iter_mut().zip(&mut self.is_written_anew) {
            let model = output.link.info().model.clone();
            let is_touched = !model.touching(&acting).is_empty();
            is_faulted |= is_touched;
            // What was held back for this sample comes before or behind all of it, never between its frames.
            output.queue.put(Vec::new(), frame, item.played_ns);
            let waits = output.queue.is_within_frame()
                || output.queue.next_ns().is_some_and(|due_ns| due_ns <= item.played_ns + 1);
            *is_written_anew = is_touched || waits || is_can != is_bus(&model);
            if *is_written_anew {
                output.put(Some(sample), frame, item.played_ns, &acting);
                output.send_due(item.played_ns, &patience);
            }
        }
        self.counts.samples += 1;
        self.counts.faulted += u64::from(is_faulted);
        self.last = Some(*sample);
        *self.shown.lock().expect("nothing panics with it") = self.last;
    }

    /// What is known at the start of a sample interval; the rates are not.
    fn moment(&self, sample: &Sample, frame: u64) -> ConditionInputs {
        let last = self.last.unwrap_or_default();
        ConditionInputs {
            t_s: on_board_s(frame),
            frame,
            sequence: sample.sequence,
            rate_arcsec_s: [f64::NAN; 3],
            theta_deg: f64::NAN,
            psi_deg: f64::NAN,
            electronics_c: f64::from(sample.electronics_centi_c) / 100.0,
            sensor_c: f64::from(sample.sensor_centi_c) / 100.0,
            is_polled: sample.unit_flags & unit_flag("polled") != 0,
            increments: last.increments,
            gyro_flags: last.gyro_flags,
            ..ConditionInputs::default()
        }
    }

    /// Sends a content as it was recorded, over links of its form.
    fn send(&mut self, content: &WireData, whose: TrafficOrigin, played_ns: i64) {
        let is_can = matches!(content, WireData::Frame(_));
        let (patience, acting) = (self.session.patience(), self.faults.acting().clone());
        let mut is_left_out = false;
        for (output, is_written_anew) in self.links.iter_mut().zip(&self.is_written_anew) {
            let model = &output.link.info().model;
            if whose == TrafficOrigin::Sample && *is_written_anew
                || whose == TrafficOrigin::Unit && model.blocks_samples(&acting)
            {
                continue;
            }
            if is_can != is_bus(model) {
                is_left_out = true;
                continue;
            }
            let moved = moved(content, whose, self.recorded_plan, model);
            // Behind a frame that has begun, should there be one.
            output.queue.put(vec![Transmission::on_time(0, moved)], self.frame.saturating_sub(1), played_ns);
            output.send_due(played_ns, &patience);
        }
        if is_left_out {
            match (whose, content) {
                (TrafficOrigin::Unit | TrafficOrigin::Sample, WireData::Frame(_)) => self.counts.unit_frames += 1,
                (TrafficOrigin::Unit | TrafficOrigin::Sample, WireData::Bytes(bytes)) => {
                    self.counts.unit_bytes += bytes.len() as u64
                }
                _ => self.counts.other += 1,
            }
        }
    }
}

fn is_bus(model: &LinkModel) -> bool {
    matches!(model.encoding, Encoding::Can(_))
}

/// A message of the unit with the identifier that it has on this link.
fn moved(content: &WireData, whose: TrafficOrigin, recorded: CanIdMap, model: &LinkModel) -> WireData {
    match (content, model.encoding) {
        (WireData::Frame(frame), Encoding::Can(plan)) if whose != TrafficOrigin::Other => {
            let id = frame.id().saturating_sub(recorded.base()).saturating_add(plan.base());
            WireData::Frame(CanFrame::new(id, frame.data()).unwrap_or(*frame))
        }
        _ => content.clone(),
    }
}

fn tell(happening: &FaultEvent) {
    match happening {
        FaultEvent::Started(fault) => console::say(format_args!("{} acts: {}", fault.id, fault.action.name())),
        FaultEvent::Ended(fault, count) => {
            console::say(format_args!("{} is over after {} s", fault.id, on_board_s(*count)));
        }
        // Told at the end.
        FaultEvent::Decided(_) => {}
    }
}
