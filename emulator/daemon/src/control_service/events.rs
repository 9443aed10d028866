//! Events of the unit for the control interface: queued without waiting, converted to JSON by the publisher thread.

use std::collections::VecDeque;
use std::mem::take;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::SyncSender;
use std::time::Duration;

use geu_model::attitude::{Motion, MotionState};
use geu_model::device::Device;
use geu_model::{CompletedSample, InjectionRecord};
use geu_protocol::command::{self, COMMANDS};
use serde_json::{Value, json};

use super::ControlService;
use super::history::HistorySample;
use crate::host::Instant;
use crate::shared_unit::Observer;
use geu_recorder::UnitEvent;
use geu_recorder::fault_json;

/// Minimum interval between two published samples: a faster run skips some.
const PACE: Duration = Duration::from_millis(50);
/// Spacing of the samples of the history.
const HISTORY_INTERVAL_S: f64 = 0.5;
/// Kind of the timeline lines of commands.
pub(super) const COMMAND: &str = "command";
/// Commands of one sample interval that are published one by one; the others are only counted.
const MAX_COMMANDS: u64 = 4;

/// An event to publish.
pub(super) enum ServiceEvent {
    Sample(SampleEvent),
    /// An event of the running sample.
    Event(u64, UnitEvent),
    /// Number of further commands in a sample interval.
    Commands(u64, u64),
}

/// A sample that ended, with the true motion.
pub(super) struct SampleEvent {
    pub ended: CompletedSample,
    pub history: HistorySample,
    pub now: MotionState,
    pub knows_sun: bool,
    pub injected: Option<Arc<InjectionRecord>>,
}

/// Queues events for the publisher thread; counts those lost because the queue is full.
pub(super) struct EventPublisher {
    sender: SyncSender<ServiceEvent>,
    service: Arc<ControlService>,
    waiting: VecDeque<HistorySample>,
    samples: u64,
    departure_arcsec: Vec<f64>,
    device: Arc<Device>,
    /// Commands since the last sample.
    commands: u64,
    published: Option<Instant>,
}

impl EventPublisher {
    pub fn new(sender: SyncSender<ServiceEvent>, service: Arc<ControlService>, device: Arc<Device>) -> EventPublisher {
        let (waiting, departure_arcsec) = (VecDeque::new(), vec![0.0; device.heads.len()]);
        EventPublisher { sender, service, waiting, samples: 0, departure_arcsec, device, commands: 0, published: None }
    }

    fn send(&self, event: ServiceEvent) {
        if self.sender.try_send(event).is_err() {
            self.service.lost.fetch_add(1, Relaxed);
        }
    }
}

impl Observer for EventPublisher {
    fn observe(&mut self, event: &UnitEvent, motion: &Motion) {
        let event = match event {
            UnitEvent::Sample(ended, traces, injected) => {
                if let Some(more @ 1..) = take(&mut self.commands).checked_sub(MAX_COMMANDS) {
                    self.send(ServiceEvent::Commands(self.samples, more));
                }
                self.samples += 1;
                let true_arcsec: Vec<f64> = traces.iter().map(|trace| trace.true_arcsec).collect();
                let heads = self.device.heads.iter().zip(ended.outputs.counts);
                let increments: Vec<f64> = heads.map(|(head, counts)| counts * head.count_arcsec).collect();
                for (gyro, departure) in self.departure_arcsec.iter_mut().enumerate() {
                    *departure += increments[gyro] - true_arcsec[gyro];
                }
                let spacing = (HISTORY_INTERVAL_S / self.device.interval_s).round().max(1.0) as u64;
                let is_published = self.published.is_some_and(|published| published.elapsed() < PACE);
                if !self.samples.is_multiple_of(spacing) && is_published {
                    return;
                }
                let history = HistorySample {
                    t_s: (ended.end_ns as f64 * 1e-9 * 1e6).round() / 1e6,
                    sample: self.samples,
                    increments,
                    true_arcsec,
                    departure_arcsec: self.departure_arcsec.clone(),
                    gyro_flags: if self.device.is_iras() { ended.sample.gyro_flags } else { ended.outputs.valid },
                };
                if self.samples.is_multiple_of(spacing) {
                    self.service.history.push(&mut self.waiting, history.clone());
                }
                if is_published {
                    return;
                }
                self.published = Some(Instant::now());
                let (now, knows_sun) = (*motion.now(), motion.knows_sun());
                ServiceEvent::Sample(SampleEvent { ended: *ended, history, now, knows_sun, injected: injected.clone() })
            }
            UnitEvent::Polled(_) => return,
            UnitEvent::Command { .. } if self.commands >= MAX_COMMANDS => {
                self.commands += 1;
                return;
            }
            event => {
                self.commands += u64::from(matches!(event, UnitEvent::Command { .. }));
                ServiceEvent::Event(self.samples, event.clone())
            }
        };
        self.send(event);
    }
}

fn line(t_s: f64, kind: &str, text: &str) -> Value {
    json!({ "t_s": t_s, "kind": kind, "text": text })
}

/// The timeline line of the commands that were only counted.
pub(super) fn more_commands(device: &Device, sample: u64, count: u64) -> Value {
    line(device.on_board_s(sample), COMMAND, &format!("{count} more commands"))
}

/// An event as a line of the timeline; `None` for events that are not in it. `sample` is the running sample.
pub(super) fn timeline_line(device: &Device, sample: u64, event: &UnitEvent) -> Option<Value> {
    let now_s = device.on_board_s(sample);
    Some(match event {
        UnitEvent::Sample(..) | UnitEvent::Polled(_) => return None,
        UnitEvent::Command { link, payload, .. } => {
            let name = payload.first().and_then(|opcode| COMMANDS.iter().find(|spec| spec.opcode == *opcode));
            let (name, bytes) = (name.map_or("unknown command", |spec| spec.name), command::hex(payload));
            line(now_s, COMMAND, &format!("{name} ({bytes}) over {link}"))
        }
        UnitEvent::Missed { .. } => line(now_s, "missed", "a sample was not sent: the process was stalled"),
        UnitEvent::Happened(event) => {
            let mut line = fault_json::event(device, sample, event);
            let (kind, text) = fault_json::kind_and_text(device, event);
            (line["kind"], line["text"]) = (json!(kind), json!(text));
            line
        }
        UnitEvent::Injected(fault) => json!({
            "t_s": now_s, "kind": "injected", "id": fault.id, "keys": fault_json::keys(device, fault),
            "text": format!("{} injected: {}", fault.id, fault.action.name()),
        }),
        UnitEvent::StartedByHand { id, at_s } => line(*at_s, "injected", &format!("{id} started by the operator")),
        UnitEvent::Cleared { id, until_s } => line(*until_s, "cleared", &format!("{id} cleared")),
    })
}
