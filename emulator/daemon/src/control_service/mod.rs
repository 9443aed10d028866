//! What the control interface shows of a running unit, and how it drives it.
//!
//! The thread that keeps time hands over what happened, without waiting (`events`); the publisher thread makes JSON of
//! it (`status`) and sends it to whoever listens. What is driven goes through the shared unit, as the commands of links do.

mod events;
mod history;
mod status;
#[cfg(test)]
mod tests;
mod toml;

use std::collections::VecDeque;
use std::future::Future;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::{self, JoinHandle};

use geu_model::configuration::fault::{MOST, read_fault_text, read_plan_text};
use geu_model::fault::catalogue::Transport;
use geu_model::fault::{Fault, unsatisfiable_condition};
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::suggestion::{did_you_mean, listed};
use serde_json::{Map, Value, json};
use tokio::sync::broadcast;

use crate::catalogue;
use crate::control::{self, ControlBackend, SseEvent};
use crate::fault_json;
use crate::lateness::CadenceMonitor;
use crate::link::LinkStatistics;
use crate::link_model::LinkModel;
use crate::recorder_thread::Status;
use crate::shared_unit::{Observer, SharedUnit};
use events::{EventPublisher, ServiceEvent};
use history::{Historian, History, lock};
use status::StatusSource;

/// What may wait to be shown; more is lost, and counted.
const QUEUE: usize = 4096;
/// Events that a client may be behind.
const BEHIND: usize = 256;
/// Lines of the timeline that are kept.
const TIMELINE: usize = 20_000;

/// A running unit, as the control interface sees it.
pub(crate) struct ControlService(Arc<Shared>);

/// What the threads share.
struct Shared {
    events: broadcast::Sender<SseEvent>,
    timeline: Mutex<Timeline>,
    history: History,
    last: Mutex<Value>,
    lost: Arc<AtomicU64>,
    known: OnceLock<StatusSource>,
}

/// The latest lines of the timeline, and which of them are of commands.
#[derive(Default)]
struct Timeline(VecDeque<(bool, Arc<str>)>);

impl Timeline {
    /// Where it is full, the oldest command makes room: what faults did stays longer.
    fn push(&mut self, is_command: bool, line: Arc<str>) {
        if self.0.len() == TIMELINE {
            let oldest = self.0.iter().position(|(is_command, _)| *is_command).unwrap_or(0);
            self.0.remove(oldest);
        }
        self.0.push_back((is_command, line));
    }
}

/// The thread that shows.
pub(crate) struct PublisherThread(JoinHandle<()>);

impl PublisherThread {
    /// Waits for its end, which comes with that of the unit's recording.
    pub fn finish(self) {
        let _ = self.0.join();
    }
}

impl ControlService {
    /// The bench, the end that the unit tells, and the thread between them.
    ///
    /// # Errors
    /// No thread.
    pub fn start() -> std::io::Result<(ControlService, Box<dyn Observer>, PublisherThread)> {
        let (sender, told) = sync_channel(QUEUE);
        let lost = Arc::new(AtomicU64::new(0));
        let shared = Arc::new(Shared {
            events: broadcast::Sender::new(BEHIND),
            timeline: Mutex::default(),
            history: History::default(),
            last: Mutex::new(Value::Null),
            lost: lost.clone(),
            known: OnceLock::new(),
        });
        let historian = Historian::new(shared.history.clone());
        let thread = thread::Builder::new().name("geu-bench".to_owned()).spawn({
            let shared = shared.clone();
            move || shared.show(&told)
        })?;
        Ok((ControlService(shared), Box::new(EventPublisher::new(sender, lost, historian)), PublisherThread(thread)))
    }

    /// Makes the rest known; `recorded` is the kind of link that a recording is of.
    pub fn know(
        &self,
        unit: &Arc<SharedUnit>,
        links: &[(LinkModel, Arc<LinkStatistics>)],
        recorded: Option<Transport>,
        monitor: &Arc<CadenceMonitor>,
    ) {
        assert!(self.0.known.set(StatusSource::new(unit, links, recorded, monitor)).is_ok(), "made known once");
    }

    fn known(&self) -> &StatusSource {
        self.0.known.get().expect("served only when all is known")
    }

    /// Adds what `read` makes of the faults that are there: all with the same sample, or none.
    fn add(&self, read: impl Fn(&[Fault]) -> Result<Vec<Fault>, String>) -> Result<Vec<Fault>, String> {
        let (unit, open) = (&self.known().unit, self.known().open());
        // Read without the unit, which the thread that keeps time may want meanwhile; again where an identifier was taken
        // or a time passed until then.
        loop {
            let there: Vec<Fault> = unit.faults().planned.iter().map(|planned| Fault::clone(&planned.fault)).collect();
            let faults = read(&there)?;
            let count = unit.faults_now().1.len() + faults.len();
            if count > MOST {
                return Err(format!(
                    "expected at most {MOST} faults that are armed or active, got {count}; clear some, as `geu inject --clear ID` does"
                ));
            }
            let in_vain = || unsatisfiable_condition(&faults, &[], "the truth of this run", unit.untold());
            if let Some(reason) = faults.iter().find_map(|fault| fault.misses(&open)).or_else(in_vain) {
                return Err(reason);
            }
            let start_s = (unit.running().0 + 1) as f64 * SAMPLE_INTERVAL_S;
            if let Some(Fault { id, until_s, .. }) = faults.iter().find(|fault| fault.until_s <= start_s) {
                return Err(format!("{id}: expected a time to come for `until_s`, after {start_s} s, got {until_s}"));
            }
            if let Some(added) = unit.inject(there.len(), &faults) {
                return Ok(added);
            }
        }
    }

