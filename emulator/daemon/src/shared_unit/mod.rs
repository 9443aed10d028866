//! The unit behind one lock, shared by the cadence thread and the clients that command it.
//!
//! Uses the event source (the unit), the recorder's thread and the link model. Links, the control service and the run use it;
//! it knows none of these: what happens reaches the control service through [`Observer`].

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread;
use std::time::{Duration, Instant};

use geu_model::attitude::Motion;
use geu_model::fault::Fault;
use geu_model::fault::acting::{FaultEngine, FaultStatus};
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_model::{CompletedSample, Configuration, InjectionRecord, Truth};
use geu_protocol::Sample;
use tokio::sync::Notify;

use crate::cadence::Speed;
use crate::console;
use crate::event_source::{CommandResponse, EventSource};
use crate::link_model::{LinkModel, Transmission};
use crate::recorder::UnitEvent;
use crate::recorder_thread::{self, Feed};

/// The time keeper steps aside for commands so long at most.
const ASIDE: Duration = Duration::from_millis(2);

/// Gets the events of the unit, in order.
pub(crate) trait Observer: Send {
    /// Takes what happened, without waiting.
    fn observe(&mut self, event: &UnitEvent, motion: &Motion);
}

/// A sample before its deadline: ended in the unit a moment early, so that it can be encoded in time. Until that has passed
/// no command is carried out, so that the unit, the recording and a POLL agree on what came when.
struct PendingSample {
    sample: Sample,
    /// Published at the deadline.
    events: Vec<UnitEvent>,
}

struct Inner {
    source: EventSource,
    /// The last sample whose deadline has passed: what a POLL gives.
    completed: Option<Sample>,
    pending: Option<PendingSample>,
    recording: Option<Feed>,
    observer: Option<Box<dyn Observer>>,
}

