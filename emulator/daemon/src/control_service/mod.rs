//! The running unit for the control interface: state, faults and commands.
//!
//! The cadence thread queues events without waiting (`events`); the publisher thread converts them to JSON (`status`) and
//! sends them to the clients. Faults and commands go through the shared unit, as the commands of links do.

mod events;
mod history;
mod status;
#[cfg(test)]
mod tests;
mod toml;

use std::collections::VecDeque;
use std::io;
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex, OnceLock};

use geu_model::configuration::fault::{MAX_FAULTS, read_fault_text, read_plan_text};
use geu_model::device::Device;
use geu_model::fault::engine::FaultStatus;
use geu_model::fault::{Fault, unsatisfiable_condition};
use geu_protocol::Gyros;
use geu_protocol::suggestion::{did_you_mean, listed};
use serde_json::{Map, Value, json};
use tokio::sync::broadcast;

use crate::catalogue;
use crate::control::{self, ControlBackend, SseEvent};
use crate::host::{self, Thread, lock};
use crate::recorder_thread::Status;
use crate::shared_unit::Observer;
use events::{COMMAND, EventPublisher, ServiceEvent};
use geu_recorder::fault_json;
use history::History;
pub(crate) use status::StatusSource;

/// Capacity of the queue to the publisher thread; events beyond it are lost and counted.
const QUEUE: usize = 4096;
/// Events that a client may fall behind.
const MAX_LAG: usize = 256;
/// Number of timeline lines kept.
const TIMELINE: usize = 20_000;
/// Number of events of `geu watch` kept.
const WATCH_EVENTS: usize = 100;

/// A running unit, as the control interface sees it.
pub(crate) struct ControlService {
    events: broadcast::Sender<SseEvent>,
    timeline: Mutex<Timeline>,
    history: History,
    /// The last events of `geu watch`.
    watch: Mutex<VecDeque<Value>>,
    /// The last published sample.
    last: Mutex<Value>,
    /// Events lost because the queue was full.
    lost: AtomicU64,
    source: OnceLock<StatusSource>,
}

/// The latest lines of the timeline, and whether each is of a command.
#[derive(Default)]
struct Timeline(VecDeque<(bool, Arc<str>)>);

impl Timeline {
    /// Adds a line; if the timeline is full, the oldest command is removed, so that events of faults are kept longer.
    fn push(&mut self, is_command: bool, line: Arc<str>) {
        if self.0.len() == TIMELINE {
            let oldest = self.0.iter().position(|(is_command, _)| *is_command).unwrap_or(0);
            self.0.remove(oldest);
        }
        self.0.push_back((is_command, line));
    }
}

/// The service, the observer of the unit that feeds it, and the publisher thread.
pub type Started = (Arc<ControlService>, Box<dyn Observer>, Thread<()>);

