//! The unit behind one lock, shared by the cadence thread and the clients that command it.
//!
//! Uses the event source (the unit), the recorder thread and the link model. Links, the control service and the run use it,
//! not the reverse: its events reach the control service through [`Observer`].

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use geu_model::attitude::Motion;
use geu_model::device::Device;
use geu_model::fault::Fault;
use geu_model::fault::engine::{FaultEngine, FaultStatus};
use geu_model::{CompletedSample, Configuration, InjectionRecord, Truth};
use tokio::sync::Notify;

use crate::cadence::Speed;
use crate::console;
use crate::host::{self, Instant};
use crate::recorder_thread::{self, Feed};
use geu_recorder::UnitEvent;
use geu_recorder::link_model::{LinkModel, Transmission};
use geu_recorder::{CommandResponse, EventSource};

/// Maximum time for which the cadence thread yields to commands.
const YIELD_LIMIT: Duration = Duration::from_millis(2);

/// Receives the events of the unit, in order.
pub(crate) trait Observer: Send {
    /// Accepts an event without waiting.
    fn observe(&mut self, event: &UnitEvent, motion: &Motion);
}

/// A sample before its deadline: ended in the unit a moment early, so that it can be encoded in time. Until the deadline has
/// passed no command is executed, so that the unit, the recording and a POLL agree on the order.
struct PendingSample {
    sample: CompletedSample,
    /// Published at the deadline.
    events: Vec<UnitEvent>,
}

struct Inner {
    source: EventSource,
    /// The last sample with a deadline in the past, which a POLL returns.
    completed: Option<CompletedSample>,
    pending: Option<PendingSample>,
    recording: Option<Feed>,
    observer: Option<Box<dyn Observer>>,
}

/// The unit and the counts of its commands.
pub(crate) struct SharedUnit {
    pub device: Arc<Device>,
    inner: Mutex<Inner>,
    speed: Speed,
    /// A deadline has passed: commands that came shortly before it can be executed.
    passed: Notify,
    /// Number of commands that wait for the unit; the cadence thread yields to them.
    waiting: AtomicUsize,
    /// A recording is replayed in place of a unit: commands are counted and get no reply.
    is_replay: bool,
    recording: Option<Arc<recorder_thread::Status>>,
    /// The run has ended: commands are neither executed nor recorded.
    is_closed: AtomicBool,
    /// Commands executed or refused.
    pub commands: AtomicU64,
    /// Frames dropped without a reply: wrong CRC or length, truncated, remote or extended.
    pub rejected: AtomicU64,
}

impl SharedUnit {
    pub fn new(
        configuration: &Configuration,
        truth: &Truth,
        speed: Speed,
        recording: Option<Feed>,
        observer: Option<Box<dyn Observer>>,
    ) -> SharedUnit {
        let status = recording.as_ref().map(|feed| feed.status.clone());
        let source = EventSource::new(configuration, truth);
        let mut inner = Inner { source, completed: None, pending: None, recording, observer };
        inner.publish_from(EventSource::take_happened);
        SharedUnit {
            device: configuration.device.clone(),
            inner: Mutex::new(inner),
            speed,
            passed: Notify::new(),
            waiting: AtomicUsize::new(0),
            is_replay: false,
            recording: status,
            is_closed: AtomicBool::new(false),
            commands: AtomicU64::new(0),
            rejected: AtomicU64::new(0),
        }
    }

    /// A replayed recording in place of a unit.
    pub fn replay(configuration: &Configuration, speed: Speed) -> SharedUnit {
        let shared = SharedUnit::new(configuration, &Truth::Scenario, speed, None, None);
        SharedUnit { is_replay: true, ..shared }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        host::lock(&self.inner)
    }

    /// Yields to waiting commands for a limited time: at full speed they would hardly ever get the lock.
    pub fn yield_to_commands(&self) {
        let start = Instant::now();
        while self.waiting.load(Relaxed) > 0 && start.elapsed() < YIELD_LIMIT {
            host::yield_thread();
        }
    }

    /// Number of samples ended, and the scheduled end of the running one, ns.
    pub fn running(&self) -> (u64, i64) {
        let inner = self.lock();
        (inner.source.unit.ended(), inner.source.unit.running_end_ns())
    }

    /// Time up to which the truth must be known to end the running sample interval, s.
    pub fn needs_truth_s(&self) -> f64 {
        self.lock().source.unit.needs_truth_s()
    }

