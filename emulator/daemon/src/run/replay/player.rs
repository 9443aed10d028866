//! The cadence thread of a replay.

use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use geu_model::CompletedSample;
use geu_model::fault::engine::{FaultEngine, FaultEvent};
use geu_model::fault::expression::ConditionInputs;
use geu_model::units::{SAMPLE_INTERVAL_NS, on_board_s};
use geu_protocol::field::unit_flag;
use geu_protocol::{CanIdMap, Sample};

use super::item::{ReplayItem, ReplayItemKind, ReplayOptions, Steps, TrafficOrigin};
use crate::cadence::doze_until;
use crate::console;
use crate::host::{self, now_ns};
use crate::lateness::DurationNs;
use crate::run::output::{LinkOutput, TimedLinks};
use crate::run::session::{LEAD_NS, Session};
use geu_recorder::link_model::{Encoding, LinkModel, Transmission, WireData};

/// A process that stalls longer resumes at the same position, without a burst of the data it did not send.
const STALL_NS: i64 = 1_000_000_000;
/// Interval of checks for a stop while waiting for items or steps.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// ReplayCounts for the summary.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct ReplayCounts {
    pub samples: u64,
    /// Samples with an active fault of links.
    pub faulted: u64,
    /// Frames of the unit that a byte stream cannot send.
    pub unit_frames: u64,
    /// Bytes that a CAN interface cannot send.
    pub unit_bytes: u64,
    /// Commands and other traffic that a link of the other encoding cannot send.
    pub other: u64,
    /// Number of stalls of the process.
    pub stalled: u64,
}

pub(super) struct Player {
    pub links: TimedLinks,
    pub faults: FaultEngine,
    pub counts: ReplayCounts,
    /// The last sample, for the status line.
    shown: Arc<Mutex<Option<Sample>>>,
    items: Receiver<Vec<ReplayItem>>,
    steps: Option<Steps>,
    /// Samples that may be sent before the next step.
    allowed: u64,
    recorded_plan: CanIdMap,
    is_described: bool,
    /// Index of the next sample.
    frame: u64,
    last: Option<Sample>,
    /// For each link: true if it encodes the last sample itself instead of sending the recorded data.
    encodes: Vec<bool>,
}

impl Player {
    pub fn new(
        settings: &ReplayOptions,
        links: Vec<LinkOutput>,
        items: Receiver<Vec<ReplayItem>>,
        steps: Option<Steps>,
        session: Session,
        shown: Arc<Mutex<Option<Sample>>>,
    ) -> Player {
        Player {
            encodes: vec![false; links.len()],
            links: TimedLinks::new(session, links, Duration::ZERO),
            faults: FaultEngine::new(&settings.plan),
            counts: ReplayCounts::default(),
            shown,
            items,
            steps,
            allowed: 0,
            recorded_plan: settings.recorded_plan,
            is_described: !settings.plan.device.is_iras(),
            frame: 0,
            last: None,
        }
    }

    /// Plays to the end of the items, or until it is stopped.
    pub fn play(&mut self) {
        self.links.session.await_client(&self.links.outputs);
        self.links.start();
        let last_ns = self.play_items();
        self.links.end(last_ns);
    }

    /// Plays the items, and returns the time of the last one.
    fn play_items(&mut self) -> i64 {
        let mut last_ns = 0;
        loop {
            let batch = match self.items.recv_timeout(POLL_INTERVAL) {
                Ok(batch) => batch,
                Err(RecvTimeoutError::Timeout) if !self.is_stopped() => continue,
                Err(_) => return last_ns,
            };
            for item in batch {
                self.send_delayed(item.played_ns - 1);
                self.wait_until(item.played_ns);
                if self.is_stopped() {
                    return last_ns;
                }
                last_ns = item.played_ns;
                let is_content = matches!(item.what, ReplayItemKind::Content(..));
                if !self.play_item(item) {
                    return last_ns;
                }
                if is_content && let Some(deadline_ns) = self.links.wall_ns(last_ns) {
                    self.links.session.monitor.record(now_ns() - deadline_ns);
                }
            }
        }
    }

    fn is_stopped(&self) -> bool {
        self.links.session.is_stopped()
    }

    fn wait_until(&mut self, played_ns: i64) {
        let Some(deadline_ns) = self.links.wall_ns(played_ns) else { return };
        while !self.is_stopped() && now_ns() < deadline_ns - LEAD_NS {
            doze_until(deadline_ns - LEAD_NS);
        }
        if !self.is_stopped() {
            self.links.timer.sleep_until(deadline_ns);
        }
        let late_ns = now_ns() - deadline_ns;
        if late_ns > STALL_NS && !self.links.session.speed.is_faster_than_real() {
            self.counts.stalled += 1;
            self.links.start_ns += late_ns;
            let late = DurationNs(late_ns as u64);
            console::say(format_args!("process stalled {late}; replay resumes"));
        }
    }

    /// Sends the transmissions, delayed by faults, that are due by `until_ns`, each at its time.
    fn send_delayed(&mut self, until_ns: i64) {
        while let Some(due_ns) = self.links.next_due_ns().filter(|&due_ns| due_ns <= until_ns) {
            self.wait_until(due_ns);
            if self.is_stopped() {
                return;
            }
            self.links.send_due(due_ns);
        }
    }

