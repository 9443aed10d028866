//! The cadence thread: ends each sample just before its deadline, and sends it at the deadline.

use std::sync::Arc;
use std::time::Duration;

use geu_model::CompletedSample;
use geu_model::fault::engine::ActiveFault;
use geu_model::fault::{Fault, unsatisfiable_condition};

use super::error::RunError;
use super::output::{LinkOutput, TimedLinks};
use super::session::{LEAD_NS, POLL_INTERVAL, Session};
use super::unit::RunOptions;
use crate::cadence::{Speed, ask_for_realtime, doze_until};
use crate::console;
use crate::host::{self, Instant, now_ns};
use crate::lateness::DurationNs;
use crate::recorder_thread::Status;
use crate::shared_unit::SharedUnit;
use crate::truth::SampleReport;
use geu_recorder::link_model::CATCH_UP_NS;

/// Shortest interval of reports of samples that were not sent.
const REPORT_INTERVAL: Duration = Duration::from_secs(1);

pub(super) struct CadenceLoop {
    links: TimedLinks,
    unit: Arc<SharedUnit>,
    settings: RunOptions,
    /// On-board time at which the last sample ended, ns.
    last_end_ns: i64,
    /// Samples not sent since the last one sent.
    missed: u64,
    reported: Option<Instant>,
}

impl CadenceLoop {
    /// Runs the unit to its end, or until the run is stopped, and returns the links.
    ///
    /// # Errors
    /// A condition on a variable that the external truth does not provide.
    pub fn run(
        session: Session,
        unit: Arc<SharedUnit>,
        settings: RunOptions,
        links: Vec<LinkOutput>,
    ) -> (Result<(), RunError>, Vec<LinkOutput>) {
        let links = TimedLinks::new(session, links, settings.spin);
        let mut cadence = CadenceLoop { links, unit, settings, last_end_ns: 0, missed: 0, reported: None };
        (cadence.run_samples(), cadence.links.outputs)
    }

    fn run_samples(&mut self) -> Result<(), RunError> {
        self.ask_for_realtime();
        self.links.session.await_client(&self.links.outputs);
        let RunOptions { live, truth_wait, speed, .. } = &self.settings;
        if let Some(live) = live {
            if !live.await_first(*speed == Speed::Max, *truth_wait, || self.is_stopped()) {
                return Ok(());
            }
            if !live.has_sun() {
                self.check_conditions()?;
            }
        }
        self.links.start();
        while !self.is_stopped() && self.step() {}
        self.report_missed(true);
        self.links.end(self.last_end_ns);
        Ok(())
    }

    /// Not without deadlines: a thread that never sleeps must not have priority.
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

    /// Runs the unit to the end of one sample; false if the run ends before it.
    fn step(&mut self) -> bool {
        self.unit.yield_to_commands();
        let (frame, running_end_ns) = self.unit.running();
        if self.settings.samples.is_some_and(|samples| frame >= samples) {
            return false;
        }
        let deadline_ns = self.links.wall_ns(running_end_ns);
        if let Some(deadline_ns) = deadline_ns {
            self.doze_and_send_late(deadline_ns - LEAD_NS);
            if self.is_stopped() {
                return false;
            }
        }
        if !self.has_truth() {
            return false;
        }
        let waits = !self.links.patience.is_none();
        // Without deadlines the unit waits for its recording as it does for readers.
        while waits && !self.is_stopped() && !self.unit.recording().is_none_or(Status::has_ample_capacity) {
            host::park_thread(POLL_INTERVAL);
        }
        let (ended, injected) = self.unit.end_sample();
        self.last_end_ns = ended.end_ns;
        if self.is_past_next_deadline() {
            self.missed += 1;
            self.links.outputs.iter_mut().for_each(|output| output.put(None, frame, ended.end_ns, &[]));
            self.unit.complete_unsent();
            self.report(frame, &ended);
            return true;
        }
        self.report_missed(false);
        let acting: &[ActiveFault] = injected.as_ref().map_or(&[], |injected| &injected.acting);
        let sample = Some(&ended).filter(|_| ended.cyclic);
        for output in &mut self.links.outputs {
            output.put(sample, frame, ended.end_ns, acting);
            output.prepare(ended.end_ns, &self.links.patience);
        }
        if let Some(deadline_ns) = deadline_ns {
            self.links.timer.sleep_until(deadline_ns);
        }
        let now_ns = now_ns();
        // Commands wait for the completion, but not for readers, for which a faster run waits.
        if waits {
            self.unit.complete();
        }
        self.links.outputs.iter_mut().for_each(|output| output.send_prepared(&self.links.patience));
        self.unit.complete();
        self.report(frame, &ended);
        if let Some(deadline_ns) = deadline_ns {
            self.links.session.monitor.record(now_ns - deadline_ns);
        }
        true
    }