impl ControlService {
    /// Starts a service; its publisher thread ends with the observer.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn start(device: &Arc<Device>) -> io::Result<Started> {
        let (sender, events) = sync_channel(QUEUE);
        let service = Arc::new(ControlService {
            events: broadcast::Sender::new(MAX_LAG),
            timeline: Mutex::default(),
            history: History::default(),
            watch: Mutex::default(),
            last: Mutex::default(),
            lost: AtomicU64::new(0),
            source: OnceLock::new(),
        });
        let (publisher, own) = (service.clone(), device.clone());
        let thread = Thread::spawn("geu-bench", move || publisher.publish(&own, &events))?;
        Ok((service.clone(), Box::new(EventPublisher::new(sender, service, device.clone())), thread))
    }

    /// Sets the unit and its links.
    pub fn set_source(&self, source: StatusSource) {
        assert!(self.source.set(source).is_ok(), "set once");
    }

    fn source(&self) -> &StatusSource {
        self.source.get().expect("served only after the source is set")
    }

    /// Adds the faults that `read` returns for the existing ones: all with the same sample, or none.
    fn add(&self, read: impl Fn(&[Fault]) -> Result<Vec<Fault>, String>) -> Result<Value, String> {
        let (unit, open) = (&self.source().unit, self.source().open());
        // Reads without holding the unit, which the cadence thread may need; reads again if an identifier was taken or a
        // time passed meanwhile.
        loop {
            let existing: Vec<Fault> = unit.faults().planned.iter().map(|status| Fault::clone(&status.fault)).collect();
            let faults = read(&existing)?;
            let count = unit.faults_now().1.len() + faults.len();
            if count > MAX_FAULTS {
                return Err(format!(
                    "expected at most {MAX_FAULTS} faults that are armed or active, got {count}; clear some, as `geu inject --clear ID` does"
                ));
            }
            let unsatisfiable = || unsatisfiable_condition(&faults, &[], "the truth of this run", unit.unavailable());
            if let Some(reason) = faults.iter().find_map(|fault| fault.misses(&open)).or_else(unsatisfiable) {
                return Err(reason);
            }
            let start_s = unit.device.on_board_s(unit.running().0 + 1);
            if let Some(Fault { id, until_s, .. }) = faults.iter().find(|fault| fault.until_s <= start_s) {
                return Err(format!("{id}: expected a future time for `until_s`, after {start_s} s, got {until_s}"));
            }
            if let Some(added) = unit.inject(existing.len(), &faults) {
                let json = |fault: &Fault| json!({ "id": fault.id, "state": "armed", "at_s": fault.at_s, "keys": fault_json::keys(&unit.device, fault) });
                return Ok(added.iter().map(json).collect());
            }
        }
    }

    /// The error for an identifier that is none of the `candidates`.
    fn no_such_fault(&self, id: &str, expected: &str, is_candidate: impl Fn(&FaultStatus) -> bool) -> String {
        let planned = self.source().unit.faults().planned;
        let candidates = planned.iter().filter(|status| is_candidate(status));
        let ids: Vec<&str> = candidates.map(|status| status.fault.id.as_str()).collect();
        format!("expected the identifier of {expected} ({}{}), got {id:?}", did_you_mean(id, &ids), listed(&ids))
    }

    /// Publishes events until the observer is dropped.
    fn publish(&self, device: &Device, events: &Receiver<ServiceEvent>) {
        while let Some(event) = host::receive(events) {
            let (name, data) = match event {
                ServiceEvent::Sample(sample) => {
                    let Some(source) = self.source.get() else { continue };
                    let status = source.sample(&sample);
                    lock(&self.last).clone_from(&status);
                    ("half-second", status)
                }
                ServiceEvent::Commands(sample, count) => ("timeline", events::more_commands(device, sample, count)),
                ServiceEvent::Event(sample, event) => {
                    let Some(line) = events::timeline_line(device, sample, &event) else { continue };
                    ("timeline", line)
                }
            };
            let is_command = data["kind"] == COMMAND;
            let data: Arc<str> = data.to_string().into();
            if name == "timeline" {
                lock(&self.timeline).push(is_command, data.clone());
            }
            // Fails if there are no clients.
            let _ = self.events.send(SseEvent { name, data });
        }
    }
}

impl ControlBackend for ControlService {
    fn gyros(&self) -> Gyros {
        self.source().unit.device.all_gyros()
    }

    fn status(&self) -> Value {
        let source = self.source();
        let mut status = lock(&self.last).clone();
        if status.is_null() {
            let (links, faults) = (source.links(), source.faults_now());
            status = json!({ "half_second": 0, "lateness": { "count": 0 }, "links": links, "faults": faults });
        }
        let truth = ["t_s", "true_arcsec", "rate_arcsec_s", "theta_deg", "psi_deg"];
        status["truth"] = truth.into_iter().map(|key| (key, status[key].clone())).collect();
        status["version"] = json!(env!("CARGO_PKG_VERSION"));
        status["lost"] = json!(self.lost.load(Relaxed));
        let (commands, rejected) = (&source.unit.commands, &source.unit.rejected);
        status["recording"] = json!(source.unit.recording().map(Status::to_json));
        status["commands"] = json!({ "answered": commands.load(Relaxed), "rejected": rejected.load(Relaxed) });
        status
    }

