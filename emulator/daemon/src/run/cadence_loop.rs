//! The thread that keeps the unit's time: ends each sample just before its deadline, and sends it at the deadline.

use std::sync::Arc;
use std::thread;

use geu_model::CompletedSample;
use geu_model::fault::acting::ActiveFault;
use geu_model::fault::{Fault, unsatisfiable_condition};
use geu_model::units::SAMPLE_INTERVAL_NS;

use super::error::RunError;
use super::output::LinkOutput;
use super::session::{LEAD_NS, POLL_INTERVAL, Session};
use super::unit::RunOptions;
use crate::cadence::{DeadlineTimer, Speed, ask_for_realtime, doze_until, now_ns};
use crate::console;
use crate::lateness::DurationNs;
use crate::patience::Patience;
use crate::recorder_thread::Status;
use crate::shared_unit::SharedUnit;
use crate::truth::{ExternalTruth, SampleReport};

pub(super) struct CadenceLoop {
    session: Session,
    unit: Arc<SharedUnit>,
    settings: RunOptions,
    pub links: Vec<LinkOutput>,
    /// On the monotonic clock, ns.
    start_ns: i64,
    /// On-board time at which the last sample ended, ns.
    last_end_ns: i64,
    /// Samples not sent since the last one that was.
    missed: u64,
}

impl CadenceLoop {
    pub fn new(session: Session, unit: Arc<SharedUnit>, settings: RunOptions, links: Vec<LinkOutput>) -> CadenceLoop {
        CadenceLoop { session, unit, settings, links, start_ns: 0, last_end_ns: 0, missed: 0 }
    }

    /// Runs the unit to its end, or until the run is stopped.
    ///
    /// # Errors
    /// A condition on what a truth from outside turns out not to report.
    pub fn run(&mut self) -> Result<(), RunError> {
        let timer = DeadlineTimer::new(self.settings.spin);
        self.ask_for_realtime();
        self.session.await_client(&self.links);
        if !self.has_first_sample() {
            return Ok(());
        }
        self.refuse_unavailable()?;
        let patience = self.session.patience();
        self.start_ns = now_ns();
        while !self.is_stopped() && self.step(&timer, &patience) {}
        self.report_missed();
        self.session.end_links(&mut self.links, self.last_end_ns);
        Ok(())
    }

    /// Without deadlines there is nothing to be on time for, and a thread that never sleeps must not have priority.
    fn ask_for_realtime(&self) {
        if !self.settings.realtime || self.settings.speed == Speed::Max {
            return;
        }
        match ask_for_realtime() {
            Ok(()) => console::say("real-time priority (SCHED_FIFO) granted"),
            Err(error) => console::say(format_args!(
                "real-time priority (SCHED_FIFO) not granted: {error}; it needs CAP_SYS_NICE or `ulimit -r`; the unit runs without"
            )),
        }
    }

    /// Runs the unit to the end of one sample; false where the run ends before it.
    fn step(&mut self, timer: &DeadlineTimer, patience: &Patience) -> bool {
        self.unit.step_aside();
        let (frame, running_end_ns) = self.unit.running();
        if self.settings.samples.is_some_and(|samples| frame >= samples) {
            return false;
        }
        let deadline_ns = self.deadline_ns(running_end_ns);
        if let Some(deadline_ns) = deadline_ns {
            self.doze_and_send_late(deadline_ns - LEAD_NS, patience);
            if self.is_stopped() {
                return false;
            }
        }
        if !self.has_truth() {
            return false;
        }
        // Without deadlines the unit waits for its recording as it does for readers.
        while !patience.is_none() && !self.is_stopped() && !self.unit.recording().is_none_or(Status::has_ample_room) {
            thread::park_timeout(POLL_INTERVAL);
        }
        let (ended, injected) = self.unit.end_sample();
        self.last_end_ns = ended.end_ns;
        if self.is_past_next_deadline() {
            self.missed += 1;
            self.links.iter_mut().for_each(|output| output.put(None, frame, ended.end_ns, &[]));
            self.unit.complete_unsent();
            self.report(frame, &ended);
            return true;
        }
        self.report_missed();
        let acting: &[ActiveFault] = injected.as_ref().map_or(&[], |injected| &injected.acting);
        let sample = Some(&ended.sample).filter(|_| ended.cyclic);
        for output in &mut self.links {
            output.put(sample, frame, ended.end_ns, acting);
            output.prepare(ended.end_ns, patience);
        }
        if let Some(deadline_ns) = deadline_ns {
            timer.sleep_until(deadline_ns);
        }
        let now_ns = now_ns();
        // Commands wait for the completion: not for readers, whom a faster run waits for.
        if !patience.is_none() {
            self.unit.complete();
        }
        self.links.iter_mut().for_each(|output| output.send_prepared(patience));
        self.unit.complete();
        self.report(frame, &ended);
        if let Some(deadline_ns) = deadline_ns {
            self.session.monitor.record(now_ns - deadline_ns);
        }
        true
    }

