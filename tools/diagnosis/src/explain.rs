//! The loop: search, fit the best by the model, keep it where it pays, search again.
//!
//! Everything is weighed alike: an entry costs what the search would find by chance in its family, and pays what χ² falls by. The
//! same data may speak of several effects or of noise that is larger than believed: both ways are gone, and the cheaper one holds.

mod doubt;
mod refine;
mod walks;

use rayon::prelude::*;

use crate::bank::Bank;
use crate::hypothesis::Hypothesis;
use crate::late::lag_chi2;
use crate::measured::{CHANNELS, TIMING};
use crate::normal::Normal;
use crate::null::Thresholds;
use crate::search::{Candidate, search};
use crate::state::{Case, FittedHypothesis, State};
use crate::whitening::Noise;

use doubt::{REFUSED_CHI2, Refused};
use refine::is_possible;
use walks::{TOGETHER_CHI2, walked};

pub use walks::NoiseFound;

/// Effects at most.
const MOST: usize = 6;
/// Effects of one gyro that are believed; one more is looked for, and makes them a pile.
pub const MOST_OF_ONE: usize = 3;
/// Candidates fitted in each round.
const FITTED: usize = 4;
/// Candidates that explain less than this share of what the best one does are not fitted.
const NEAR: f64 = 0.93;
/// Nor those that explain less than this share of what they cost: their shapes are nearly the best ones already.
const HOPE: f64 = 0.8;
/// Nor those whose χ² falls by so much less, where that is more.
const NEAR_CHI2: f64 = 12.0;
/// A course that explains no more than this share more than a likelier one of the same amplitude is not fitted.
const NEEDLESS: f64 = 0.02;
/// One round of the loop: what was looked at, the best first.
#[derive(Debug, Clone)]
pub struct Round {
    /// Candidates.
    pub candidates: Vec<Candidate>,
    /// What was kept: index of the change in the state.
    pub kept: Option<usize>,
    /// Which of the candidates was added, even where it was dropped again later.
    pub added: Option<usize>,
}

/// Where the loop ended.
#[derive(Debug)]
pub struct Explained {
    /// All that is held.
    pub state: State,
    /// Its equations.
    pub normal: Normal,
    /// The rounds.
    pub rounds: Vec<Round>,
    /// Walks that are not as configured.
    pub noise: Vec<NoiseFound>,
    /// Whether more was to be found where there are as many as may be: on one gyro, or in all.
    pub is_cut: bool,
    /// What is left to find in the end and is not explained.
    refused: Option<Refused>,
}

impl Explained {
    /// How unlikely all that is left is beside the sixteen and the lag, and all that was paid for names. A walk can look like
    /// anything, and is as dear as the dearest course.
    pub fn score(&self, case: &Case, thresholds: &Thresholds) -> f64 {
        self.score_with(case, thresholds, &self.state.noise)
    }

    fn score_with(&self, case: &Case, thresholds: &Thresholds, noise: &[Noise; CHANNELS]) -> f64 {
        let own = self.noise.len().min(1) as f64 * thresholds.largest()
            + TOGETHER_CHI2 * self.noise.len().saturating_sub(1) as f64;
        let residual = case.residual(&self.state);
        let normal = Normal::departed(case.whitenings(noise), &residual, &case.nuisances, &self.state.sixteen);
        normal.deviance() + self.state.held.iter().map(|held| held.penalty).sum::<f64>() + lag_chi2(&self.state) + own
    }
}

/// What explains the recording best: effects of the bank, noise, or both; up to one more effect than `most` on one gyro.
pub fn explain(case: &Case, bank: &Bank, thresholds: &Thresholds, start: &State, most: usize) -> Explained {
    let effects_first = || {
        let mut effects = grow(case, bank, thresholds, Explained::start(case, start.clone()), most);
        effects.free_noise(case, thresholds);
        effects.prune(case);
        effects.settled(case, thresholds)
    };
    let noise_first = || {
        let mut noise = Explained::start(case, start.clone());
        noise.free_noise(case, thresholds);
        if noise.noise.is_empty() {
            return None;
        }
        let mut noise = grow(case, bank, thresholds, noise, most);
        // What the walks took of the effects they give back.
        noise.quieten(case, &[true; TIMING]);
        noise.free_noise(case, thresholds);
        noise.prune(case);
        Some(noise.settled(case, thresholds))
    };
    let ((effects, effects_score), noise) = rayon::join(effects_first, noise_first);
    match noise {
        Some((noise, noise_score)) if noise_score < effects_score => noise,
        _ => effects,
    }
}

