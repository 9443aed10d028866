//! A truth from outside, between the tasks that read its source and the cadence thread.

use std::fmt;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock};
use std::time::{Duration, Instant};

use geu_model::Truth;
use geu_model::attitude::{StreamedAttitude, TruthNumbers};
use geu_model::units::SAMPLE_INTERVAL_S;
use tokio::sync::Notify;

use super::address::TruthAddress;
use super::reports::{Reports, SampleReport};
use super::synchroniser::{TruthSample, TruthStatistics, TruthSynchroniser};

use crate::console;

/// A run that has waited so long for its source says so.
const SAY_WAITING: Duration = Duration::from_secs(2);
/// Between two looks whether the run was stopped.
const LOOK_AGAIN: Duration = Duration::from_millis(50);
/// Pieces that are remembered: 1200 s, more than may wait to be written.
const PIECES: usize = 12_000;
/// Of bad lines and of jumps so many are told one by one; more are only counted.
const MOST_TOLD: u64 = 3;

/// A truth that is being told.
#[derive(Debug)]
pub struct ExternalTruth {
    asked: TruthAddress,
    pub(super) bound: OnceLock<TruthAddress>,
    truth: Arc<StreamedAttitude>,
    /// At a pace of its own the run begins so long after the first sample.
    start_delay: Duration,
    state: Mutex<State>,
    /// A sample came.
    came: Condvar,
    /// More is wanted than was.
    wanted: Notify,
    /// What left in each sample interval, for a source that asks.
    pub(super) reports: Reports,
}

/// How a wait for the source ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Waited {
    Enough,
    TooLong,
    Stopped,
}

#[derive(Debug)]
struct State {
    synchroniser: TruthSynchroniser,
    /// On-board time up to which the truth is needed next.
    wanted_s: f64,
    /// The run waits for clients, and the source does not wait for the run.
    is_early: bool,
    /// The run was ended because the source did not come in time, in words.
    gave_up: Option<String>,
    /// Times that a wait was said.
    waits_said: u64,
}

impl ExternalTruth {
    /// A truth from `address`, before its first sample.
    pub fn new(address: TruthAddress, numbers: TruthNumbers) -> Arc<ExternalTruth> {
        let truth = Arc::new(StreamedAttitude::remembering(PIECES));
        let state = State {
            synchroniser: TruthSynchroniser::new(truth.clone(), numbers),
            wanted_s: SAMPLE_INTERVAL_S,
            is_early: false,
            gave_up: None,
            waits_said: 0,
        };
        Arc::new(ExternalTruth {
            asked: address,
            bound: OnceLock::new(),
            truth,
            start_delay: Duration::from_secs_f64(numbers.start_delay_s),
            state: Mutex::new(state),
            came: Condvar::new(),
            wanted: Notify::new(),
            reports: Reports::default(),
        })
    }

    /// Where the source is: of port 0 the one that was taken.
    pub(super) fn address(&self) -> &TruthAddress {
        self.bound.get().unwrap_or(&self.asked)
    }

    /// What moves the unit.
    pub fn truth(&self) -> Truth {
        Truth::Stepped(self.truth.clone())
    }

    /// What became of the samples.
    pub fn counts(&self) -> TruthStatistics {
        let (reports, reports_dropped) = self.reports.counts();
        TruthStatistics { reports, reports_dropped, ..self.state().synchroniser.counts }
    }

    /// Why the run was not on the motion that the source told, in words; nothing where it was.
    pub fn failure(&self) -> Option<String> {
        let state = self.state();
        let TruthStatistics { late, missing, jumps, bad_lines, .. } = state.synchroniser.counts;
        let bad = (bad_lines > 0)
            .then(|| format!("truth {}: expected lines that can be read, got {bad_lines} that cannot", self.address()));
        let counted = (late + missing + jumps > 0).then(|| {
            format!(
                "truth {}: expected a sample at or after the end of each sample interval, and no jumps, got {late} late samples, {missing} missing, {jumps} jumps: the unit moved otherwise than was reported; report ahead of time, or run with --speed max, where unit and simulator wait for each other",
                self.address()
            )
        });
        state.gave_up.clone().or(counted).or(bad)
    }

    /// Whether the source tells the sun, as its first sample says.
    pub(crate) fn tells_sun(&self) -> bool {
        self.state().synchroniser.tells_sun()
    }

    /// Whether the source asked for reports.
    pub(crate) fn wants_reports(&self) -> bool {
        self.reports.is_wanted()
    }

    /// Reports the end of a sample interval to the source, without waiting for it.
    pub(crate) fn report(&self, report: &SampleReport) {
        let source_s = self.state().synchroniser.source_s(report.end_s);
        self.reports.put(report, source_s.unwrap_or(report.end_s));
    }

    /// The run is held back for its clients: the samples until then are the past.
    pub(super) fn hold_back(&self) {
        self.state().is_early = true;
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().expect("nothing panics with the truth")
    }

    /// Waits for the first sample, which sets on-board time 0, at most `most`; at a pace of its own the run begins a moment
    /// later. Says whether the run begins.
    pub(crate) fn await_first(&self, waits: bool, most: Option<Duration>, is_stopped: impl Fn() -> bool) -> bool {
        self.state().is_early = false;
        if !self.state().synchroniser.has_begun() {
            console::say(format_args!("waits for the first sample of {}", self.address()));
        }
        let waited = self.wait(most, &is_stopped, TruthSynchroniser::has_begun);
        if waited == Waited::TooLong {
            self.give_up("the first sample", most);
        }
        if waited == Waited::Enough && !waits {
            self.wait(Some(self.start_delay), &is_stopped, |_| false);
        }
        waited == Waited::Enough
    }

