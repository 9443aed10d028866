//! The unit behind one lock, shared by the cadence thread and the clients that command it.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread;
use std::time::{Duration, Instant};

use geu_model::configuration::RecordedCommand;
use geu_model::fault::Fault;
use geu_model::fault::acting::{Acting, Faults, Happening, Planned};
use geu_model::units::HALF_SECOND_S;
use geu_model::{Configuration, Ended, Injected, Trace, Truth, Unit};
use geu_protocol::{HalfSecond, Reply};
use tokio::sync::Notify;

use crate::cadence::Speed;
use crate::console;
use crate::control_service::EventPublisher;
use crate::link_model::{LinkModel, Transmission};
use crate::recorder::UnitEvent;
use crate::recorder_thread::{self, Feed};

/// The time keeper steps aside for commands so long at most.
const ASIDE: Duration = Duration::from_millis(2);

/// The answer to a command, as it goes back to whoever asked.
pub(crate) struct LinkResponse {
    /// Nothing from a unit that a fault keeps silent.
    pub reply: Option<Reply>,
    /// The messages that follow the reply.
    pub polled: Option<HalfSecond>,
    /// The faults of the running half second.
    acting: Arc<Vec<Acting>>,
    /// On-board time against the wall clock.
    speed: Speed,
}

impl LinkResponse {
    /// What leaves over a link, each so long after now, by the wall clock.
    pub fn leaving(&self, model: &LinkModel) -> Vec<Transmission> {
        let Some(reply) = &self.reply else { return Vec::new() };
        let mut transmissions: Vec<Transmission> = model.reply(reply, &self.acting).into_iter().collect();
        transmissions.extend(self.polled.iter().flat_map(|polled| model.polled(polled, reply, &self.acting)));
        for transmission in &mut transmissions {
            transmission.after_ns = self.speed.wall_ns(transmission.after_ns).unwrap_or(0);
        }
        transmissions
    }
}

/// A half second on its way: ended in the unit a moment early, so that it can be encoded before its deadline. Until
/// that has passed no command is carried out, so that the unit, the recording and a POLL agree on what came when.
struct PendingSample {
    ended: Ended,
    traces: Option<Box<[Trace; 4]>>,
    injected: Option<Arc<Injected>>,
    happened: Vec<Happening>,
    /// What was driven meanwhile: told behind it.
    driven: Vec<UnitEvent>,
}

