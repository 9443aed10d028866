//! What the control interface shows of a running unit, and how it drives it.
//!
//! The thread that keeps time hands over what happened, without waiting ([`Teller`]); a thread of the bench makes JSON of
//! it and sends it to whoever listens. What is driven goes through the desk, as the commands of links do.

use std::collections::VecDeque;
use std::future::Future;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use geu_model::attitude::{Moment, Motion};
use geu_model::configuration::fault::read_fault_text;
use geu_model::fault::Fault;
use geu_model::fault::acting::Planned;
use geu_model::fault::catalogue::LinkKind;
use geu_model::units::RAD_PER_DEG;
use geu_model::{Ended, Injected};
use geu_protocol::command::COMMANDS;
use serde_json::{Map, Value, json};
use tokio::sync::broadcast;

use crate::carriage::{Carrier, Content, Form};
use crate::catalogue;
use crate::control::{self, Bench, Event as Shown};
use crate::desk::Desk;
use crate::fault_log;
use crate::link::Tally;
use crate::record::Event;
use crate::run::Timing;

/// What may wait to be shown; more is lost, and counted.
const QUEUE: usize = 4096;
/// A run faster than real shows a half second so often at most.
const PACE: Duration = Duration::from_millis(50);
/// Events that a client may be behind.
const BEHIND: usize = 256;
/// Lines of the timeline that are kept.
const TIMELINE: usize = 20_000;

/// Something to be shown.
enum Told {
    HalfSecond { ended: Ended, true_arcsec: [f64; 4], now: Moment, knows_sun: bool, injected: Option<Arc<Injected>> },
    Line(Value),
}

/// The end that the desk tells.
pub(crate) struct Teller {
    sender: SyncSender<Told>,
    shared: Arc<Shared>,
    half_seconds: u64,
    shown: Option<Instant>,
}

impl Teller {
    /// Tells what happened, and never waits.
    pub fn tell(&mut self, event: &Event, motion: &Motion) {
        let line =
            |t_s: f64, kind: &str, text: String| Some(Told::Line(json!({ "t_s": t_s, "kind": kind, "text": text })));
        let now_s = self.half_seconds as f64 * 0.5;
        let told = match event {
            Event::HalfSecond(ended, traces, injected) => {
                self.half_seconds += 1;
                if self.shown.is_some_and(|shown| shown.elapsed() < PACE) {
                    return;
                }
                self.shown = Some(Instant::now());
                Some(Told::HalfSecond {
                    ended: *ended,
                    true_arcsec: traces.each_ref().map(|trace| trace.true_arcsec),
                    now: *motion.now(),
                    knows_sun: motion.knows_sun(),
                    injected: injected.clone(),
                })
            }
            Event::Command { link, payload, .. } => {
                let name = payload.first().and_then(|opcode| COMMANDS.iter().find(|spec| spec.opcode == *opcode));
                let bytes: String = payload.iter().map(|byte| format!("{byte:02X}")).collect();
                let name = name.map_or("unknown command", |spec| spec.name);
                line(now_s, "command", format!("{name} ({bytes}) over {link}"))
            }
            Event::Polled { .. } => None,
            Event::Missed { .. } => {
                line(now_s, "missed", "a half second was not sent: the process was held up".to_owned())
            }
            Event::Happened(happening) => {
                let mut told = fault_log::told(self.half_seconds, happening);
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
                Some(Told::Line(told))
            }
            Event::Injected(fault) => Some(Told::Line(json!({
                "t_s": now_s, "kind": "injected", "id": fault.id, "keys": fault_log::keys(fault),
                "text": format!("{} injected: {}", fault.id, fault.action.name()),
            }))),
            Event::StartedByHand { id, at_s } => line(*at_s, "injected", format!("{id} started by hand")),
            Event::Cleared { id, until_s } => line(*until_s, "cleared", format!("{id} cleared")),
        };
        if told.is_some_and(|told| self.sender.try_send(told).is_err()) {
            self.shared.lost.fetch_add(1, Relaxed);
        }
    }
}

fn text(value: &Value, key: &str) -> String {
    value[key].as_str().unwrap_or_default().to_owned()
}

/// What the threads of the bench share.
struct Shared {
    events: broadcast::Sender<Shown>,
    timeline: Mutex<VecDeque<Arc<str>>>,
    last: Mutex<Value>,
    lost: AtomicU64,
    known: OnceLock<Known>,
}

