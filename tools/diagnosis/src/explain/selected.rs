//! What is held of a recording, with its equations: what the loop adds to and takes from.

use geu_model::Configuration;

use crate::gyros::{Gyros, is_within};
use crate::hypothesis::Hypothesis;
use crate::late::lag_chi2;
use crate::measured::{CHANNELS, TIMING};
use crate::noise::{FittedNoise, Walk};
use crate::normal::NormalEquations;
use crate::null::Thresholds;
use crate::search::Candidate;
use crate::state::{DiagnosisCase, FittedHypothesis, ModelState};
use crate::whitening::NoiseModel;

/// Effects of one gyro that are believed; one more is looked for, and makes them a pile.
pub const MOST_OF_ONE: usize = 3;
/// What each further walk that is larger costs, where one is: one number more, which chance betters by less in nine of ten.
pub(super) const TOGETHER_CHI2: f64 = 2.7;
/// A walk is told from this many times the configured one on: rounding, while a gyro hardly turns, can look like half as much again.
const LEAST_WALK: f64 = 2.0;

/// A walk that is not as configured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseFound {
    /// The channel.
    pub channel: usize,
    /// Which walk.
    pub walk: Walk,
    /// As fitted.
    pub fitted: FittedNoise,
}

impl NoiseFound {
    /// The walk as it was believed.
    pub fn configured(&self, believed: &Configuration) -> f64 {
        let effects = &believed.gyros[self.channel].effects.constant;
        match self.walk {
            Walk::Angle => effects.angle_random_walk.arcsec_per_sqrt_s,
            Walk::Rate => effects.drift_random_walk.arcsec_per_s_per_sqrt_s,
        }
    }

    /// Whether it is so much larger than believed that it is no trick of rounding.
    pub fn is_told(&self, believed: &Configuration, state: &ModelState) -> bool {
        self.channel != TIMING && state.noise[self.channel].walk(self.walk) >= LEAST_WALK * self.configured(believed)
    }
}

/// A hypothesis of the search that explains much, and is none that there can be, or that the model, run, bears out.
#[derive(Debug, Clone, Copy)]
pub(super) struct RejectedHypothesis {
    pub(super) gyros: Gyros,
    /// The score that it would have.
    pub(super) score: f64,
}

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
    pub state: ModelState,
    /// Its equations.
    pub normal: NormalEquations,
    /// The rounds.
    pub rounds: Vec<Round>,
    /// Walks that are not as configured.
    pub noise: Vec<NoiseFound>,
    /// Whether more was to be found where there are as many as may be: on one gyro, or in all.
    pub is_cut: bool,
    /// What is left to find in the end and is not explained.
    pub(super) refused: Option<RejectedHypothesis>,
}

impl Explained {
    /// How unlikely all that is left is beside the sixteen and the lag, and all that was paid for names. A walk can look like
    /// anything, and is as dear as the dearest course.
    pub fn score(&self, case: &DiagnosisCase, thresholds: &Thresholds) -> f64 {
        self.score_with(case, thresholds, &self.state.noise)
    }

    pub(super) fn score_with(
        &self,
        case: &DiagnosisCase,
        thresholds: &Thresholds,
        noise: &[NoiseModel; CHANNELS],
    ) -> f64 {
        let own = self.noise.len().min(1) as f64 * thresholds.largest()
            + TOGETHER_CHI2 * self.noise.len().saturating_sub(1) as f64;
        let residual = case.residual(&self.state);
        let normal = NormalEquations::departed(case.whitenings(noise), &residual, &case.nuisances, &self.state.sixteen);
        normal.deviance() + self.state.held.iter().map(|held| held.penalty).sum::<f64>() + lag_chi2(&self.state) + own
    }
}

impl Explained {
    /// The changes of a gyro, those of the whole unit left out.
    pub(super) fn on(&self, gyro: usize) -> impl Iterator<Item = (usize, &FittedHypothesis)> {
        let is_own = move |change: &Hypothesis| !change.amplitude.is_of_unit() && change.gyros[gyro];
        self.state.held.iter().enumerate().filter(move |(_, held)| is_own(&held.hypothesis))
    }

    /// By how much χ² falls with a change, beside all the others, and what was paid for it.
    pub fn worth(&self, case: &DiagnosisCase, index: usize) -> (f64, f64) {
        let (without, normal) = self.without(case, index);
        (normal.squares() - self.normal.squares(), self.cost(index, &without))
    }

    /// What was paid for a change, and for the lag that goes with it.
    pub(super) fn cost(&self, index: usize, without: &ModelState) -> f64 {
        self.state.held[index].penalty + lag_chi2(&self.state) - lag_chi2(without)
    }

    /// Takes a change back, wherever it is told.
    pub(super) fn forget(&mut self, index: usize) -> FittedHypothesis {
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
    pub(super) fn without(&self, case: &DiagnosisCase, index: usize) -> (ModelState, NormalEquations) {
        let mut state = self.state.clone();
        state.remove(index);
        let normal = case.fit(&mut state);
        (state, normal)
    }

    /// Makes one change of two that differ in their gyros alone.
    pub fn join(&mut self, case: &DiagnosisCase, one: usize, other: usize) {
        let second = self.forget(other);
        let first = &mut self.state.held[one];
        first.hypothesis.gyros.iter_mut().zip(second.hypothesis.gyros).for_each(|(own, other)| *own |= other);
        first.invalidate();
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
    pub fn drop_on(&mut self, case: &DiagnosisCase, gyros: &[bool; 4]) {
        let is_kept = |held: &FittedHypothesis| {
            held.hypothesis.amplitude.is_of_unit() || !is_within(&held.hypothesis.gyros, gyros)
        };
        for index in (0..self.state.held.len()).rev() {
            if !is_kept(&self.state.held[index]) {
                self.forget(index);
            }
        }
        self.normal = case.fit(&mut self.state);
    }

    pub(super) fn start(case: &DiagnosisCase, mut state: ModelState) -> Explained {
        let normal = case.fit(&mut state);
        Explained { state, normal, rounds: Vec::new(), noise: Vec::new(), is_cut: false, refused: None }
    }
}