    /// Makes the truth final up to `needed_s`: as it is known now, or, in a run that waits for its source, as soon as samples
    /// cover it, in `most` of the wall clock. Says whether it did: not where the run was stopped, or the source did not come.
    pub(crate) fn finish(
        &self,
        needed_s: f64,
        waits: bool,
        most: Option<Duration>,
        is_stopped: impl Fn() -> bool,
    ) -> bool {
        if waits {
            self.want(needed_s);
            match self.await_covering(needed_s, most, &is_stopped) {
                Waited::Enough => {}
                Waited::TooLong => {
                    let source_s = self.state().synchroniser.source_s(needed_s).unwrap_or(needed_s);
                    self.give_up(&format!("a sample at or after its time {source_s} s"), most);
                    return false;
                }
                Waited::Stopped => return false,
            }
        }
        let note = self.state().synchroniser.finish(needed_s);
        self.want(needed_s + SAMPLE_INTERVAL_S);
        if let Some(note) = note {
            console::say(format_args!("truth {}: {note}", self.address()));
        }
        true
    }

    /// Waits for samples up to `needed_s`, and says so where it takes long: who looks at a run that stands shall know why.
    fn await_covering(&self, needed_s: f64, most: Option<Duration>, is_stopped: &impl Fn() -> bool) -> Waited {
        let covers = |synchroniser: &TruthSynchroniser| synchroniser.covers(needed_s);
        let silent = most.map_or(SAY_WAITING, |most| most.min(SAY_WAITING));
        let waited = self.wait(Some(silent), is_stopped, covers);
        if waited != Waited::TooLong || most.is_some_and(|most| most <= silent) {
            return waited;
        }
        let mut state = self.state();
        state.waits_said += 1;
        let (said, source_s) = (state.waits_said, state.synchroniser.source_s(needed_s).unwrap_or(needed_s));
        drop(state);
        if said <= MOST_TOLD {
            let more = if said == MOST_TOLD { "; more waits are not said" } else { "" };
            console::say(format_args!(
                "truth {}: waits for a sample at or after its time {source_s} s{more}",
                self.address()
            ));
        }
        self.wait(most.map(|most| most - silent), is_stopped, covers)
    }

    /// The run ends: the source did not come.
    fn give_up(&self, what: &str, most: Option<Duration>) {
        let most_s = most.unwrap_or_default().as_secs_f64();
        self.state().gave_up = Some(format!(
            "truth {}: expected {what} within {most_s} s (--truth-wait), got none; the run ended there. Start the simulator, or give it longer: --truth-wait DURATION or forever",
            self.address()
        ));
    }

    fn want(&self, until_s: f64) {
        self.state().wanted_s = until_s;
        self.wanted.notify_waiters();
    }

    /// Waits until `is_enough`, `most` is over, or the run is stopped.
    fn wait(
        &self,
        most: Option<Duration>,
        is_stopped: &impl Fn() -> bool,
        is_enough: impl Fn(&TruthSynchroniser) -> bool,
    ) -> Waited {
        let start = Instant::now();
        let mut state = self.state();
        loop {
            if is_stopped() {
                return Waited::Stopped;
            }
            if is_enough(&state.synchroniser) {
                return Waited::Enough;
            }
            let left = most.map_or(LOOK_AGAIN, |most| most.saturating_sub(start.elapsed()));
            if left.is_zero() {
                return Waited::TooLong;
            }
            state = self.came.wait_timeout(state, left.min(LOOK_AGAIN)).expect("nothing panics with the truth").0;
        }
    }

    /// Takes a sample, or counts a line of `place` that is none.
    pub(super) fn take(&self, place: fmt::Arguments<'_>, read: Result<TruthSample, String>) {
        let mut state = self.state();
        let (note, so_far) = match read {
            Ok(sample) => {
                let note = state.synchroniser.take(sample);
                (note, state.synchroniser.counts.jumps)
            }
            Err(wrong) => {
                state.synchroniser.counts.bad_lines += 1;
                (Some(format!("{place}: {wrong}")), state.synchroniser.counts.bad_lines)
            }
        };
        if let Some(note) = note.filter(|_| so_far <= MOST_TOLD) {
            let more = if so_far == MOST_TOLD { "; more of the kind are only counted" } else { "" };
            console::say(format_args!("truth {}: {note}{more}", self.address()));
        }
        if state.is_early {
            state.synchroniser.reset_origin();
        }
        drop(state);
        self.came.notify_all();
    }

    /// Whether a source that told something once is missing.
    pub(super) fn is_missing(&self) -> bool {
        self.state().synchroniser.is_missing()
    }

    fn is_wanted(&self, ahead_s: f64) -> bool {
        let state = self.state();
        state.is_early || !state.synchroniser.covers(state.wanted_s + ahead_s)
    }

    /// Waits until samples are wanted further than `ahead_s` before those that came.
    pub(super) async fn until_wanted(&self, ahead_s: f64) {
        loop {
            // Made before the look, so that what is wanted in between is not slept through.
            let wanted = self.wanted.notified();
            if self.is_wanted(ahead_s) {
                return;
            }
            wanted.await;
        }
    }
}