/// What is known once the links are open.
struct Known {
    desk: Arc<Desk>,
    links: Vec<(LinkKind, Arc<Tally>)>,
    timing: Arc<Timing>,
    serial: Carrier,
    can: Carrier,
}

/// A running unit, as the control interface sees it.
pub(crate) struct LiveBench(Arc<Shared>);

/// The thread that shows.
pub(crate) struct Shower(JoinHandle<()>);

impl Shower {
    /// Waits for its end, which comes with that of the desk's recording.
    pub fn finish(self) {
        let _ = self.0.join();
    }
}

impl LiveBench {
    /// The bench, the end that the desk tells, and the thread between them.
    ///
    /// # Errors
    /// No thread.
    pub fn start() -> std::io::Result<(LiveBench, Teller, Shower)> {
        let (sender, told) = sync_channel(QUEUE);
        let shared = Arc::new(Shared {
            events: broadcast::Sender::new(BEHIND),
            timeline: Mutex::default(),
            last: Mutex::new(Value::Null),
            lost: AtomicU64::new(0),
            known: OnceLock::new(),
        });
        let thread = thread::Builder::new().name("geu-bench".to_owned()).spawn({
            let shared = shared.clone();
            move || shared.show(&told)
        })?;
        let teller = Teller { sender, shared: shared.clone(), half_seconds: 0, shown: None };
        Ok((LiveBench(shared), teller, Shower(thread)))
    }

    /// Makes the rest known.
    pub fn know(&self, desk: &Arc<Desk>, links: Vec<(Carrier, Arc<Tally>)>, timing: &Arc<Timing>) {
        let of = |is_can: bool| {
            links
                .iter()
                .map(|(carrier, _)| carrier)
                .find(|carrier| matches!(carrier.form, Form::Can(_)) == is_can)
                .cloned()
        };
        let known = Known {
            desk: desk.clone(),
            serial: of(false).unwrap_or(Carrier::serial(LinkKind::Pty)),
            can: of(true).unwrap_or(Carrier::can(geu_protocol::CanPlan::default())),
            links: links.iter().map(|(carrier, tally)| (carrier.kind, tally.clone())).collect(),
            timing: timing.clone(),
        };
        assert!(self.0.known.set(known).is_ok(), "made known once");
    }

    fn known(&self) -> &Known {
        self.0.known.get().expect("served only when all is known")
    }
}