    /// Variables of fault conditions that the truth does not provide.
    pub fn unavailable(&self) -> &'static [&'static str] {
        self.lock().source.unit.motion().unavailable()
    }

    /// Ends the running sample interval, and returns it with the faults that acted. Until [`SharedUnit::complete`] commands
    /// wait.
    pub fn end_sample(&self) -> (CompletedSample, Option<Arc<InjectionRecord>>) {
        let mut inner = self.lock();
        inner.publish_from(EventSource::repeat_recorded);
        let mut events = Vec::new();
        let ended = match inner.recording.is_some() || inner.observer.is_some() {
            true => inner.source.end_sample(&mut events),
            false => inner.source.end_sample_untraced(&mut events),
        };
        inner.pending = Some(PendingSample { sample: ended, events });
        (ended, inner.source.unit.injected().cloned())
    }

    /// The deadline of the last sample has passed; it was sent.
    pub fn complete(&self) {
        self.lock().complete();
        self.passed.notify_waiters();
    }

    /// The deadline of the last sample has passed by too much to send it.
    pub fn complete_unsent(&self) {
        let mut inner = self.lock();
        inner.complete();
        let frame = inner.source.unit.ended() - 1;
        inner.publish(UnitEvent::Missed { frame });
        drop(inner);
        self.passed.notify_waiters();
    }

    /// The last sample with a deadline in the past.
    pub fn completed(&self) -> Option<CompletedSample> {
        self.lock().completed
    }

    /// State of the recording of the unit, if there is one.
    pub fn recording(&self) -> Option<&recorder_thread::Status> {
        self.recording.as_deref()
    }

    /// Executes the payload of a COMMAND from `link`, shortly before a deadline only after it. The reply waits until the
    /// command is recorded, for a limited time.
    pub async fn command(&self, link: &str, payload: &[u8]) -> CommandResponse {
        if self.is_replay || !self.device.is_iras() {
            if self.commands.fetch_add(1, Relaxed) == 0 {
                let reason = if self.is_replay { "replay sends no replies" } else { "this unit has no commands" };
                console::say(format_args!("{link}: command ignored: {reason} (counted)"));
            }
            return CommandResponse { reply: None, polled: None, acting: Arc::default() };
        }
        let waiting = Waiting::new(&self.waiting);
        let (response, recorded) = loop {
            // Created before the attempt, so that a deadline that passes in between is not missed.
            let passed = self.passed.notified();
            if let Some(executed) = self.try_command(link, payload) {
                break executed;
            }
            passed.await;
        };
        drop(waiting);
        if let Some(recording) = &self.recording {
            recording.await_written(recorded).await;
        }
        response
    }

    /// Executes it, and returns the number of events published by then; `None` while a sample is pending, or after the run.
    fn try_command(&self, link: &str, payload: &[u8]) -> Option<(CommandResponse, u64)> {
        let mut inner = self.lock();
        if inner.pending.is_some() || self.is_closed.load(Relaxed) {
            return None;
        }
        self.commands.fetch_add(1, Relaxed);
        let response = inner.publish_from(|source, events| source.command(link, payload, events));
        Some((response, inner.events_to_record()))
    }

    /// The transmissions of a response over a link, with delays on the wall clock.
    pub fn transmissions(&self, response: &CommandResponse, model: &LinkModel) -> Vec<Transmission> {
        let CommandResponse { reply: Some(reply), polled, acting } = response else { return Vec::new() };
        let mut transmissions: Vec<Transmission> = model.reply(reply, acting).into_iter().collect();
        transmissions.extend(polled.iter().flat_map(|polled| model.polled(polled, reply, acting)));
        for transmission in &mut transmissions {
            transmission.after_ns = self.speed.wall_ns(transmission.after_ns).unwrap_or(0);
        }
        transmissions
    }

    /// State of faults and expectations.
    pub fn faults(&self) -> FaultEngine {
        self.lock().source.unit.faults().clone()
    }

    /// On-board time, and the faults that have not ended by then: few, however many there were.
    pub fn faults_now(&self) -> (f64, Vec<FaultStatus>) {
        let inner = self.lock();
        let now_s = self.device.on_board_s(inner.source.unit.ended());
        let planned = inner.source.unit.faults().planned.iter();
        (now_s, planned.filter(|planned| !planned.is_over_by(now_s)).cloned().collect())
    }

    /// Adds faults from the next sample on. `None` if the number of faults is no longer `known`, against which they were
    /// read, or if the time of one has passed.
    pub fn inject(&self, known: usize, faults: &[Fault]) -> Option<Vec<Fault>> {
        self.drive(|inner| {
            let start_s = self.device.on_board_s(inner.source.unit.ended() + 1);
            let is_known = inner.source.unit.faults().planned.len() == known;
            if !is_known || faults.iter().any(|fault| fault.until_s <= start_s) {
                return None;
            }
            let added: Vec<Fault> = faults.iter().map(|fault| inner.source.unit.inject(fault.clone())).collect();
            added.iter().for_each(|fault| inner.publish_driven(UnitEvent::Injected(fault.clone())));
            Some(added)
        })
    }

    /// Starts a fault that waits for the operator, with the next sample, and returns its on-board time; `None` if there is
    /// no such fault.
    pub fn start(&self, id: &str) -> Option<f64> {
        self.drive(|inner| {
            let at_s = inner.source.unit.start(id)?;
            inner.publish_driven(UnitEvent::StartedByHand { id: id.to_owned(), at_s });
            Some(at_s)
        })
    }

    /// Removes a fault from the next sample on, and returns its end in on-board time; `None` if there is no such fault.
    pub fn clear(&self, id: &str) -> Option<f64> {
        self.drive(|inner| inner.clear(id))
    }

    /// Removes all faults that have not ended, and returns their identifiers.
    pub fn clear_all(&self) -> Vec<String> {
        self.drive(|inner| {
            let planned = inner.source.unit.faults().planned.iter();
            let active = planned.filter(|planned| !planned.is_over());
            let mut ids: Vec<String> = active.map(|planned| planned.fault.id.clone()).collect();
            ids.retain(|id| inner.clear(id).is_some());
            Some(ids)
        })
        .unwrap_or_default()
    }

    /// Changes the faults, and waits until a change is recorded, for a limited time.
    fn drive<T>(&self, act: impl FnOnce(&mut Inner) -> Option<T>) -> Option<T> {
        let mut inner = self.lock();
        let driven = act(&mut inner)?;
        let count = inner.events_to_record();
        drop(inner);
        if let Some(recording) = &self.recording {
            recording.await_written_blocking(count);
        }
        Some(driven)
    }

    /// Ends the recording; from now on no command is answered.
    pub fn close(&self) {
        self.is_closed.store(true, Relaxed);
        let mut inner = self.lock();
        inner.publish_from(EventSource::repeat_recorded);
        (inner.recording, inner.observer) = (None, None);
    }
}

