//! Kinds of a change, compared by their likelihood.
//!
//! A kind is the filter itself with some states released at some instant: what the recorded steps say of it is the likelihood of
//! all of them, and its filter continues as if the change had been known.

use std::collections::VecDeque;

use crate::bank::{Bank, LOOK_SAMPLES, OLDEST_SAMPLES};
use crate::filter::{ANGLE, CHANGES, CLEARANCES, Filter, PIVOT, SCALE, Step};

/// Logarithm of the odds by which a kind leads any other before it is named.
const LEAD: f64 = 8.0;
/// Factor of the walks of a channel that became noisy.
const NOISY: f64 = 10.0;
/// Instants tried between two onsets, before the steps between them are halved.
const TRIALS: u64 = 8;
/// First step from an instant that was known, samples.
const KNOWN_STEP: u64 = 16;

/// The steps of the last four hours, and the sample of the first one.
#[derive(Debug, Clone, Default)]
pub struct Tape {
    steps: VecDeque<Step>,
    first: u64,
}

impl Tape {
    pub fn push(&mut self, step: Step) {
        if self.steps.len() as u64 > 2 * OLDEST_SAMPLES {
            self.steps.pop_front();
            self.first += 1;
        }
        self.steps.push_back(step);
    }

    /// Number of samples.
    pub fn end(&self) -> u64 {
        self.first + self.steps.len() as u64
    }

    /// Replaces all steps.
    pub fn map(&mut self, change: impl Fn(Step) -> Step) {
        self.steps.iter_mut().for_each(|step| *step = change(*step));
    }

    /// The steps from this sample on.
    fn from(&self, sample: u64) -> impl Iterator<Item = (u64, &Step)> {
        (sample..).zip(self.steps.iter().skip(sample.saturating_sub(self.first) as usize))
    }

    /// The filter after all steps from this sample on.
    pub fn run(&self, mut filter: Filter, from: u64, mut before: impl FnMut(u64, &mut Filter)) -> Filter {
        for (sample, step) in self.from(from) {
            before(sample, &mut filter);
            filter.push(step);
        }
        filter
    }
}

/// A kind with the likeliest instant of its change.
#[derive(Debug, Clone)]
struct Candidate {
    change: usize,
    /// Index of its clearance, for a pivot.
    clearance: usize,
    /// The sample of the change.
    sample: u64,
    /// The filter before that, and the sample that it is before.
    before: Filter,
    from: u64,
    /// The filter with the change, after all steps.
    filter: Filter,
}

/// The kinds of a change that is not yet named.
#[derive(Debug, Clone)]
pub struct Kinds {
    codes: [&'static str; CHANGES],
    candidates: Vec<Candidate>,
}

impl Kinds {
    /// The kinds of a channel with its input axis along this control axis.
    pub fn new(axis: usize) -> Kinds {
        let mut codes = ["lost-counts", "drift", "misalignment", "misalignment", "misalignment", "pivot-clearance"];
        codes[SCALE + axis] = "scale-factor";
        Kinds { codes, candidates: Vec::new() }
    }

    /// Forgets the change.
    pub fn clear(&mut self) {
        self.candidates.clear();
    }

