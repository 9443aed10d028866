//! External truth, shared by the tasks that read its source and the cadence thread.

use std::fmt;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock};
use std::thread;
use std::time::{Duration, Instant};

use geu_model::Truth;
use geu_model::attitude::{StreamedAttitude, TruthNumbers};
use geu_model::units::SAMPLE_INTERVAL_S;
use tokio::sync::Notify;

use super::address::TruthAddress;
use super::reports::{Reports, SampleReport};
use super::synchroniser::{TruthSample, TruthStatistics, TruthSynchroniser};

use crate::console;

/// Wait for the source after which a message is printed.
const SILENT_WAIT: Duration = Duration::from_secs(2);
/// Interval of the checks for a stopped run.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Number of knots kept: 1200 s, more than can wait to be written.
const KNOTS: usize = 12_000;
/// Maximum number of messages of one kind; further events are only counted.
const MAX_MESSAGES: u64 = 3;

/// External truth of a run.
#[derive(Debug)]
pub struct ExternalTruth {
    configured: TruthAddress,
    pub(super) bound: OnceLock<TruthAddress>,
    truth: Arc<StreamedAttitude>,
    /// Delay of the start after the first sample, unless the run waits for its source.
    start_delay: Duration,
    state: Mutex<State>,
    /// Signalled for each sample.
    received: Condvar,
    /// Signalled when more truth is needed.
    needed: Notify,
    /// Reports of the sample intervals to a source that subscribed.
    pub(super) reports: Reports,
}

/// Samples that a run waits for.
#[derive(Debug, Clone, Copy)]
enum Awaited {
    FirstSample,
    /// Samples that cover this on-board time.
    SamplesUntil(f64),
}

#[derive(Debug, Default)]
pub(super) struct State {
    synchroniser: TruthSynchroniser,
    /// On-board time up to which the truth is needed next.
    needed_s: f64,
    /// The run still waits for its clients: samples received until then are in the past.
    pub is_early: bool,
    /// Message of the timeout that ended the run.
    timeout: Option<String>,
    /// Number of messages on waits.
    wait_messages: u64,
}

impl ExternalTruth {
    pub fn new(address: TruthAddress, numbers: TruthNumbers) -> Arc<ExternalTruth> {
        let truth = Arc::new(StreamedAttitude::remembering(KNOTS));
        let synchroniser = TruthSynchroniser::new(truth.clone(), numbers);
        let state = State { synchroniser, needed_s: SAMPLE_INTERVAL_S, ..State::default() };
        Arc::new(ExternalTruth {
            configured: address,
            bound: OnceLock::new(),
            truth,
            start_delay: Duration::from_secs_f64(numbers.start_delay_s),
            state: Mutex::new(state),
            received: Condvar::new(),
            needed: Notify::new(),
            reports: Reports::default(),
        })
    }

    /// Address of the source; with the bound port if port 0 was configured.
    pub(super) fn address(&self) -> &TruthAddress {
        self.bound.get().unwrap_or(&self.configured)
    }

    /// The truth that moves the unit.
    pub fn truth(&self) -> Truth {
        Truth::Stepped(self.truth.clone())
    }

    pub fn counts(&self) -> TruthStatistics {
        let (reports, reports_dropped) = self.reports.counts();
        TruthStatistics { reports, reports_dropped, ..self.state().synchroniser.counts }
    }

    /// The reason why the unit did not move as the source reported; `None` if it did.
    pub fn failure(&self) -> Option<String> {
        let state = self.state();
        let TruthStatistics { late, missing, jumps, bad_lines, .. } = state.synchroniser.counts;
        let bad = (bad_lines > 0)
            .then(|| format!("truth {}: expected lines that can be read, got {bad_lines} that cannot", self.address()));
        let counted = (late + missing + jumps > 0).then(|| {
            format!(
                "truth {}: expected a sample at or after the end of each sample interval, and no jumps, got {late} late intervals, {missing} missing, {jumps} jumps: the unit moved otherwise than was reported; report ahead of time, or run with --speed max, where unit and simulator wait for each other",
                self.address()
            )
        });
        state.timeout.clone().or(counted).or(bad)
    }

    pub(super) fn log(&self, message: fmt::Arguments<'_>) {
        console::say(format_args!("truth {}: {message}", self.address()));
    }

    /// Prints the message with this count of its kind, unless there were too many.
    fn log_limited(&self, count: u64, message: fmt::Arguments<'_>) {
        if count <= MAX_MESSAGES {
            let more = if count == MAX_MESSAGES { "; further ones are not printed" } else { "" };
            self.log(format_args!("{message}{more}"));
        }
    }

    /// True if the source sends the sun, as in its first sample.
    pub(crate) fn has_sun(&self) -> bool {
        self.state().synchroniser.has_sun()
    }

    /// True if the source subscribed to reports.
    pub(crate) fn wants_reports(&self) -> bool {
        self.reports.is_wanted()
    }