/// Adds the best effect as long as one qualifies and no gyro has more than `most`.
fn grow(case: &Case, bank: &Bank, thresholds: &Thresholds, mut now: Explained, most: usize) -> Explained {
    let cost = |candidate: &Candidate| thresholds.price(candidate.family, &candidate.hypothesis);
    loop {
        let late_s = now.state.shifts.temperature_s;
        let late = (late_s != 0.0).then(|| bank.late(late_s));
        let told = late.as_ref().unwrap_or(bank);
        let candidates = search(told, &now.normal, &now.state, &|family| thresholds.of(family));
        let Some(first) = candidates.first() else { break };
        let spare = first.gain.chi2 - cost(first);
        if now.state.held.len() >= MOST || (0..TIMING).any(|gyro| now.on(gyro).count() > most) {
            now.is_cut = spare > 0.0;
            break;
        }
        let least = (NEAR * spare).min(spare - NEAR_CHI2);
        let fitted = |candidate: &Candidate| -> Option<(f64, Candidate, State, Normal)> {
            let mut state = now.state.clone();
            let held = FittedHypothesis::new(candidate.hypothesis.clone());
            state.held.push(held.accepted(cost(candidate), candidate.held_out));
            let normal = case.fit(&mut state);
            let fall = now.normal.squares() - normal.squares() - cost(candidate);
            is_possible(state.held.last().expect("just put")).then(|| (fall, candidate.clone(), state, normal))
        };
        let worth: Vec<&Candidate> = candidates
            .iter()
            .take(FITTED)
            .filter(|candidate| candidate.gain.chi2 > HOPE * cost(candidate))
            .filter(|candidate| candidate.gain.chi2 - cost(candidate) >= least)
            .collect();
        let worth = without_needless_courses(worth);
        let tried: Vec<_> = worth.into_par_iter().filter_map(fitted).collect();
        let best = tried
            .into_iter()
            .filter(|(fall, candidate, ..)| *fall > 0.0 && candidate.pays_held_out())
            .max_by(|one, other| one.0.total_cmp(&other.0));
        let mut round = Round { candidates: candidates.clone(), kept: None, added: None };
        let Some((_, candidate, state, normal)) = best else {
            now.rounds.push(round);
            if spare > REFUSED_CHI2 && spare > now.negligible(case) {
                now.refused = Some(now.refusal(case, told, thresholds, first));
            }
            break;
        };
        round.kept = Some(state.held.len() - 1);
        round.added = candidates.iter().position(|other| {
            (other.base, &other.variation, other.hypothesis.gyros)
                == (candidate.base, &candidate.variation, candidate.hypothesis.gyros)
        });
        now.rounds.push(round);
        (now.state, now.normal) = (state, normal);
        now.shift_temperature(case, bank, thresholds);
        now.free_shapes(case);
        now.take_whole(case);
    }
    now
}

/// Without courses of what explains nearly as much with another course, or none, that is likelier: the others have nothing to tell.
fn without_needless_courses(candidates: Vec<&Candidate>) -> Vec<&Candidate> {
    let key = |candidate: &Candidate| (candidate.hypothesis.amplitude.constant(), candidate.hypothesis.gyros);
    let is_needless = |place: usize| {
        let mut before = candidates[..place].iter();
        let has_course = candidates[place].hypothesis.amplitude.kind.is_some();
        has_course
            && before.any(|other| {
                key(other) == key(candidates[place]) && candidates[place].gain.chi2 < (1.0 + NEEDLESS) * other.gain.chi2
            })
    };
    (0..candidates.len()).filter(|&place| !is_needless(place)).map(|place| candidates[place]).collect()
}