    /// When a sample that ends at this on-board time is due, on the monotonic clock; `None` without deadlines.
    fn deadline_ns(&self, end_ns: i64) -> Option<i64> {
        self.settings.speed.wall_ns(end_ns).map(|wall_ns| self.start_ns + wall_ns)
    }

    /// Whether a truth from outside has begun; not where the run was stopped meanwhile, or the source did not come.
    fn has_first_sample(&self) -> bool {
        let RunOptions { live, truth_wait, speed, .. } = &self.settings;
        let begin =
            |live: &Arc<ExternalTruth>| live.await_first(*speed == Speed::Max, *truth_wait, || self.is_stopped());
        live.as_ref().is_none_or(begin)
    }

    /// Refuses conditions on what a truth from outside turns out not to report.
    fn refuse_unavailable(&self) -> Result<(), RunError> {
        if self.settings.live.as_ref().is_none_or(|live| live.tells_sun()) {
            return Ok(());
        }
        let faults = self.unit.faults();
        let planned: Vec<Fault> = faults.planned.iter().map(|planned| (*planned.fault).clone()).collect();
        let expectations: Vec<_> = faults.watches.iter().map(|watch| watch.expectation.clone()).collect();
        match unsatisfiable_condition(&planned, &expectations, "the truth of this run", self.unit.untold()) {
            Some(why) => Err(RunError::Untold(why)),
            None => Ok(()),
        }
    }

    /// Reports the end of a sample to a source of the truth that asked for it: the links have their bytes.
    fn report(&mut self, sample: u64, ended: &CompletedSample) {
        let Some(live) = self.settings.live.as_ref().filter(|live| live.wants_reports()) else {
            self.links.iter_mut().for_each(LinkOutput::forget_handed);
            return;
        };
        live.report(&SampleReport {
            sample,
            end_s: ended.end_ns as f64 * 1e-9,
            sequence: ended.sample.sequence,
            clock_count: ended.sample.clock_count,
            links: self.links.iter_mut().map(LinkOutput::take_handed).collect(),
        });
    }

    /// Waits until `wake_ns`, and sends what becomes due meanwhile because a fault held it back.
    fn doze_and_send_late(&mut self, wake_ns: i64, patience: &Patience) {
        while !self.is_stopped() && now_ns() < wake_ns {
            let next_ns = self.links.iter().filter_map(|output| output.queue.next_ns()).min();
            let next = next_ns.and_then(|due_ns| Some((due_ns, self.deadline_ns(due_ns)?)));
            match next.filter(|(_, wall_ns)| *wall_ns < wake_ns) {
                Some((due_ns, wall_ns)) if wall_ns <= now_ns() => {
                    self.links.iter_mut().for_each(|output| output.send_due(due_ns, patience));
                }
                Some((_, wall_ns)) => doze_until(wall_ns),
                None => doze_until(wake_ns),
            }
        }
    }

    /// Whether the truth of the running sample interval is known, where it comes from outside; not where the run was stopped
    /// meanwhile.
    fn has_truth(&self) -> bool {
        let RunOptions { live, truth_wait, speed, .. } = &self.settings;
        let (needed_s, waits) = (self.unit.needs_truth_s(), *speed == Speed::Max);
        live.as_ref().is_none_or(|live| live.finish(needed_s, waits, *truth_wait, || self.is_stopped()))
    }

    fn is_stopped(&self) -> bool {
        self.session.is_stopped()
    }

    /// Whether the sample that just ended on board comes so late that the next is due already. In real time it is not sent
    /// then: a burst would show the receiver a unit that does not exist. A faster run is for its bytes.
    fn is_past_next_deadline(&self) -> bool {
        let is_past = || self.deadline_ns(self.unit.running().1).is_some_and(|deadline_ns| now_ns() > deadline_ns);
        !self.settings.speed.is_faster_than_real() && is_past()
    }

    fn report_missed(&mut self) {
        let missed = std::mem::take(&mut self.missed);
        if missed > 0 {
            self.session.monitor.record_missed(missed);
            let held_up = DurationNs(missed * SAMPLE_INTERVAL_NS as u64);
            console::say(format_args!(
                "{missed} samples not sent: the process was held up for about {held_up}; the sequence goes on behind them"
            ));
        }
    }
}
