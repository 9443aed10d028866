//! The loop: search, fit the best by the model, keep it where it pays, search again.

use rayon::prelude::*;

use crate::bank::Bank;
use crate::measured::Series;
use crate::normal::Normal;
use crate::null::Thresholds;
use crate::search::{Candidate, search, set_penalty};
use crate::state::{Case, Held, State};

/// Effects at most.
const MOST: usize = 6;
/// Candidates fitted in each round.
const FITTED: usize = 5;
/// Candidates whose score is worse than the best one's by more are not.
const NEAR: f64 = 40.0;

/// One round of the loop.
pub struct Round {
    /// What was looked at, the best first.
    pub candidates: Vec<Candidate>,
}

/// Where the loop ended.
pub struct Explained {
    /// All that is held.
    pub state: State,
    /// Its equations.
    pub normal: Normal,
    /// The rounds.
    pub rounds: Vec<Round>,
    /// χ² and all that was paid for names.
    pub score: f64,
}

/// Adds the best effect as long as one qualifies.
pub fn grow(case: &Case, bank: &Bank, thresholds: &Thresholds, mut state: State) -> Explained {
    let mut normal = case.fit(&mut state);
    let mut rounds = Vec::new();
    let mut paid = 0.0;
    while state.held.len() < MOST {
        let candidates = search(bank, &normal, &state, &|family| thresholds.of(family));
        let cost = |candidate: &Candidate| {
            thresholds.of(candidate.family) + set_penalty(&candidate.change.gyros, candidate.change.amplitude.place)
        };
        let Some(first) = candidates.first() else { break };
        let best_score = first.gain.chi2 - cost(first);
        let tried: Vec<(&Candidate, State, Normal)> = candidates
            .iter()
            .take(FITTED)
            .filter(|candidate| candidate.gain.chi2 - cost(candidate) > best_score - NEAR.max(0.5 * best_score))
            .filter(|candidate| candidate.gain.chi2 > 0.5 * cost(candidate))
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|candidate| {
                let mut tried = state.clone();
                tried.held.push(Held::new(candidate.change.clone()));
                let normal = case.fit(&mut tried);
                (candidate, tried, normal)
            })
            .collect();
        let before = normal.squares();
        let best = tried
            .into_iter()
            .map(|(candidate, state, normal)| (before - normal.squares() - cost(candidate), candidate, state, normal))
            .max_by(|one, other| one.0.total_cmp(&other.0));
        let Some((gain, candidate, next, next_normal)) = best else { break };
        let cost = cost(candidate);
        rounds.push(Round { candidates: candidates.clone() });
        if gain <= 0.0 {
            break;
        }
        (state, normal) = (next, next_normal);
        paid += cost;
    }
    let score = normal.squares() + paid;
    Explained { state, normal, rounds, score }
}

/// Residual of the state.
pub fn residual(case: &Case, state: &State) -> Series {
    case.residual(state)
}