    /// Reports the end of a sample interval to the source, without waiting.
    pub(crate) fn report(&self, report: &SampleReport) {
        let source_s = self.state().synchroniser.source_s(report.end_s);
        self.reports.push(report, source_s.unwrap_or(report.end_s));
    }

    pub(super) fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().expect("no holder panics")
    }

    /// Waits for the first sample, which sets on-board time 0; unless the run `waits` for its source, also for the start
    /// delay. Returns false if the run was stopped or `timeout` has passed.
    pub(crate) fn await_first(&self, waits: bool, timeout: Option<Duration>, is_stopped: impl Fn() -> bool) -> bool {
        self.state().is_early = false;
        if !self.state().synchroniser.has_begun() {
            console::say(format_args!("waits for the first sample of {}", self.address()));
        }
        let has_begun = self.wait(Awaited::FirstSample, timeout, &is_stopped);
        let start = Instant::now();
        while has_begun && !waits && start.elapsed() < self.start_delay && !is_stopped() {
            thread::sleep(self.start_delay.saturating_sub(start.elapsed()).min(POLL_INTERVAL));
        }
        has_begun
    }

    /// Makes the truth final up to `needed_s`: as known now, or, in a run that `waits` for its source, as soon as samples cover
    /// it. Returns false if the run was stopped or `timeout`, wall clock, has passed.
    pub(crate) fn finish(
        &self,
        needed_s: f64,
        waits: bool,
        timeout: Option<Duration>,
        is_stopped: impl Fn() -> bool,
    ) -> bool {
        if waits {
            self.need(needed_s);
            if !self.wait(Awaited::SamplesUntil(needed_s), timeout, &is_stopped) {
                return false;
            }
        }
        let note = self.state().synchroniser.finish(needed_s);
        self.need(needed_s + SAMPLE_INTERVAL_S);
        if let Some(note) = note {
            self.log(format_args!("{note}"));
        }
        true
    }

    fn need(&self, until_s: f64) {
        self.state().needed_s = until_s;
        self.needed.notify_waiters();
    }

    /// Waits for samples; prints a message if that takes long. Returns false if the run was stopped or `timeout` has passed.
    fn wait(&self, awaited: Awaited, timeout: Option<Duration>, is_stopped: &impl Fn() -> bool) -> bool {
        let (start, mut was_logged) = (Instant::now(), matches!(awaited, Awaited::FirstSample));
        let mut state = self.state();
        loop {
            if is_stopped() {
                return false;
            }
            let expected = match awaited {
                Awaited::FirstSample if state.synchroniser.has_begun() => return true,
                Awaited::SamplesUntil(t_s) if state.synchroniser.covers(t_s) => return true,
                Awaited::FirstSample => "the first sample".to_owned(),
                Awaited::SamplesUntil(t_s) => {
                    format!("a sample at or after its time {} s", state.synchroniser.source_s(t_s).unwrap_or(t_s))
                }
            };
            let waited = start.elapsed();
            if let Some(timeout) = timeout.filter(|timeout| waited >= *timeout) {
                state.timeout = Some(format!(
                    "truth {}: expected {expected} within {} s (--truth-wait), got none; the run ended there. Start the simulator, or wait longer: --truth-wait DURATION or forever",
                    self.address(),
                    timeout.as_secs_f64()
                ));
                return false;
            }
            if waited >= SILENT_WAIT && !std::mem::replace(&mut was_logged, true) {
                state.wait_messages += 1;
                self.log_limited(state.wait_messages, format_args!("waits for {expected}"));
            }
            let pause = timeout.map_or(POLL_INTERVAL, |timeout| (timeout - waited).min(POLL_INTERVAL));
            state = self.received.wait_timeout(state, pause).expect("no holder panics").0;
        }
    }

    /// Adds a sample, or counts the invalid line at `place`.
    pub(super) fn push(&self, place: fmt::Arguments<'_>, read: Result<TruthSample, String>) {
        let mut state = self.state();
        match read {
            Ok(sample) => {
                if let Some(note) = state.synchroniser.push(sample) {
                    self.log_limited(state.synchroniser.counts.jumps, format_args!("{note}"));
                }
            }
            Err(error) => {
                state.synchroniser.counts.bad_lines += 1;
                self.log_limited(state.synchroniser.counts.bad_lines, format_args!("{place}: {error}"));
            }
        }
        if state.is_early {
            state.synchroniser.reset_origin();
        }
        drop(state);
        self.received.notify_all();
    }

    /// True if a source that has sent samples is missing.
    pub(super) fn is_missing(&self) -> bool {
        self.state().synchroniser.is_missing
    }

    /// Waits until samples up to `ahead_s` after the needed time are missing.
    pub(super) async fn until_needed(&self, ahead_s: f64) {
        let is_needed = |state: &State| state.is_early || !state.synchroniser.covers(state.needed_s + ahead_s);
        loop {
            // Created before the check, so that no notification in between is missed.
            let needed = self.needed.notified();
            if is_needed(&self.state()) {
                return;
            }
            needed.await;
        }
    }
}