    fn catalogue(&self) -> Value {
        catalogue::catalogue(&self.source().unit.device)
    }

    fn layout(&self) -> Value {
        let device = &self.source().unit.device;
        if device.is_iras() { control::layout() } else { control::layout_of(device) }
    }

    fn faults(&self) -> Value {
        self.source().faults()
    }

    fn inject(&self, injection: &Map<String, Value>) -> Result<Value, String> {
        let text = |key: &str| injection.get(key).and_then(Value::as_str);
        let has_only = |keys: &[&str]| injection.keys().all(|key| keys.contains(&key.as_str()));
        let links = self.source().open_or_recorded();
        if let Some(id) = text("start").filter(|_| has_only(&["start"])) {
            let at_s = self.source().unit.start(id).ok_or_else(|| {
                self.no_such_fault(id, "a fault with by_hand = true that has not started", FaultStatus::awaits_operator)
            })?;
            Ok(json!({ "id": id, "state": "armed", "at_s": at_s }))
        } else if let Some(plan) = text("plan").filter(|_| has_only(&["plan", "name"])) {
            let name = text("name").unwrap_or("plan");
            self.add(|existing| {
                read_plan_text(&self.source().unit.device, name, plan, existing, &links)
                    .map_err(|error| error.to_string())
            })
        } else {
            let fault = toml::text(injection);
            let device = &self.source().unit.device;
            let read = |existing: &[Fault]| {
                read_fault_text(device, "fault", &fault, existing, &links).map(|fault| vec![fault])
            };
            let mut added = self.add(|existing| read(existing).map_err(|error| error.message))?;
            Ok(added[0].take())
        }
    }

    fn clear(&self, id: &str) -> Result<Value, String> {
        let until_s = self
            .source()
            .unit
            .clear(id)
            .ok_or_else(|| self.no_such_fault(id, "a fault that is armed or active", |status| !status.is_over()))?;
        Ok(json!({ "id": id, "until_s": until_s }))
    }

    fn clear_all(&self) -> Value {
        json!({ "cleared": self.source().unit.clear_all() })
    }

    fn command(&self, payload: Vec<u8>) -> Pin<Box<dyn Future<Output = Value> + Send + '_>> {
        Box::pin(async move {
            let response = self.source().unit.command("control", &payload).await;
            match &response.reply {
                Some(reply) => control::reply(reply, response.polled.as_ref().map(|polled| &polled.sample)),
                None if !self.source().unit.device.is_iras() => json!({ "outcome": "this unit has no commands" }),
                None => json!({ "outcome": "no reply: a fault keeps the unit silent" }),
            }
        })
    }

    fn timeline(&self) -> Vec<Arc<str>> {
        lock(&self.timeline).0.iter().map(|(_, line)| line.clone()).collect()
    }

    fn history(&self) -> Value {
        self.history.json()
    }

    fn watch_events(&self) -> Value {
        json!(*lock(&self.watch))
    }

    fn add_watch_event(&self, mut event: Map<String, Value>) -> Value {
        let mut kept = lock(&self.watch);
        let number = kept.back().and_then(|last| last["number"].as_u64()).unwrap_or_default() + 1;
        event.insert("number".to_owned(), json!(number));
        let event = Value::Object(event);
        if kept.len() == WATCH_EVENTS {
            kept.pop_front();
        }
        kept.push_back(event.clone());
        // Under the lock, so that clients receive the numbers in order; does not wait, and fails if there are no clients.
        let _ = self.events.send(SseEvent { name: "watch", data: event.to_string().into() });
        event
    }

    fn subscribe(&self) -> broadcast::Receiver<SseEvent> {
        self.events.subscribe()
    }
}

/// The text of a fault in a request.
#[cfg(fuzzing)]
pub(crate) fn fuzzed(object: &Map<String, Value>) -> String {
    toml::text(object)
}