impl Shared {
    fn show(&self, told: &Receiver<Told>) {
        for told in told {
            let (name, data) = match told {
                Told::HalfSecond { ended, true_arcsec, now, knows_sun, injected } => {
                    let Some(known) = self.known.get() else { continue };
                    let shown = known.half_second(&ended, true_arcsec, &now, knows_sun, injected.as_deref());
                    *lock(&self.last) = shown.clone();
                    ("half-second", shown)
                }
                Told::Line(line) => ("timeline", line),
            };
            let data: Arc<str> = data.to_string().into();
            if name == "timeline" {
                let mut timeline = lock(&self.timeline);
                if timeline.len() == TIMELINE {
                    timeline.pop_front();
                }
                timeline.push_back(data.clone());
            }
            // Without anybody who listens.
            let _ = self.events.send(Shown { name, data });
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().expect("nothing panics with it")
}

impl Known {
    fn half_second(
        &self,
        ended: &Ended,
        true_arcsec: [f64; 4],
        now: &Moment,
        knows_sun: bool,
        injected: Option<&Injected>,
    ) -> Value {
        let half_second = &ended.half_second;
        let acting = injected.map_or(&[][..], |injected| &injected.acting);
        let carried = |carrier: &Carrier| -> Vec<Content> {
            let pieces = carrier.carry(Some(half_second).filter(|_| ended.cyclic || self.is_polled(ended)), 0, acting);
            pieces
                .into_iter()
                .filter(|piece| (piece.frame, piece.after_ns) == (0, 0))
                .map(|piece| piece.content)
                .collect()
        };
        let angle = |rad: f64| if knows_sun { json!(rad / RAD_PER_DEG) } else { Value::Null };
        let counts = self.timing.counts();
        let us = |ns: u64| ns as f64 * 1e-3;
        json!({
            "t_s": (ended.end_ns as f64 * 1e-9 * 1e6).round() / 1e6,
            "half_second": self.desk.running().0,
            "sequence": half_second.sequence,
            "clock_count": half_second.clock_count,
            "increments": half_second.increments,
            "true_arcsec": true_arcsec,
            "rate_arcsec_s": now.rate_control_arcsec_s,
            "theta_deg": angle(now.theta_rad),
            "psi_deg": angle(now.psi_rad),
            "gyro_flags": half_second.gyro_flags,
            "unit_flags": half_second.unit_flags,
            "electronics_c": f64::from(half_second.electronics_centi_c) / 100.0,
            "sensor_c": f64::from(half_second.sensor_centi_c) / 100.0,
            "cyclic": ended.cyclic,
            "wire": {
                "serial": carried(&self.serial).iter().map(Content::to_string).collect::<String>(),
                "can": carried(&self.can).iter().map(Content::to_string).collect::<Vec<_>>(),
            },
            "links": self.links(),
            "lateness": {
                "count": counts.lateness.count(), "p50_us": us(counts.lateness.percentile_ns(0.5)),
                "p99_us": us(counts.lateness.percentile_ns(0.99)), "max_us": us(counts.lateness.max_ns()),
            },
            "late": counts.late,
            "missed": counts.missed,
            "faults": self.faults(),
        })
    }

    /// Whether a half second that is not sent by itself is there to be polled.
    fn is_polled(&self, ended: &Ended) -> bool {
        ended.half_second.unit_flags & geu_protocol::field::unit_flag("polled") != 0
    }

    fn links(&self) -> Value {
        let link = |(kind, tally): &(LinkKind, Arc<Tally>)| {
            json!({
                "name": tally.name, "kind": kind.name(), "clients": tally.clients.load(Relaxed),
                "sent": tally.sent.load(Relaxed), "dropped": tally.dropped.load(Relaxed),
                "replies": tally.replies.load(Relaxed),
            })
        };
        self.links.iter().map(link).collect()
    }

    fn faults(&self) -> Value {
        let now_s = self.desk.running().0 as f64 * 0.5;
        self.desk.faults().planned.iter().map(|planned| stands(planned, now_s)).collect()
    }
}

/// How a fault stands.
fn stands(planned: &Planned, now_s: f64) -> Value {
    let (fault, on_board_s) = (&planned.fault, |frame: u64| frame as f64 * 0.5);
    let state = match planned.since() {
        Some(_) => "active",
        None if planned.is_over() || fault.until_s <= now_s => "over",
        None => "armed",
    };
    json!({
        "id": fault.id,
        "what": fault.action.name(),
        "gyro": fault.gyro.map(|gyro| gyro.name()),
        "link": fault.link.map(LinkKind::name),
        "state": state,
        "trigger": fault.trigger(),
        "by_hand": fault.by_hand,
        "started": planned.started,
        "since_s": planned.since().map(on_board_s),
        "until_s": planned.end().map(on_board_s),
    })
}

/// Identifiers in a message.
fn listed<'a>(ids: impl Iterator<Item = &'a str>) -> String {
    let ids: Vec<&str> = ids.collect();
    if ids.is_empty() { "there is none".to_owned() } else { ids.join(", ") }
}

/// One value of JSON as TOML has it.
fn toml_of(value: &Value) -> Option<toml_edit::Value> {
    Some(match value {
        Value::Null => return None,
        Value::Bool(flag) => (*flag).into(),
        Value::Number(number) => match number.as_i64() {
            Some(whole) => whole.into(),
            None => number.as_f64()?.into(),
        },
        Value::String(text) => text.as_str().into(),
        Value::Array(values) => values.iter().filter_map(toml_of).collect::<toml_edit::Array>().into(),
        Value::Object(map) => {
            let pairs = map.iter().filter_map(|(key, value)| Some((key.as_str(), toml_of(value)?)));
            pairs.collect::<toml_edit::InlineTable>().into()
        }
    })
}

impl Bench for LiveBench {
    fn status(&self) -> Value {
        let mut status = lock(&self.0.last).clone();
        if !status.is_object() {
            let (links, faults) = (self.known().links(), self.known().faults());
            status = json!({ "half_second": 0, "lateness": { "count": 0 }, "links": links, "faults": faults });
        }
        let truth = ["t_s", "true_arcsec", "rate_arcsec_s", "theta_deg", "psi_deg"];
        status["truth"] =
            truth.into_iter().map(|key| (key.to_owned(), status[key].clone())).collect::<Map<_, _>>().into();
        status["version"] = json!(env!("CARGO_PKG_VERSION"));
        status["lost"] = json!(self.0.lost.load(Relaxed));
        let (commands, rejected) = (&self.known().desk.commands, &self.known().desk.rejected);
        status["commands"] = json!({ "answered": commands.load(Relaxed), "rejected": rejected.load(Relaxed) });
        status
    }