    /// Compares the kinds by all steps: the code of the change, or `unknown`, and the filter that knows it.
    pub fn compare(&mut self, tape: &Tape, bank: &Bank, threshold: f64) -> Option<(&'static str, Filter)> {
        let before = std::mem::take(&mut self.candidates);
        for (change, best) in bank.matches().iter().enumerate().filter(|(_, best)| best.statistic > 0.0) {
            for clearance in 0..if change == PIVOT { CLEARANCES } else { 1 } {
                let is_same = |other: &&Candidate| other.change == change && other.clearance == clearance;
                let known = before.iter().find(is_same);
                self.candidates.push(fit(tape, bank, best.onset, (change, clearance), known));
            }
        }
        self.candidates.sort_by(|a, b| b.filter.log_likelihood.total_cmp(&a.filter.log_likelihood));
        let best = self.candidates.first()?;
        let (code, own) = (self.codes[best.change], best.filter.log_likelihood);
        let other = self.candidates.iter().find(|other| self.codes[other.change] != code);
        let other = other.map_or(f64::NEG_INFINITY, |other| other.filter.log_likelihood);
        let free = best.run(tape, &|filter| (0..CHANGES).for_each(|state| filter.release(state)));
        let noisy = best.run(tape, &|filter| {
            filter.noise.walks.angle_arcsec_per_sqrt_s *= NOISY;
            filter.noise.walks.drift_arcsec_per_s_per_sqrt_s *= NOISY;
        });
        // Without signatures of pivots their jumps would be lost counts.
        let is_jump = best.change == ANGLE && !self.candidates.iter().any(|candidate| candidate.change == PIVOT);
        let is_clear = !is_jump
            && own - other.max(noisy.log_likelihood) >= LEAD
            && free.log_likelihood - own < 0.5 * LEAD
            && best.largest(tape) < threshold;
        Some(if is_clear { (code, best.filter.clone()) } else { ("unknown", free) })
    }
}

impl Candidate {
    /// Changes the filter at the instant of the candidate.
    fn run(&self, tape: &Tape, change: &dyn Fn(&mut Filter)) -> Filter {
        let sample = self.sample;
        let before = |now: u64, filter: &mut Filter| {
            if now == sample {
                change(filter);
            }
        };
        tape.run(self.before.clone(), self.from, before)
    }

    /// Lets the filter change in this way.
    fn release(&self, filter: &mut Filter) {
        match self.change {
            PIVOT => filter.release_clearance(self.clearance),
            state => filter.release(state),
        }
    }

    /// The largest statistic that the filter with the change would have had since.
    fn largest(&self, tape: &Tape) -> f64 {
        let (mut bank, mut filter, mut largest) = (Bank::default(), self.before.clone(), 0.0_f64);
        for (sample, step) in tape.from(self.from) {
            if sample == self.sample {
                self.release(&mut filter);
            }
            if sample > self.sample {
                bank.begin(sample, &filter);
            }
            let update = filter.push(step);
            bank.push(step, update.as_ref());
            if sample.is_multiple_of(LOOK_SAMPLES) {
                largest = largest.max(bank.largest());
            }
        }
        largest
    }

    /// Goes to this instant if it is likelier.
    fn try_at(&mut self, tape: &Tape, sample: u64) {
        let mut other = Candidate { sample, ..self.clone() };
        other.filter = other.run(tape, &|filter| self.release(filter));
        if other.filter.log_likelihood > self.filter.log_likelihood {
            *self = other;
        }
    }
}

/// The likeliest instant of a change near an onset, or near the one known.
fn fit(
    tape: &Tape,
    bank: &Bank,
    onset: usize,
    (change, clearance): (usize, usize),
    known: Option<&Candidate>,
) -> Candidate {
    let from = &bank.onsets[onset.saturating_sub(1)];
    let end = bank.onsets.get(onset + 1).map_or(tape.end(), |next| next.sample);
    let mut none = from.before.clone();
    none.log_likelihood = f64::NEG_INFINITY;
    let mut best = Candidate {
        change,
        clearance,
        sample: from.sample,
        before: from.before.clone(),
        from: from.sample,
        filter: none,
    };
    let mut step = (end - from.sample).div_ceil(TRIALS).max(1);
    (from.sample..end).step_by(step as usize).for_each(|sample| best.try_at(tape, sample));
    if let Some(known) = known.filter(|known| known.from >= tape.first) {
        let mut known = known.clone();
        known.filter.log_likelihood = f64::NEG_INFINITY;
        known.try_at(tape, known.sample);
        if known.filter.log_likelihood > best.filter.log_likelihood {
            (best, step) = (known, KNOWN_STEP);
        }
    }
    while step > 1 {
        step = step.div_ceil(2);
        let centre = best.sample;
        best.try_at(tape, centre.saturating_sub(step).max(best.from));
        best.try_at(tape, (centre + step).min(tape.end()));
    }
    best
}