    fn start_by_hand(&self, id: &str) -> Result<Value, String> {
        let unit = &self.known().unit;
        if let Some(at_s) = unit.start(id) {
            return Ok(json!({ "id": id, "state": "armed", "at_s": at_s }));
        }
        let planned = unit.faults().planned;
        let waiting = planned.iter().filter(|planned| planned.awaits_operator());
        let there: Vec<&str> = waiting.map(|planned| planned.fault.id.as_str()).collect();
        let (hint, there) = (did_you_mean(id, &there), listed(&there));
        Err(format!(
            "expected the identifier of a fault with by_hand = true that still waits ({hint}{there}) for `start`, got {id:?}"
        ))
    }
}

impl Shared {
    fn show(&self, told: &Receiver<ServiceEvent>) {
        for told in told {
            let (name, data) = match told {
                ServiceEvent::Sample(sample) => {
                    let Some(known) = self.known.get() else { continue };
                    let shown = known.sample(&sample);
                    *lock(&self.last) = shown.clone();
                    ("half-second", shown)
                }
                ServiceEvent::Commands(frame, count) => ("timeline", events::more_commands(frame, count)),
                ServiceEvent::Event(frame, event) => {
                    let Some(line) = events::line(frame, &event) else { continue };
                    ("timeline", line)
                }
            };
            let is_command = data["kind"] == events::COMMAND;
            let data: Arc<str> = data.to_string().into();
            if name == "timeline" {
                lock(&self.timeline).push(is_command, data.clone());
            }
            // Without anybody who listens.
            let _ = self.events.send(SseEvent { name, data });
        }
    }
}

/// A fault that was added, as whoever asked is told.
fn added_as(fault: &Fault) -> Value {
    json!({ "id": fault.id, "state": "armed", "at_s": fault.at_s, "keys": fault_json::keys(fault) })
}

impl ControlBackend for ControlService {
    fn status(&self) -> Value {
        let mut status = lock(&self.0.last).clone();
        if !status.is_object() {
            let (links, faults) = (self.known().links(), self.known().faults_now());
            status = json!({ "half_second": 0, "lateness": { "count": 0 }, "links": links, "faults": faults });
        }
        let truth = ["t_s", "true_arcsec", "rate_arcsec_s", "theta_deg", "psi_deg"];
        status["truth"] =
            truth.into_iter().map(|key| (key.to_owned(), status[key].clone())).collect::<Map<_, _>>().into();
        status["version"] = json!(env!("CARGO_PKG_VERSION"));
        status["lost"] = json!(self.0.lost.load(Relaxed));
        let (commands, rejected) = (&self.known().unit.commands, &self.known().unit.rejected);
        status["recording"] = json!(self.known().unit.recording().map(Status::told));
        status["commands"] = json!({ "answered": commands.load(Relaxed), "rejected": rejected.load(Relaxed) });
        status
    }

    fn catalogue(&self) -> Value {
        catalogue::catalogue()
    }

    fn faults(&self) -> Value {
        self.known().faults()
    }

    fn inject(&self, injection: &Map<String, Value>) -> Result<Value, String> {
        let text = |key: &str| injection.get(key).and_then(Value::as_str);
        let has_only = |keys: &[&str]| injection.keys().all(|key| keys.contains(&key.as_str()));
        let links = self.known().told_links();
        if let Some(id) = text("start").filter(|_| has_only(&["start"])) {
            self.start_by_hand(id)
        } else if let Some(plan) = text("plan").filter(|_| has_only(&["plan", "name"])) {
            let name = text("name").unwrap_or("plan");
            let added =
                self.add(|there| read_plan_text(name, plan, there, &links).map_err(|error| error.to_string()))?;
            Ok(added.iter().map(added_as).collect())
        } else {
            let fault = toml::text(injection);
            let read = |there: &[Fault]| read_fault_text("fault", &fault, there, &links).map(|fault| vec![fault]);
            let added = self.add(|there| read(there).map_err(|error| error.message))?;
            Ok(added.iter().map(added_as).next().expect("one was read"))
        }
    }

    fn clear(&self, id: &str) -> Result<Value, String> {
        let until_s = self.known().unit.clear(id);
        until_s.map(|until_s| json!({ "id": id, "until_s": until_s })).ok_or_else(|| {
            let planned = self.known().unit.faults().planned;
            let lasting = planned.iter().filter(|planned| !planned.is_over());
            let there: Vec<&str> = lasting.map(|planned| planned.fault.id.as_str()).collect();
            let (hint, there) = (did_you_mean(id, &there), listed(&there));
            format!("expected the identifier of a fault that is armed or active ({hint}{there}), got {id:?}")
        })
    }

    fn clear_all(&self) -> Value {
        json!({ "cleared": self.known().unit.clear_all() })
    }

    fn command(&self, payload: Vec<u8>) -> impl Future<Output = Value> + Send {
        let unit = self.known().unit.clone();
        async move {
            let answered = unit.command("control", &payload).await;
            match &answered.reply {
                Some(reply) => control::reply(reply, answered.polled.as_ref()),
                None => json!({ "outcome": "no reply: a fault keeps the unit silent" }),
            }
        }
    }

    fn timeline(&self) -> Vec<Arc<str>> {
        lock(&self.0.timeline).0.iter().map(|(_, line)| line.clone()).collect()
    }

    fn history(&self) -> Value {
        self.0.history.json()
    }

    fn subscribe(&self) -> broadcast::Receiver<SseEvent> {
        self.0.events.subscribe()
    }
}
