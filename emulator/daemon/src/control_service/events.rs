//! Events for the control interface: handed over without waiting, made into JSON on the publisher thread.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

use geu_model::attitude::{Motion, MotionState};
use geu_model::units::on_board_s;
use geu_model::{CompletedSample, InjectionRecord};
use geu_protocol::command::{self, COMMANDS};
use serde_json::{Value, json};

use super::history::{Historian, HistorySample};
use crate::fault_json;
use crate::recorder::UnitEvent;
use crate::shared_unit::Observer;

/// A run faster than real shows a sample so often at most.
const PACE: Duration = Duration::from_millis(50);

/// Kind of line of a command.
pub(super) const COMMAND: &str = "command";
/// Commands of one sample that are shown one by one; more are counted.
const FEW: u64 = 4;

/// Something to be shown.
pub(super) enum ServiceEvent {
    Sample(SampleEvent),
    /// An event of the sample that runs.
    Event(u64, UnitEvent),
    /// How many more commands came in that sample interval.
    Commands(u64, u64),
}

/// A sample that ended, with the truth behind it.
pub(super) struct SampleEvent {
    pub ended: CompletedSample,
    pub true_arcsec: [f64; 4],
    /// Increments less true rotation, of every sample until the end of this one.
    pub departure_arcsec: [f64; 4],
    pub now: MotionState,
    pub knows_sun: bool,
    pub injected: Option<Arc<InjectionRecord>>,
}

/// The end that the unit tells.
pub(crate) struct EventPublisher {
    sender: SyncSender<ServiceEvent>,
    lost: Arc<AtomicU64>,
    historian: Historian,
    samples: u64,
    departure_arcsec: [f64; 4],
    /// Since the last sample.
    commands: u64,
    shown: Option<Instant>,
}

impl EventPublisher {
    /// Tells `sender`, and counts what finds no room there.
    pub(super) fn new(sender: SyncSender<ServiceEvent>, lost: Arc<AtomicU64>, historian: Historian) -> EventPublisher {
        EventPublisher { sender, lost, historian, samples: 0, departure_arcsec: [0.0; 4], commands: 0, shown: None }
    }

    fn send(&self, told: ServiceEvent) {
        if self.sender.try_send(told).is_err() {
            self.lost.fetch_add(1, Relaxed);
        }
    }
}

impl Observer for EventPublisher {
    fn observe(&mut self, event: &UnitEvent, motion: &Motion) {
        let told = match event {
            UnitEvent::Sample(ended, traces, injected) => {
                if let Some(more @ 1..) = std::mem::take(&mut self.commands).checked_sub(FEW) {
                    self.send(ServiceEvent::Commands(self.samples, more));
                }
                self.samples += 1;
                let told = ended.sample.increments.into_iter().zip(traces.iter());
                for (departure, (increment, trace)) in self.departure_arcsec.iter_mut().zip(told) {
                    *departure += f64::from(increment) - trace.true_arcsec;
                }
                self.historian.push(HistorySample {
                    t_s: end_s(ended),
                    sample: self.samples,
                    increments: ended.sample.increments,
                    true_arcsec: traces.each_ref().map(|trace| trace.true_arcsec),
                    departure_arcsec: self.departure_arcsec,
                    gyro_flags: ended.sample.gyro_flags,
                });
                if self.shown.is_some_and(|shown| shown.elapsed() < PACE) {
                    return;
                }
                self.shown = Some(Instant::now());
                ServiceEvent::Sample(SampleEvent {
                    ended: *ended,
                    true_arcsec: traces.each_ref().map(|trace| trace.true_arcsec),
                    departure_arcsec: self.departure_arcsec,
                    now: *motion.now(),
                    knows_sun: motion.knows_sun(),
                    injected: injected.clone(),
                })
            }
            UnitEvent::Polled(_) => return,
            UnitEvent::Command { .. } if self.commands >= FEW => {
                self.commands += 1;
                return;
            }
            event => {
                self.commands += u64::from(matches!(event, UnitEvent::Command { .. }));
                ServiceEvent::Event(self.samples, event.clone())
            }
        };
        self.send(told);
    }
}

/// On-board time at the end of a sample interval, s.
pub(super) fn end_s(ended: &CompletedSample) -> f64 {
    (ended.end_ns as f64 * 1e-9 * 1e6).round() / 1e6
}

/// Commands that were not told one by one, as a line of the timeline.
pub(super) fn more_commands(frame: u64, count: u64) -> Value {
    json!({ "t_s": on_board_s(frame), "kind": COMMAND, "text": format!("{count} more commands") })
}

/// An event as a line of the timeline; nothing for what is shown otherwise. `frame` is the sample that runs.
pub(super) fn line(frame: u64, event: &UnitEvent) -> Option<Value> {
    let line = |t_s: f64, kind: &str, text: String| Some(json!({ "t_s": t_s, "kind": kind, "text": text }));
    let now_s = on_board_s(frame);
    match event {
        UnitEvent::Sample(..) | UnitEvent::Polled(_) => None,
        UnitEvent::Command { link, payload, .. } => {
            let name = payload.first().and_then(|opcode| COMMANDS.iter().find(|spec| spec.opcode == *opcode));
            let (name, bytes) = (name.map_or("unknown command", |spec| spec.name), command::hex(payload));
            line(now_s, COMMAND, format!("{name} ({bytes}) over {link}"))
        }
        UnitEvent::Missed { .. } => line(now_s, "missed", "a sample was not sent: the process was held up".to_owned()),
        UnitEvent::Happened(happening) => {
            let mut told = fault_json::happening(frame, happening);
            let (kind, text) = match told["what"].as_str() {
                Some("start") => ("fault-start", format!("{} acts: {}", text(&told, "id"), text(&told, "fault"))),
                Some("end") => {
                    let after_s = told["half_seconds"].as_f64().unwrap_or_default() * 0.5;
                    ("fault-end", format!("{} is over after {after_s} s", text(&told, "id")))
                }
                _ => (
                    "expectation",
                    format!("{} is {}: {}", text(&told, "id"), text(&told, "verdict"), text(&told, "condition")),
                ),
            };
            (told["kind"], told["text"]) = (json!(kind), json!(text));
            Some(told)
        }
        UnitEvent::Injected(fault) => Some(json!({
            "t_s": now_s, "kind": "injected", "id": fault.id, "keys": fault_json::keys(fault),
            "text": format!("{} injected: {}", fault.id, fault.action.name()),
        })),
        UnitEvent::StartedByHand { id, at_s } => line(*at_s, "injected", format!("{id} started by hand")),
        UnitEvent::Cleared { id, until_s } => line(*until_s, "cleared", format!("{id} cleared")),
    }
}

fn text(value: &Value, key: &str) -> String {
    value[key].as_str().unwrap_or_default().to_owned()
}
