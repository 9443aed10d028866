//! The unit on the desk: one unit, shared by the thread that keeps its time and whoever commands it.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed};
use std::sync::mpsc::SyncSender;
use std::sync::{Mutex, MutexGuard};
use std::thread;

use geu_model::configuration::RecordedCommand;
use geu_model::{Configuration, Ended, Trace, Truth, Unit};
use geu_protocol::{HalfSecond, Outcome, Reply};

use crate::recording::Event;

/// The answer to a command, as it goes back to whoever asked.
pub(crate) struct Answered {
    pub reply: Reply,
    /// The messages that follow the reply.
    pub polled: Option<HalfSecond>,
}

/// A half second on its way: ended in the unit a moment early, so that it can be encoded before its deadline.
struct Underway {
    ended: Ended,
    traces: Option<Box<[Trace; 4]>>,
}

struct Inner {
    unit: Unit,
    /// The last half second whose deadline has passed, and its scheduled end: what a POLL gives.
    completed: Option<(HalfSecond, i64)>,
    underway: Option<Underway>,
    /// Commands of a recorded run, still to be carried out again.
    recorded: VecDeque<RecordedCommand>,
    recording: Option<SyncSender<Event>>,
}

/// The unit, and what is known of its commands.
pub(crate) struct Desk {
    inner: Mutex<Inner>,
    /// Commands that wait for the unit; at full speed the time keeper steps aside for them.
    waiting: AtomicUsize,
    /// Commands carried out or refused.
    pub commands: AtomicU64,
    /// Frames dropped without an answer: wrong CRC or length, cut, remote or extended.
    pub rejected: AtomicU64,
}

impl Desk {
    pub fn new(configuration: &Configuration, truth: &Truth, recording: Option<SyncSender<Event>>) -> Desk {
        let unit = Unit::on(configuration, truth);
        let recorded = configuration.run.commands.iter().cloned().collect();
        Desk {
            inner: Mutex::new(Inner { unit, completed: None, underway: None, recorded, recording }),
            waiting: AtomicUsize::new(0),
            commands: AtomicU64::new(0),
            rejected: AtomicU64::new(0),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().expect("the model does not panic")
    }

    /// Half seconds ended, and the scheduled end of the one that runs, ns.
    pub fn running(&self) -> (u64, i64) {
        while self.waiting.load(Relaxed) > 0 {
            thread::yield_now();
        }
        let inner = self.lock();
        (inner.unit.ended(), inner.unit.running_end_ns())
    }

    /// Ends the running half second. Until [`Desk::complete`] a POLL still gives the one before.
    pub fn end_half_second(&self) -> Ended {
        let mut inner = self.lock();
        while inner.recorded.front().is_some_and(|command| command.half_second <= inner.unit.ended()) {
            let command = inner.recorded.pop_front().expect("the front is there");
            inner.command(&command.link, &command.payload);
        }
        let (ended, traces) = if inner.recording.is_some() {
            let (ended, traces) = inner.unit.end_half_second_traced();
            (ended, Some(Box::new(traces)))
        } else {
            (inner.unit.end_half_second(), None)
        };
        inner.underway = Some(Underway { ended, traces });
        ended
    }

    /// The deadline of the half second that was ended last has passed.
    pub fn complete(&self) {
        self.lock().complete();
    }

    /// The last half second whose deadline has passed.
    pub fn completed(&self) -> Option<HalfSecond> {
        self.lock().completed.map(|(half_second, _)| half_second)
    }

    /// Carries out the payload of a COMMAND that came over `link`.
    pub fn command(&self, link: &str, payload: &[u8]) -> Answered {
        self.waiting.fetch_add(1, Relaxed);
        let mut inner = self.lock();
        self.waiting.fetch_sub(1, Relaxed);
        self.commands.fetch_add(1, Relaxed);
        inner.command(link, payload)
    }

    /// Tells the recording that no more follows.
    pub fn close(&self) {
        self.lock().recording = None;
    }
}

impl Inner {
    fn tell(&mut self, event: Event) {
        // The other end hangs up only after a failed write, which it has told.
        if self.recording.as_ref().is_some_and(|recording| recording.send(event).is_err()) {
            self.recording = None;
        }
    }

    fn record_underway(&mut self) {
        if let Some(Underway { ended, traces }) = &mut self.underway
            && let Some(traces) = traces.take()
        {
            let event = Event::HalfSecond(*ended, traces);
            self.tell(event);
        }
    }

    fn complete(&mut self) {
        self.record_underway();
        if let Some(Underway { ended, .. }) = self.underway.take() {
            self.completed = Some((ended.half_second, ended.end_ns));
        }
    }

    fn command(&mut self, link: &str, payload: &[u8]) -> Answered {
        let running_end_ns =
            self.underway.as_ref().map_or(self.unit.running_end_ns(), |underway| underway.ended.end_ns);
        let answer = self.unit.command(payload);
        let command = Event::Command { link: link.to_owned(), payload: payload.to_vec(), running_end_ns };
        if answer.polled.is_none() {
            // The command acts in the half second after the one underway, and must be recorded there.
            self.record_underway();
            self.tell(command);
            return Answered { reply: answer.reply, polled: None };
        }
        self.tell(command);
        match self.completed {
            Some((half_second, end_ns)) => {
                self.tell(Event::Polled(half_second, end_ns));
                Answered { reply: answer.reply, polled: Some(half_second) }
            }
            // The very first half second is underway, but none has been completed yet.
            None => Answered { reply: Reply::new(answer.reply.opcode(), Outcome::NotPossibleNow, &[]), polled: None },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_poll_just_before_the_deadline_gives_the_half_second_before() {
        let desk = Desk::new(&Configuration::reference(), &Truth::Scenario, None);
        assert_eq!(desk.command("test", &[2, 1]).reply.outcome(), Outcome::Done);
        let poll = || desk.command("test", &[3]);
        assert_eq!(poll().reply.outcome(), Outcome::NotPossibleNow);
        let first = desk.end_half_second();
        assert!(!first.cyclic);
        assert_eq!(poll().reply.outcome(), Outcome::NotPossibleNow);
        desk.complete();
        assert_eq!(poll().polled, Some(first.half_second));
        let second = desk.end_half_second();
        assert_eq!(poll().polled, Some(first.half_second));
        desk.complete();
        assert_eq!(poll().polled, Some(second.half_second));
        assert_eq!(poll().polled, Some(second.half_second));
    }
}