    fn catalogue(&self) -> Value {
        catalogue::catalogue()
    }

    fn faults(&self) -> Value {
        self.known().faults()
    }

    fn inject(&self, fault: &Map<String, Value>) -> Result<Value, String> {
        let desk = &self.known().desk;
        if let (Some(Value::String(id)), 1) = (fault.get("start"), fault.len()) {
            return match desk.start(id) {
                Some(at_s) => Ok(json!({ "id": id, "state": "armed", "at_s": at_s })),
                None => {
                    let planned = desk.faults().planned;
                    let waiting = planned.iter().filter(|planned| planned.waits_for_hand());
                    let there = listed(waiting.map(|planned| planned.fault.id.as_str()));
                    Err(format!(
                        "expected the identifier of a fault with by_hand = true that still waits ({there}) for `start`, got {id:?}"
                    ))
                }
            };
        }
        let mut document = toml_edit::DocumentMut::new();
        for (key, value) in fault {
            if let Some(value) = toml_of(value) {
                document.insert(key, toml_edit::Item::Value(value));
            }
        }
        let text = document.to_string();
        // Read without the desk, which the thread that keeps time may want meanwhile.
        let fault = loop {
            let there: Vec<Fault> = desk.faults().planned.iter().map(|planned| Fault::clone(&planned.fault)).collect();
            let fault = read_fault_text("fault", &text, &there).map_err(|error| error.message)?;
            let open: Vec<LinkKind> = self.known().links.iter().map(|(kind, _)| *kind).collect();
            if let Some(reason) = fault.misses(&open) {
                return Err(reason);
            }
            let now_s = desk.running().0 as f64 * 0.5;
            if fault.until_s <= now_s + 0.5 {
                let until_s = fault.until_s;
                return Err(format!("expected a time to come for `until_s`, after {} s, got {until_s}", now_s + 0.5));
            }
            // Somebody else may have taken the identifier by now.
            if let Some(fault) = desk.inject(fault) {
                break fault;
            }
        };
        Ok(json!({ "id": fault.id, "state": "armed", "at_s": fault.at_s, "keys": fault_log::keys(&fault) }))
    }

    fn clear(&self, id: &str) -> Result<Value, String> {
        let until_s = self.known().desk.clear(id);
        until_s.map(|until_s| json!({ "id": id, "until_s": until_s })).ok_or_else(|| {
            let planned = self.known().desk.faults().planned;
            let there =
                listed(planned.iter().filter(|planned| !planned.is_over()).map(|planned| planned.fault.id.as_str()));
            format!("expected the identifier of a fault that is armed or active ({there}), got {id:?}")
        })
    }

    fn clear_all(&self) -> Value {
        let planned = self.known().desk.faults().planned;
        let ids = planned.iter().filter(|planned| !planned.is_over()).map(|planned| planned.fault.id.clone());
        let cleared: Vec<String> = ids.filter(|id| self.known().desk.clear(id).is_some()).collect();
        json!({ "cleared": cleared })
    }

    fn command(&self, payload: Vec<u8>) -> impl Future<Output = Value> + Send {
        let desk = self.known().desk.clone();
        async move {
            let answered = desk.command("control", &payload).await;
            match &answered.reply {
                Some(reply) => control::reply(reply, answered.polled.as_ref()),
                None => json!({ "outcome": "no reply: a fault keeps the unit silent" }),
            }
        }
    }

    fn timeline(&self) -> Vec<Arc<str>> {
        lock(&self.0.timeline).iter().cloned().collect()
    }

    fn subscribe(&self) -> broadcast::Receiver<Shown> {
        self.0.events.subscribe()
    }
}