#[cfg(test)]
impl SharedUnit {
    /// True once commands are no longer answered.
    pub fn is_closed(&self) -> bool {
        self.is_closed.load(Relaxed)
    }
}

/// Counts a command as waiting during its lifetime.
struct Waiting<'a>(&'a AtomicUsize);

impl<'a> Waiting<'a> {
    fn new(count: &'a AtomicUsize) -> Waiting<'a> {
        count.fetch_add(1, Relaxed);
        Waiting(count)
    }
}

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Relaxed);
    }
}

impl Inner {
    fn publish(&mut self, event: UnitEvent) {
        if let Some(observer) = &mut self.observer {
            observer.observe(&event, self.source.unit.motion());
        }
        // A recording that has ended has logged that.
        self.recording.take_if(|recording| !recording.push(event));
    }

    /// Publishes the events that `act` adds.
    fn publish_from<T>(&mut self, act: impl FnOnce(&mut EventSource, &mut Vec<UnitEvent>) -> T) -> T {
        let mut events = Vec::new();
        let result = act(&mut self.source, &mut events);
        events.into_iter().for_each(|event| self.publish(event));
        result
    }

    /// Number of events of the recording, with the events of the pending sample; 0 without a recording.
    fn events_to_record(&self) -> u64 {
        let pending = self.pending.as_ref().map_or(0, |pending| pending.events.len() as u64);
        self.recording.as_ref().map_or(0, |recording| recording.count + pending)
    }

    fn clear(&mut self, id: &str) -> Option<f64> {
        let until_s = self.source.unit.clear(id)?;
        self.publish_driven(UnitEvent::Cleared { id: id.to_owned(), until_s });
        Some(until_s)
    }

    fn complete(&mut self) {
        if let Some(PendingSample { sample, events }) = self.pending.take() {
            self.completed = Some(sample);
            events.into_iter().for_each(|event| self.publish(event));
        }
    }

    /// Publishes a change of the faults by the operator: after the pending sample, which has ended in the unit.
    fn publish_driven(&mut self, event: UnitEvent) {
        match &mut self.pending {
            Some(pending) => pending.events.push(event),
            None => self.publish(event),
        }
    }
}

#[cfg(test)]
mod tests;