    /// Rejects conditions on variables that the external truth does not provide.
    fn check_conditions(&self) -> Result<(), RunError> {
        let faults = self.unit.faults();
        let planned: Vec<Fault> = faults.planned.iter().map(|planned| (*planned.fault).clone()).collect();
        let expectations: Vec<_> = faults.watches.iter().map(|watch| watch.expectation.clone()).collect();
        let reason = unsatisfiable_condition(&planned, &expectations, "the truth of this run", self.unit.unavailable());
        reason.map_or(Ok(()), |reason| Err(RunError::Unavailable(reason)))
    }

    /// Reports the end of a sample, after its data was passed to the links, to a source of truth that requested reports.
    fn report(&mut self, sample: u64, ended: &CompletedSample) {
        let links = self.links.outputs.iter_mut().map(LinkOutput::take_handed).collect();
        if let Some(live) = self.settings.live.as_ref().filter(|live| live.wants_reports()) {
            live.report(&SampleReport {
                sample,
                end_s: ended.end_ns as f64 * 1e-9,
                sequence: ended.sample.sequence,
                clock_count: ended.sample.clock_count,
                links,
            });
        }
    }

    /// Waits until `wake_ns`, and sends the transmissions, delayed by faults, that become due.
    fn doze_and_send_late(&mut self, wake_ns: i64) {
        while !self.is_stopped() && now_ns() < wake_ns {
            let next = self.links.next_due_ns().and_then(|due_ns| Some((due_ns, self.links.wall_ns(due_ns)?)));
            match next.filter(|(_, wall_ns)| *wall_ns < wake_ns) {
                Some((due_ns, wall_ns)) if wall_ns <= now_ns() => self.links.send_due(due_ns),
                Some((_, wall_ns)) => doze_until(wall_ns),
                None => doze_until(wake_ns),
            }
        }
    }

    /// Waits for an external truth of the running sample interval; false if the run is stopped meanwhile.
    fn has_truth(&self) -> bool {
        let RunOptions { live, truth_wait, speed, .. } = &self.settings;
        let (needed_s, waits) = (self.unit.needs_truth_s(), *speed == Speed::Max);
        live.as_ref().is_none_or(|live| live.finish(needed_s, waits, *truth_wait, || self.is_stopped()))
    }

    fn is_stopped(&self) -> bool {
        self.links.session.is_stopped()
    }

    /// True if the next sample is due already. In real time the sample that just ended is not sent then: a burst would be the
    /// behaviour of no real unit. A faster run sends it, because its bytes matter and not its times; so does a unit of short
    /// intervals within [`CATCH_UP_NS`], as the buffer of a serial adapter does.
    fn is_past_next_deadline(&self) -> bool {
        let slack_ns = (CATCH_UP_NS - self.unit.device.interval_ns()).max(0);
        let deadline_ns = || self.links.wall_ns(self.unit.running().1);
        let is_past = || deadline_ns().is_some_and(|deadline_ns| now_ns() > deadline_ns + slack_ns);
        !self.settings.speed.is_faster_than_real() && is_past()
    }

    /// Reports samples that were not sent; again after a second at the soonest, or at the end.
    fn report_missed(&mut self, is_end: bool) {
        if !is_end && self.reported.is_some_and(|reported| reported.elapsed() < REPORT_INTERVAL) {
            return;
        }
        let missed = std::mem::take(&mut self.missed);
        if missed > 0 {
            self.reported = Some(Instant::now());
            self.links.session.monitor.record_missed(missed);
            let stalled = DurationNs(missed * self.unit.device.interval_ns() as u64);
            console::say(format_args!(
                "{missed} samples not sent: process stalled about {stalled}; the sequence continues after them"
            ));
        }
    }
}