struct Inner {
    unit: Unit,
    /// The last half second whose deadline has passed, and its scheduled end: what a POLL gives.
    completed: Option<(HalfSecond, i64)>,
    underway: Option<PendingSample>,
    /// Commands of a recorded run, still to be carried out again.
    recorded: VecDeque<RecordedCommand>,
    recording: Option<Feed>,
    bench: Option<EventPublisher>,
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
        bench: Option<EventPublisher>,
    ) -> SharedUnit {
        let unit = Unit::on(configuration, truth);
        let recorded = configuration.run.commands.iter().cloned().collect();
        let status = recording.as_ref().map(|feed| feed.status().clone());
        let mut inner = Inner { unit, completed: None, underway: None, recorded, recording, bench };
        let happened = inner.unit.take_happened();
        inner.tell_happened(happened);
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

    /// Half seconds ended, and the scheduled end of the one that runs, ns.
    pub fn running(&self) -> (u64, i64) {
        let inner = self.lock();
        (inner.unit.ended(), inner.unit.running_end_ns())
    }

    /// How far the truth must be known to end the running half second.
    pub fn needs_truth_s(&self) -> f64 {
        self.lock().unit.needs_truth_s()
    }

    /// Variables of a fault's condition that the truth does not tell.
    pub fn untold(&self) -> &'static [&'static str] {
        self.lock().unit.motion().untold()
    }

    /// Ends the running half second, and tells what faults did to it. Until [`SharedUnit::complete`] commands wait.
    pub fn end_half_second(&self) -> (Ended, Option<Arc<Injected>>) {
        let mut inner = self.lock();
        inner.repeat_recorded();
        let (ended, traces) = if inner.recording.is_some() || inner.bench.is_some() {
            let (ended, traces) = inner.unit.end_half_second_traced();
            (ended, Some(Box::new(traces)))
        } else {
            (inner.unit.end_half_second(), None)
        };
        let (injected, happened) = (inner.unit.injected().cloned(), inner.unit.take_happened());
        inner.underway =
            Some(PendingSample { ended, traces, injected: injected.clone(), happened, driven: Vec::new() });
        (ended, injected)
    }

    /// The deadline of the half second that was ended last has passed.
    pub fn complete(&self) {
        self.lock().complete();
        self.passed.notify_waiters();
    }

    /// The same of one that comes too late to be sent.
    pub fn complete_unsent(&self) {
        let mut inner = self.lock();
        inner.complete();
        let frame = inner.unit.ended() - 1;
        inner.tell(UnitEvent::Missed { frame });
        drop(inner);
        self.passed.notify_waiters();
    }

    /// The last half second whose deadline has passed.
    pub fn completed(&self) -> Option<HalfSecond> {
        self.lock().completed.map(|(half_second, _)| half_second)
    }

    /// How the recording of the unit stands; `None` without one.
    pub fn recording(&self) -> Option<&recorder_thread::Status> {
        self.recording.as_deref()
    }

    /// Carries out the payload of a COMMAND that came over `link`; shortly before a deadline it waits for that. Its answer
    /// waits until it is recorded, but not for long.
    pub async fn command(&self, link: &str, payload: &[u8]) -> LinkResponse {
        if self.is_recording {
            if self.commands.fetch_add(1, Relaxed) == 0 {
                console::say(format_args!("{link}: a command came; a recording answers none: they are counted"));
            }
            return LinkResponse { reply: None, polled: None, acting: Arc::default(), speed: self.speed };
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

    /// Carries it out unless a half second is underway, or the run is over; how much the recording was told by then.
    fn try_command(&self, link: &str, payload: &[u8]) -> Option<(LinkResponse, Option<u64>)> {
        let mut inner = self.lock();
        if inner.underway.is_some() || self.is_closed.load(Relaxed) {
            return None;
        }
        self.commands.fetch_add(1, Relaxed);
        let answered = inner.command(link, payload, self.speed);
        Some((answered, inner.told()))
    }

    /// Waits until the recording has what was driven, but not for long.
    fn await_recorded(&self) {
        let Some(recording) = &self.recording else { return };
        // What is driven while a half second is underway is told behind it.
        let told = || {
            let inner = self.lock();
            if inner.underway.is_none() { Some(inner.told().unwrap_or(0)) } else { None }
        };
        let last = std::cell::Cell::new(None);
        recording.await_written_blocking(|| {
            last.set(last.get().or_else(told));
            last.get()
        });
    }

    /// How faults and expectations stand.
    pub fn faults(&self) -> Faults {
        self.lock().unit.faults().clone()
    }

    /// On-board time, and how the faults stand that are not over by then: few, however many there were.
    pub fn faults_now(&self) -> (f64, Vec<Planned>) {
        let inner = self.lock();
        let now_s = inner.unit.ended() as f64 * HALF_SECOND_S;
        let planned = inner.unit.faults().planned.iter();
        (now_s, planned.filter(|planned| !planned.is_over_by(now_s)).cloned().collect())
    }

    /// Adds faults, all from the next half second on; none where there are others by now than the `known` ones, which they
    /// were read for, or where the time of one has passed.
    pub fn inject(&self, known: usize, faults: &[Fault]) -> Option<Vec<Fault>> {
        let mut inner = self.lock();
        let start_s = (inner.unit.ended() + 1) as f64 * HALF_SECOND_S;
        if inner.unit.faults().planned.len() != known || faults.iter().any(|fault| fault.until_s <= start_s) {
            return None;
        }
        let added: Vec<Fault> = faults.iter().map(|fault| inner.unit.inject(fault.clone())).collect();
        added.iter().for_each(|fault| inner.tell_driven(UnitEvent::Injected(fault.clone())));
        drop(inner);
        self.await_recorded();
        Some(added)
    }

    /// Starts a fault that waits for a hand, with the next half second: on-board time; nothing where there is none.
    pub fn start(&self, id: &str) -> Option<f64> {
        let mut inner = self.lock();
        let at_s = inner.unit.start(id)?;
        inner.tell_driven(UnitEvent::StartedByHand { id: id.to_owned(), at_s });
        drop(inner);
        self.await_recorded();
        Some(at_s)
    }

    /// Takes a fault away from the next half second on; its end, on-board time, or nothing where there is none.
    pub fn clear(&self, id: &str) -> Option<f64> {
        let until_s = self.lock().clear(id)?;
        self.await_recorded();
        Some(until_s)
    }

    /// Takes all faults away that are not over; their identifiers.
    pub fn clear_all(&self) -> Vec<String> {
        let mut inner = self.lock();
        let planned = inner.unit.faults().planned.iter();
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
        inner.repeat_recorded();
        (inner.recording, inner.bench) = (None, None);
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
    fn tell(&mut self, event: UnitEvent) {
        if let Some(bench) = &mut self.bench {
            bench.tell(&event, self.unit.motion());
        }
        // A recording that has ended has said so.
        if self.recording.as_mut().is_some_and(|recording| !recording.tell(event)) {
            self.recording = None;
        }
    }

    /// How much the recording was told.
    fn told(&self) -> Option<u64> {
        self.recording.as_ref().map(Feed::told)
    }

    fn clear(&mut self, id: &str) -> Option<f64> {
        let until_s = self.unit.clear(id)?;
        self.tell_driven(UnitEvent::Cleared { id: id.to_owned(), until_s });
        Some(until_s)
    }

    /// Carries out again what a recorded run had received by now.
    fn repeat_recorded(&mut self) {
        while self.recorded.front().is_some_and(|command| command.half_second <= self.unit.ended()) {
            let command = self.recorded.pop_front().expect("the front is there");
            self.command(&command.link, &command.payload, Speed::Max);
        }
    }

    fn complete(&mut self) {
        if let Some(PendingSample { ended, traces, injected, happened, driven }) = self.underway.take() {
            self.completed = Some((ended.half_second, ended.end_ns));
            if let Some(traces) = traces {
                self.tell(UnitEvent::HalfSecond(ended, traces, injected));
            }
            self.tell_happened(happened);
            driven.into_iter().for_each(|event| self.tell(event));
        }
    }

    /// Tells what somebody did to the faults: behind a half second that is underway, which has ended in the unit.
    fn tell_driven(&mut self, event: UnitEvent) {
        match &mut self.underway {
            Some(underway) => underway.driven.push(event),
            None => self.tell(event),
        }
    }

    fn tell_happened(&mut self, happened: Vec<Happening>) {
        happened.into_iter().for_each(|happening| self.tell(UnitEvent::Happened(happening)));
    }

    fn command(&mut self, link: &str, payload: &[u8], speed: Speed) -> LinkResponse {
        let running_end_ns = self.unit.running_end_ns();
        let answer = self.unit.command(payload);
        let acting = self.unit.faults().acting().clone();
        let (reply, polled) = (answer.map(|answer| answer.reply), answer.ok().and_then(|answer| answer.polled));
        self.tell(UnitEvent::Command {
            link: link.to_owned(),
            payload: payload.to_vec(),
            running_end_ns,
            reply,
            acting: acting.clone(),
        });
        let reply = reply.ok();
        if let (Some(reply), Some(half_second), Some((_, end_ns))) = (reply, polled, self.completed) {
            let (link, injected) = (link.to_owned(), self.unit.injected().cloned());
            self.tell(UnitEvent::Polled { link, half_second, reply, end_ns, injected, acting: acting.clone() });
        }
        LinkResponse { reply, polled, acting, speed }
    }
}

#[cfg(test)]
mod tests {
    use std::future::Future;
    use std::task::{Context, Poll, Waker};

    use geu_protocol::Outcome;

    use super::*;

    fn now(shared: &SharedUnit, payload: &[u8]) -> LinkResponse {
        shared.try_command("test", payload).expect("nothing is underway").0
    }

    #[test]
    fn a_command_just_before_the_deadline_is_carried_out_just_after_it() {
        let shared = SharedUnit::new(&Configuration::reference(), &Truth::Scenario, Speed::Max, None, None);
        assert_eq!(now(&shared, &[2, 1]).reply.expect("heard").outcome(), Outcome::Done);
        assert_eq!(now(&shared, &[3]).reply.expect("heard").outcome(), Outcome::NotPossibleNow);
        let (first, _) = shared.end_half_second();
        assert!(!first.cyclic);
        let mut poll = std::pin::pin!(shared.command("test", &[3]));
        let mut context = Context::from_waker(Waker::noop());
        assert!(poll.as_mut().poll(&mut context).is_pending());
        assert_eq!(shared.waiting.load(Relaxed), 1);
        shared.complete();
        let Poll::Ready(answered) = poll.as_mut().poll(&mut context) else { panic!("nothing to wait for") };
        assert_eq!(answered.polled, Some(first.half_second));
        assert_eq!(shared.waiting.load(Relaxed), 0);
        let (second, _) = shared.end_half_second();
        assert!(shared.try_command("test", &[3]).is_none());
        shared.complete();
        assert_eq!(now(&shared, &[3]).polled, Some(second.half_second));
        assert_eq!(now(&shared, &[3]).polled, Some(second.half_second));
    }

    #[test]
    fn what_is_driven_while_a_half_second_is_underway_is_told_behind_it() {
        let (recording, events) = recorder_thread::unwritten_feed();
        let mut configuration = Configuration::reference();
        let plan = "[[fault]]\nid = \"waits\"\nby_hand = true\nfault = \"drop\"\n[[fault]]\nid = \"dead\"\nfault = \"dead\"\ngyro = \"GYRX\"";
        configuration.add_plan("plan", plan).expect("a plan");
        let shared = SharedUnit::new(&configuration, &Truth::Scenario, Speed::Max, Some(recording), None);
        shared.end_half_second();
        assert_eq!(shared.start("waits"), Some(1.0), "with the next half second that begins");
        assert_eq!(shared.clear("dead"), Some(1.0));
        shared.complete();
        shared.close();
        let told = events.into_iter().map(|event| match event {
            UnitEvent::HalfSecond(..) => "half second",
            UnitEvent::Happened(_) => "happened",
            UnitEvent::StartedByHand { .. } => "started",
            UnitEvent::Cleared { .. } => "cleared",
            _ => "else",
        });
        assert_eq!(told.collect::<Vec<_>>(), ["happened", "half second", "started", "cleared"]);
    }

    #[test]
    fn what_is_told_to_the_recording_happens_again_in_a_unit_of_its_own() {
        let configuration = Configuration::reference();
        let (recording, events) = recorder_thread::unwritten_feed();
        let shared = SharedUnit::new(&configuration, &Truth::Scenario, Speed::Max, Some(recording), None);
        let payloads: [&[u8]; 8] = [&[1], &[2, 1], &[3], &[5], &[3], &[2, 0], &[4, 1, 0, 5, 3], &[3]];
        let mut context = Context::from_waker(Waker::noop());
        for index in 0..400 {
            let payload = payloads[((index * 5) ^ (index / 8)) % 8];
            let mut command = std::pin::pin!(shared.command("test", payload));
            let is_early = index % 3 == 0;
            if is_early {
                assert!(command.as_mut().poll(&mut context).is_ready());
            }
            shared.end_half_second();
            if !is_early {
                assert!(command.as_mut().poll(&mut context).is_pending());
            }
            shared.complete();
            if !is_early {
                assert!(command.as_mut().poll(&mut context).is_ready());
            }
        }
        shared.close();
        let mut unit = Unit::new(&configuration);
        let (mut polled, mut end_ns, mut polls) = (None, 0, 0);
        for event in events {
            match event {
                UnitEvent::HalfSecond(ended, traces, _) => {
                    assert_eq!((ended, *traces), unit.end_half_second_traced());
                    end_ns = ended.end_ns;
                }
                UnitEvent::Command { payload, running_end_ns, .. } => {
                    assert_eq!(running_end_ns, unit.running_end_ns());
                    assert_eq!(polled, None, "a recorded POLL has its data");
                    polled = unit.command(&payload).expect("heard").polled;
                }
                UnitEvent::Polled { half_second, end_ns: stamp_ns, .. } => {
                    polls += 1;
                    assert_eq!((Some(half_second), stamp_ns), (polled.take(), end_ns));
                }
                _ => unreachable!("no fault"),
            }
        }
        assert!(polls > 20 && unit.ended() == 400, "{polls}");
    }
}