impl Explained {
    /// The changes of a gyro, those of the whole unit left out.
    fn on(&self, gyro: usize) -> impl Iterator<Item = (usize, &FittedHypothesis)> {
        let is_own = move |change: &Hypothesis| !change.amplitude.is_of_unit() && change.gyros[gyro];
        self.state.held.iter().enumerate().filter(move |(_, held)| is_own(&held.hypothesis))
    }

    /// By how much χ² falls with a change, beside all the others, and what was paid for it.
    pub fn worth(&self, case: &Case, index: usize) -> (f64, f64) {
        let (without, normal) = self.without(case, index);
        (normal.squares() - self.normal.squares(), self.cost(index, &without))
    }

    /// What was paid for a change, and for the lag that goes with it.
    fn cost(&self, index: usize, without: &State) -> f64 {
        self.state.held[index].penalty + lag_chi2(&self.state) - lag_chi2(without)
    }

    /// Takes a change back, wherever it is told.
    fn forget(&mut self, index: usize) -> FittedHypothesis {
        for round in &mut self.rounds {
            round.kept = match round.kept {
                Some(kept) if kept == index => None,
                Some(kept) if kept > index => Some(kept - 1),
                kept => kept,
            };
        }
        self.state.remove(index)
    }

    /// Everything but one change, fitted anew.
    fn without(&self, case: &Case, index: usize) -> (State, Normal) {
        let mut state = self.state.clone();
        state.remove(index);
        let normal = case.fit(&mut state);
        (state, normal)
    }

    /// Makes one change of two that differ in their gyros alone.
    pub fn join(&mut self, case: &Case, one: usize, other: usize) {
        let second = self.forget(other);
        let first = &mut self.state.held[one];
        first.hypothesis.gyros.iter_mut().zip(second.hypothesis.gyros).for_each(|(own, other)| *own |= other);
        first.run_anew();
        first.sigmas.fill(f64::NAN);
        first.penalty = first.penalty.max(second.penalty);
        let sum = |own: Option<f64>, other: Option<f64>| match (own, other) {
            (Some(own), Some(other)) => Some(own + other),
            (own, other) => own.or(other),
        };
        first.held_out = std::array::from_fn(|third| sum(first.held_out[third], second.held_out[third]));
        self.normal = case.fit(&mut self.state);
    }

    /// Drops what acts on no other gyros than these.
    pub fn drop_on(&mut self, case: &Case, gyros: &[bool; 4]) {
        let is_kept = |held: &FittedHypothesis| {
            held.hypothesis.amplitude.is_of_unit()
                || held.hypothesis.gyros.iter().zip(gyros).any(|(own, other)| *own && !other)
        };
        for index in (0..self.state.held.len()).rev() {
            if !is_kept(&self.state.held[index]) {
                self.forget(index);
            }
        }
        self.normal = case.fit(&mut self.state);
    }

    fn start(case: &Case, mut state: State) -> Explained {
        let normal = case.fit(&mut state);
        Explained { state, normal, rounds: Vec::new(), noise: Vec::new(), is_cut: false, refused: None }
    }

    /// Drops each change that, beside all the others, is not worth what was paid for it. Where walks are larger than believed, what was
    /// paid is too little: then a change must also better a walk in its place.
    pub fn prune(&mut self, case: &Case) {
        let is_noisy = self.noise.iter().any(|found| found.is_told(case.believed, &self.state));
        loop {
            let without = |index: usize| {
                let (mut state, normal) = self.without(case, index);
                let walked = if is_noisy { walked(case, &mut state, &self.state.held[index].hypothesis) } else { 0.0 };
                let spare = normal.squares() - self.normal.squares() - self.cost(index, &state);
                (spare - walked, index, state, normal)
            };
            let all: Vec<_> = (0..self.state.held.len()).into_par_iter().map(without).collect();
            match all.into_iter().min_by(|one, other| one.0.total_cmp(&other.0)) {
                Some((worth, index, state, normal)) if worth <= 0.0 => {
                    self.forget(index);
                    (self.state, self.normal) = (state, normal);
                }
                _ => break,
            }
        }
    }
}