/// The unit, and what is known of its commands.
pub(crate) struct SharedUnit {
    inner: Mutex<Inner>,
    speed: Speed,
    /// A deadline has passed: commands that came shortly before it are carried out.
    passed: Notify,
    /// Commands that wait for the unit; the time keeper steps aside for them.
    waiting: AtomicUsize,
    /// A recording lies there in place of a unit: commands are counted, and nobody answers.
    is_recording: bool,
    /// How the recording of the unit stands.
    recording: Option<Arc<recorder_thread::Status>>,
    /// The run is over: commands are neither carried out nor recorded.
    is_closed: AtomicBool,
    /// Commands carried out or refused.
    pub commands: AtomicU64,
    /// Frames dropped without an answer: wrong CRC or length, cut, remote or extended.
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
        let status = recording.as_ref().map(|feed| feed.status().clone());
        let source = EventSource::new(configuration, truth);
        let mut inner = Inner { source, completed: None, pending: None, recording, observer };
        inner.publish_from(EventSource::take_happened);
        SharedUnit {
            inner: Mutex::new(inner),
            speed,
            passed: Notify::new(),
            waiting: AtomicUsize::new(0),
            is_recording: false,
            recording: status,
            is_closed: AtomicBool::new(false),
            commands: AtomicU64::new(0),
            rejected: AtomicU64::new(0),
        }
    }

    /// A recording in place of a unit.
    pub fn of_recording(speed: Speed) -> SharedUnit {
        let shared = SharedUnit::new(&Configuration::reference(), &Truth::Scenario, speed, None, None);
        SharedUnit { is_recording: true, ..shared }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().expect("the model does not panic")
    }

    /// Lets commands that wait for the unit go first, for a while: at full speed they would hardly ever find it.
    pub fn step_aside(&self) {
        if self.waiting.load(Relaxed) > 0 {
            let start = Instant::now();
            while self.waiting.load(Relaxed) > 0 && start.elapsed() < ASIDE {
                thread::yield_now();
            }
        }
    }

    /// Samples ended, and the scheduled end of the one that runs, ns.
    pub fn running(&self) -> (u64, i64) {
        let inner = self.lock();
        (inner.source.unit.ended(), inner.source.unit.running_end_ns())
    }

    /// How far the truth must be known to end the running sample interval.
    pub fn needs_truth_s(&self) -> f64 {
        self.lock().source.unit.needs_truth_s()
    }

    /// Variables of a fault's condition that the truth does not tell.
    pub fn untold(&self) -> &'static [&'static str] {
        self.lock().source.unit.motion().untold()
    }

    /// Ends the running sample interval, and tells what faults did to it. Until [`SharedUnit::complete`] commands wait.
    pub fn end_sample(&self) -> (CompletedSample, Option<Arc<InjectionRecord>>) {
        let mut inner = self.lock();
        inner.publish_from(EventSource::repeat_recorded);
        let mut events = Vec::new();
        let ended = if inner.recording.is_some() || inner.observer.is_some() {
            let (ended, traces) = inner.source.end_traced();
            events.push(UnitEvent::Sample(ended, traces, inner.source.unit.injected().cloned()));
            ended
        } else {
            inner.source.end()
        };
        inner.source.take_happened(&mut events);
        inner.pending = Some(PendingSample { sample: ended.sample, events });
        let injected = inner.source.unit.injected().cloned();
        (ended, injected)
    }

    /// The deadline of the sample that was ended last has passed.
    pub fn complete(&self) {
        self.lock().complete();
        self.passed.notify_waiters();
    }

    /// The same of one that comes too late to be sent.
    pub fn complete_unsent(&self) {
        let mut inner = self.lock();
        inner.complete();
        let frame = inner.source.unit.ended() - 1;
        inner.publish(UnitEvent::Missed { frame });
        drop(inner);
        self.passed.notify_waiters();
    }

    /// The last sample whose deadline has passed.
    pub fn completed(&self) -> Option<Sample> {
        self.lock().completed
    }

    /// How the recording of the unit stands; `None` without one.
    pub fn recording(&self) -> Option<&recorder_thread::Status> {
        self.recording.as_deref()
    }

    /// Carries out the payload of a COMMAND that came over `link`; shortly before a deadline it waits for that. Its answer
    /// waits until it is recorded, but not for long.
    pub async fn command(&self, link: &str, payload: &[u8]) -> CommandResponse {
        if self.is_recording {
            if self.commands.fetch_add(1, Relaxed) == 0 {
                console::say(format_args!("{link}: a command came; a recording answers none: they are counted"));
            }
            return CommandResponse { reply: None, polled: None, acting: Arc::default() };
        }
        let waiting = Waiting::new(&self.waiting);
        let (answered, told) = loop {
            // Made before the look at the unit, so that a deadline that passes in between is not slept through.
            let passed = self.passed.notified();
            if let Some(answered) = self.try_command(link, payload) {
                break answered;
            }
            passed.await;
        };
        drop(waiting);
        if let (Some(recording), Some(told)) = (&self.recording, told) {
            recording.await_written(told).await;
        }
        answered
    }

    /// Carries it out unless a sample is underway, or the run is over; how much the recording was told by then.
    fn try_command(&self, link: &str, payload: &[u8]) -> Option<(CommandResponse, Option<u64>)> {
        let mut inner = self.lock();
        if inner.pending.is_some() || self.is_closed.load(Relaxed) {
            return None;
        }
        self.commands.fetch_add(1, Relaxed);
        let answered = inner.publish_from(|source, events| source.command(link, payload, events));
        Some((answered, inner.told()))
    }

    /// What is sent over a link in response to a command, each transmission so long after now, by the wall clock.
    pub fn transmissions(&self, response: &CommandResponse, model: &LinkModel) -> Vec<Transmission> {
        let CommandResponse { reply: Some(reply), polled, acting } = response else { return Vec::new() };
        let mut transmissions: Vec<Transmission> = model.reply(reply, acting).into_iter().collect();
        transmissions.extend(polled.iter().flat_map(|polled| model.polled(polled, reply, acting)));
        for transmission in &mut transmissions {
            transmission.after_ns = self.speed.wall_ns(transmission.after_ns).unwrap_or(0);
        }
        transmissions
    }

    /// Waits until the recording has what was driven, but not for long.
    fn await_recorded(&self) {
        let Some(recording) = &self.recording else { return };
        // What is driven while a sample is underway is told behind it.
        let told = || {
            let inner = self.lock();
            if inner.pending.is_none() { Some(inner.told().unwrap_or(0)) } else { None }
        };
        let last = std::cell::Cell::new(None);
        recording.await_written_blocking(|| {
            last.set(last.get().or_else(told));
            last.get()
        });
    }

    /// How faults and expectations stand.
    pub fn faults(&self) -> FaultEngine {
        self.lock().source.unit.faults().clone()
    }

    /// On-board time, and how the faults stand that are not over by then: few, however many there were.
    pub fn faults_now(&self) -> (f64, Vec<FaultStatus>) {
        let inner = self.lock();
        let now_s = inner.source.unit.ended() as f64 * SAMPLE_INTERVAL_S;
        let planned = inner.source.unit.faults().planned.iter();
        (now_s, planned.filter(|planned| !planned.is_over_by(now_s)).cloned().collect())
    }

    /// Adds faults, all from the next sample on; none where there are others by now than the `known` ones, which they
    /// were read for, or where the time of one has passed.
    pub fn inject(&self, known: usize, faults: &[Fault]) -> Option<Vec<Fault>> {
        let mut inner = self.lock();
        let start_s = (inner.source.unit.ended() + 1) as f64 * SAMPLE_INTERVAL_S;
        if inner.source.unit.faults().planned.len() != known || faults.iter().any(|fault| fault.until_s <= start_s) {
            return None;
        }
        let added: Vec<Fault> = faults.iter().map(|fault| inner.source.unit.inject(fault.clone())).collect();
        added.iter().for_each(|fault| inner.publish_driven(UnitEvent::Injected(fault.clone())));
        drop(inner);
        self.await_recorded();
        Some(added)
    }

    /// Starts a fault that waits for a hand, with the next sample: on-board time; nothing where there is none.
    pub fn start(&self, id: &str) -> Option<f64> {
        let mut inner = self.lock();
        let at_s = inner.source.unit.start(id)?;
        inner.publish_driven(UnitEvent::StartedByHand { id: id.to_owned(), at_s });
        drop(inner);
        self.await_recorded();
        Some(at_s)
    }

    /// Takes a fault away from the next sample on; its end, on-board time, or nothing where there is none.
    pub fn clear(&self, id: &str) -> Option<f64> {
        let until_s = self.lock().clear(id)?;
        self.await_recorded();
        Some(until_s)
    }

    /// Takes all faults away that are not over; their identifiers.
    pub fn clear_all(&self) -> Vec<String> {
        let mut inner = self.lock();
        let planned = inner.source.unit.faults().planned.iter();
        let ids: Vec<String> =
            planned.filter(|planned| !planned.is_over()).map(|planned| planned.fault.id.clone()).collect();
        let cleared = ids.into_iter().filter(|id| inner.clear(id).is_some()).collect();
        drop(inner);
        self.await_recorded();
        cleared
    }

    /// Tells the recording that no more follows; from now on no command is answered.
    pub fn close(&self) {
        self.is_closed.store(true, Relaxed);
        let mut inner = self.lock();
        inner.publish_from(EventSource::repeat_recorded);
        (inner.recording, inner.observer) = (None, None);
    }
}

/// A command that waits, for as long as this lives.
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
        // A recording that has ended has said so.
        if self.recording.as_mut().is_some_and(|recording| !recording.tell(event)) {
            self.recording = None;
        }
    }

    /// Publishes what `act` adds.
    fn publish_from<T>(&mut self, act: impl FnOnce(&mut EventSource, &mut Vec<UnitEvent>) -> T) -> T {
        let mut events = Vec::new();
        let result = act(&mut self.source, &mut events);
        events.into_iter().for_each(|event| self.publish(event));
        result
    }

    /// How much the recording was told.
    fn told(&self) -> Option<u64> {
        self.recording.as_ref().map(Feed::told)
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

    /// Publishes what an operator did to the faults: behind a pending sample, which has ended in the unit.
    fn publish_driven(&mut self, event: UnitEvent) {
        match &mut self.pending {
            Some(pending) => pending.events.push(event),
            None => self.publish(event),
        }
    }
}

#[cfg(test)]
mod tests;
