//! Model selection: search, fit of the best candidates by the model, acceptance if χ² falls by more than the penalty, and again.
//!
//! The same data may show several effects or noise above its configured level: both orders are fitted, and the likelier one is
//! accepted.
//!
//! `selected` holds the state; `refine`, `noise` and `acceptance` act on it and use each other in this order only.

mod acceptance;
mod noise;
mod refine;
mod selected;

use rayon::prelude::*;

use crate::measured::TIMING;
use crate::model_state::{DiagnosisCase, FittedHypothesis, ModelState};
use crate::normal_equations::NormalEquations;
use crate::null_distribution::Thresholds;
use crate::search::{Candidate, passes_cross_validation, search};
use crate::signature_bank::SignatureBank;
use crate::spots::Spot;

use acceptance::REJECTED_CHI2;
use refine::is_possible;

pub use selected::{IdentifiedNoise, MAX_PER_GYRO, SelectedModel, SelectionStep};

/// Maximum number of effects.
const MAX_EFFECTS: usize = 6;
/// Candidates fitted in each step.
const FITTED: usize = 4;
/// Candidates with a smaller share of the best one's margin are not fitted.
const NEAR: f64 = 0.93;
/// Nor those that explain less than this share of their penalty: their shape parameters are almost optimal already.
const MIN_SHARE: f64 = 0.8;
/// Nor those whose χ² reduction is lower by this, if that is the lower limit.
const NEAR_CHI2: f64 = 12.0;
/// A time course is not fitted if a likelier one of the same amplitude explains as much up to this share.
const NEEDLESS: f64 = 0.02;

/// Selects the model that explains the recording best: effects of the bank, noise, or both; at most `per_gyro` + 1 effects on a gyro.
pub fn select_model(
    case: &DiagnosisCase,
    bank: &SignatureBank,
    thresholds: &Thresholds,
    start: &ModelState,
    per_gyro: usize,
) -> SelectedModel {
    let finished = |mut selected: SelectedModel| {
        selected.free_noise(case, thresholds);
        selected.prune(case);
        selected.settled(case, thresholds)
    };
    let grown = |selected| grow(case, bank, thresholds, selected, per_gyro);
    let effects_first = || finished(grown(SelectedModel::start(case, start.clone())));
    let noise_first = || {
        let mut noise = SelectedModel::start(case, start.clone());
        noise.free_noise(case, thresholds);
        if noise.noise.is_empty() {
            return None;
        }
        let mut noise = grown(noise);
        // The walks are fitted again beside the effects.
        noise.reset_noise(case, &[true; TIMING]);
        Some(finished(noise))
    };
    let ((effects, effects_score), noise) = rayon::join(effects_first, noise_first);
    match noise {
        Some((noise, noise_score)) if noise_score < effects_score => noise,
        _ => effects,
    }
}

/// Adds the best effect as long as one is acceptable and no gyro has more than `per_gyro`.
fn grow(
    case: &DiagnosisCase,
    bank: &SignatureBank,
    thresholds: &Thresholds,
    mut now: SelectedModel,
    per_gyro: usize,
) -> SelectedModel {
    let penalty = |candidate: &Candidate| thresholds.penalty(candidate.family, &candidate.hypothesis);
    let margin = |candidate: &Candidate| candidate.gain.chi2 - penalty(candidate);
    loop {
        let bank_now = bank.late(now.state.shifts.temperature_s);
        let candidates = search(&bank_now, &now.normal, &now.state, &|family| thresholds.required(family));
        let Some(first) = candidates.first() else { break };
        let best = margin(first);
        if now.state.held.len() >= MAX_EFFECTS || (0..TIMING).any(|gyro| now.on(gyro).count() > per_gyro) {
            now.is_cut = best > 0.0;
            break;
        }
        let fitted = |candidate: &Candidate| -> Option<(f64, usize, ModelState, NormalEquations)> {
            let mut state = now.state.clone();
            let held = FittedHypothesis::new(candidate.hypothesis.clone());
            state.held.push(held.with_penalty(penalty(candidate), candidate.held_out));
            let normal = case.fit(&mut state);
            let fall = now.normal.squares() - normal.squares() - penalty(candidate);
            // The first of the candidates with this spot.
            let key = |spot: &Spot| (spot.base, spot.variation.clone(), spot.gyros);
            let place = candidates.iter().position(|other| key(&other.spot) == key(&candidate.spot))?;
            let is_accepted = fall > 0.0 && passes_cross_validation(&candidate.held_out);
            (is_accepted && is_possible(state.held.last()?)).then_some((fall, place, state, normal))
        };
        let min_margin = (NEAR * best).min(best - NEAR_CHI2);
        let near = candidates.iter().take(FITTED).filter(|candidate| {
            candidate.gain.chi2 > MIN_SHARE * penalty(candidate) && margin(candidate) >= min_margin
        });
        let near = without_needless_courses(near.collect());
        let tried: Vec<_> = near.into_par_iter().filter_map(fitted).collect();
        let chosen = tried.into_iter().max_by(|one, other| one.0.total_cmp(&other.0));
        let mut step = SelectionStep { candidates: candidates.clone(), kept: None, added: None };
        let Some((_, place, state, normal)) = chosen else {
            now.steps.push(step);
            if best > REJECTED_CHI2 && best > now.negligible(case) {
                now.reject(case, &bank_now, thresholds, first);
            }
            break;
        };
        (step.kept, step.added) = (Some(state.held.len() - 1), Some(place));
        now.steps.push(step);
        (now.state, now.normal) = (state, normal);
        now.shift_temperature(case, bank, thresholds);
        now.free_shapes(case);
        now.round_count(case);
    }
    now
}

/// Removes time courses that explain nearly the same as a likelier one of the same amplitude and gyros, or as the constant amplitude.
fn without_needless_courses(candidates: Vec<&Candidate>) -> Vec<&Candidate> {
    let key = |candidate: &Candidate| (candidate.hypothesis.amplitude.constant(), candidate.hypothesis.gyros);
    let is_needless = |place: usize| {
        let own = candidates[place];
        own.hypothesis.amplitude.kind.is_some()
            && candidates[..place]
                .iter()
                .any(|other| key(other) == key(own) && own.gain.chi2 < (1.0 + NEEDLESS) * other.gain.chi2)
    };
    (0..candidates.len()).filter(|&place| !is_needless(place)).map(|place| candidates[place]).collect()
}