    /// Plays an item at its time; false if no more may be sent.
    fn play_item(&mut self, item: ReplayItem) -> bool {
        match item.what {
            ReplayItemKind::Note(text) => console::say(text),
            ReplayItemKind::Sample { sample, is_can } => {
                if !self.is_allowed() {
                    return false;
                }
                self.begin(&sample, is_can, &item);
            }
            ReplayItemKind::Content(content, origin) => self.send(&content, origin, item.played_ns),
        }
        true
    }

    /// Waits for a step, if the replay has steps; false if no more can come.
    fn is_allowed(&mut self) -> bool {
        let Some(steps) = &self.steps else { return true };
        while self.allowed == 0 {
            if let Some(last) = &self.last
                && matches!(steps.try_recv().map(|step| self.allowed += step), Err(TryRecvError::Empty))
            {
                let (done, sequence) = (self.counts.samples, last.sequence);
                match self.is_described {
                    true => console::say(format_args!("{done} samples sent")),
                    false => console::say(format_args!("{done} samples sent, the last of sequence {sequence}")),
                }
            }
            while self.allowed == 0 {
                match steps.recv_timeout(POLL_INTERVAL) {
                    Ok(step) => self.allowed += step,
                    Err(RecvTimeoutError::Timeout) if !self.links.session.is_stopped() => {}
                    Err(_) => return false,
                }
            }
        }
        self.allowed -= 1;
        true
    }

    /// Begins a sample: steps the faults, and sends it over the links that encode it.
    fn begin(&mut self, sample: &Sample, is_can: bool, item: &ReplayItem) {
        // Faults follow the gaps of the recording; small deviations of the interval are no gap.
        let by_time = item.recorded_ns.max(0).saturating_add(SAMPLE_INTERVAL_NS / 2) / SAMPLE_INTERVAL_NS;
        let frame = if by_time as u64 > self.frame + 1 { by_time as u64 } else { self.frame };
        self.frame = frame + 1;
        if !self.faults.is_empty() {
            self.faults.begin(&mut self.inputs(sample, frame), self.last.map(CompletedSample::from));
            self.faults.take_happened().iter().for_each(log_event);
        }
        let acting = self.faults.acting().clone();
        let mut is_faulted = false;
        for (output, encodes) in self.links.outputs.iter_mut().zip(&mut self.encodes) {
            let model = output.link.info().model.clone();
            let is_touched = !model.touching(&acting).is_empty();
            is_faulted |= is_touched;
            // Transmissions delayed to this sample are sent before or after all of it, not between its frames.
            output.queue.put(Vec::new(), frame, item.played_ns);
            let waits = output.queue.is_within_frame()
                || output.queue.next_ns().is_some_and(|due_ns| due_ns <= item.played_ns + 1);
            // Of a described unit the recorded data alone are sent.
            *encodes = !self.is_described && (is_touched || waits || is_can != is_bus(&model));
            if *encodes {
                output.put(Some(&(*sample).into()), frame, item.played_ns, &acting);
                output.send_due(item.played_ns, &self.links.patience);
            }
        }
        self.counts.samples += 1;
        self.counts.faulted += u64::from(is_faulted);
        self.last = Some(*sample);
        if !self.is_described {
            *host::lock(&self.shown) = self.last;
        }
    }

    /// Inputs of conditions at the start of a sample interval, without rates.
    fn inputs(&self, sample: &Sample, frame: u64) -> ConditionInputs {
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
            outputs: CompletedSample::from(last).outputs,
            ..ConditionInputs::default()
        }
    }

    /// Sends recorded data over the links of its encoding.
    fn send(&mut self, content: &WireData, origin: TrafficOrigin, played_ns: i64) {
        let is_can = matches!(content, WireData::Frame(_));
        let acting = self.faults.acting().clone();
        let mut is_left_out = false;
        for (output, encodes) in self.links.outputs.iter_mut().zip(&self.encodes) {
            let model = &output.link.info().model;
            if origin == TrafficOrigin::Sample && *encodes
                || origin == TrafficOrigin::Unit && model.blocks_samples(&acting)
            {
                continue;
            }
            if is_can != is_bus(model) {
                is_left_out = true;
                continue;
            }
            let data = with_identifier(content, origin, self.recorded_plan, model);
            // After the rest of a fragmented frame.
            output.queue.put(vec![Transmission::on_time(0, data)], self.frame.saturating_sub(1), played_ns);
            output.send_due(played_ns, &self.links.patience);
        }
        if is_left_out {
            match (origin, content) {
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
    model.encoding.is_can()
}

/// A message of the unit with its identifier on this link.
fn with_identifier(content: &WireData, origin: TrafficOrigin, recorded: CanIdMap, model: &LinkModel) -> WireData {
    match (content, &model.encoding) {
        (WireData::Frame(frame), Encoding::Can(plan)) if origin != TrafficOrigin::Other => {
            let offset = frame.id().saturating_sub(recorded.base().into());
            WireData::Frame(frame.with_id(offset.saturating_add(plan.base().into())))
        }
        _ => content.clone(),
    }
}

fn log_event(event: &FaultEvent) {
    match event {
        FaultEvent::Started(fault) => console::say(format_args!("fault {} active: {}", fault.id, fault.action.name())),
        FaultEvent::Ended(fault, count) => {
            console::say(format_args!("fault {} ended after {} s", fault.id, on_board_s(*count)));
        }
        // Reported at the end.
        FaultEvent::Decided(_) => {}
    }
}
