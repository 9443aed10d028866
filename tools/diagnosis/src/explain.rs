//! The loop: search, fit the best by the model, keep it where it pays, search again.
//!
//! Everything is weighed alike: an entry costs what the search would find by chance in its family, and pays what χ² falls by. The
//! same data may speak of several effects or of noise that is larger than believed: both ways are gone, and the cheaper one holds.
//!
//! `selected` is what is held; `refine`, `walks` and `doubt` act on it and know of each other in this order alone.

mod doubt;
mod refine;
mod selected;
mod walks;

use rayon::prelude::*;

use crate::bank::SignatureBank;
use crate::measured::TIMING;
use crate::normal::NormalEquations;
use crate::null::Thresholds;
use crate::search::{Candidate, search};
use crate::spots::Spot;
use crate::state::{DiagnosisCase, FittedHypothesis, ModelState};

use doubt::REFUSED_CHI2;
use refine::is_possible;

pub use selected::{Explained, MOST_OF_ONE, NoiseFound, Round};

/// Effects at most.
const MOST: usize = 6;
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

/// What explains the recording best: effects of the bank, noise, or both; up to one more effect than `most` on one gyro.
pub fn select_model(
    case: &DiagnosisCase,
    bank: &SignatureBank,
    thresholds: &Thresholds,
    start: &ModelState,
    most: usize,
) -> Explained {
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
        noise.reset_noise(case, &[true; TIMING]);
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
fn grow(
    case: &DiagnosisCase,
    bank: &SignatureBank,
    thresholds: &Thresholds,
    mut now: Explained,
    most: usize,
) -> Explained {
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
        let fitted = |candidate: &Candidate| -> Option<(f64, Candidate, ModelState, NormalEquations)> {
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
            .filter(|(fall, candidate, ..)| *fall > 0.0 && candidate.passes_cross_validation())
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
            let key = |spot: &Spot| (spot.base, spot.variation.clone(), spot.gyros);
            key(&other.spot) == key(&candidate.spot)
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
