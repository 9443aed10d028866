//! Fits of candidates by the model, and the choice among them.

use rayon::prelude::*;

use crate::diagnosis_case::DiagnosisCase;
use crate::fitted_hypothesis::FittedHypothesis;
use crate::model_state::ModelState;
use crate::normal_equations::{NormalEquations, THIRDS};
use crate::null_distribution::Thresholds;
use crate::search::{Candidate, shape_penalty};
use crate::signature_bank::{PARTS, SIZE_FACTOR};
use crate::spots::Spot;
use geu_hypothesis::Hypothesis;

use super::refine::{fit_last, is_possible};

/// Candidates fitted in each step.
pub(super) const FITTED: usize = 4;
/// Candidates with a smaller share of the best one's margin are not fitted.
const NEAR: f64 = 0.93;
/// Nor those whose χ² reduction is lower by this, if that is the lower limit.
pub(super) const NEAR_CHI2: f64 = 12.0;
/// If none of the better ones is acceptable, candidates with this share of the best one's margin are fitted: on a gyro with two
/// effects, neither may pass the cross-validation alone.
const LESSER: f64 = 0.5;
/// A time course is not fitted if a likelier one of the same amplitude explains as much up to this share.
const NEEDLESS: f64 = 0.02;
/// Scores that differ by less are equal.
const EQUAL_CHI2: f64 = 0.5;

/// Cross-validation of a hypothesis.
pub(super) type HeldOut = [Option<f64>; THIRDS];
/// A fitted candidate: χ² reduction beyond its penalty, place among the candidates, state and equations with it.
type Fit = (f64, usize, ModelState, NormalEquations);

/// Fits the best candidates beside a state; the likeliest acceptable one. If none is acceptable, the next ones are fitted.
pub(super) fn best_fit(
    case: &DiagnosisCase,
    thresholds: &Thresholds,
    state: &ModelState,
    normal: &NormalEquations,
    candidates: &[Candidate],
    is_predicted: fn(&HeldOut) -> bool,
) -> Option<Fit> {
    let penalty = |candidate: &Candidate| thresholds.penalty(candidate.family, &candidate.hypothesis);
    let margin = |candidate: &Candidate| candidate.gain.chi2 - penalty(candidate);
    let fitted = |candidate: &Candidate| -> Option<Fit> {
        let fit = fitted(case, thresholds, state, normal, candidate, is_predicted);
        let (fall, tried, tried_normal) = fit.filter(|(fall, ..)| *fall > 0.0)?;
        // The first of the candidates with this spot.
        let key = |spot: &Spot| (spot.base, spot.variation.clone(), spot.gyros);
        let place = candidates.iter().position(|other| key(&other.spot) == key(&candidate.spot))?;
        Some((fall, place, tried, tried_normal))
    };
    let min = LESSER * margin(candidates.first()?);
    let mut rest = candidates;
    while let Some(first) = rest.first().filter(|first| margin(first) >= min) {
        let best = margin(first);
        let min_margin = (NEAR * best).min(best - NEAR_CHI2);
        let is_equal = |candidate: &&Candidate| margin(candidate) > best - EQUAL_CHI2;
        let mut equal: Vec<&Candidate> = rest.iter().filter(is_equal).collect();
        equal.sort_by(|one, other| share_of_limit(&one.hypothesis).total_cmp(&share_of_limit(&other.hypothesis)));
        let others = rest.iter().filter(|candidate| !is_equal(candidate));
        let is_near = |candidate: &&Candidate| margin(candidate) >= min_margin;
        let near: Vec<&Candidate> = equal.into_iter().chain(others).take(FITTED).filter(is_near).collect();
        rest = &rest[near.len().max(1)..];
        let near = without_needless_courses(near);
        if let Some(fit) = simplest(near.into_par_iter().filter_map(fitted).collect()) {
            return Some(fit);
        }
    }
    None
}

/// Fits a candidate beside a state: χ² reduction beyond its penalty, state and equations with it; `None` if it is not possible or not
/// predicted.
pub(super) fn fitted(
    case: &DiagnosisCase,
    thresholds: &Thresholds,
    state: &ModelState,
    normal: &NormalEquations,
    candidate: &Candidate,
    is_predicted: fn(&HeldOut) -> bool,
) -> Option<(f64, ModelState, NormalEquations)> {
    let penalty = thresholds.penalty(candidate.family, &candidate.hypothesis);
    let fit_from = |start: &ModelState, hypothesis: Hypothesis| {
        let mut tried = start.clone();
        tried.held.push(FittedHypothesis::new(hypothesis).with_penalty(penalty));
        let tried_normal = fit_last(case, &mut tried);
        (tried, tried_normal)
    };
    let own = &candidate.hypothesis;
    let (mut tried, tried_normal) = match candidate.is_steep {
        true => steep_starts(case, state, own)
            .into_iter()
            .map(|(start, own)| fit_from(&start, own))
            .min_by(|one, other| one.1.squares().total_cmp(&other.1.squares()))?,
        false => fit_from(state, own.clone()),
    };
    let last = tried.held.len() - 1;
    tried.held[last].held_out = case.cross_validate(&tried, last);
    let held = &tried.held[last];
    let fall = normal.squares() - tried_normal.squares() - penalty;
    let is_searched = held.hypothesis.value > candidate.unsearched;
    let is_accepted = is_predicted(&held.held_out) && is_possible(held, case.measured.block_s()) && is_searched;
    is_accepted.then_some((fall, tried, tried_normal))
}

/// States and hypotheses from which a steep hypothesis is fitted: the state, and that with the calibration as given, since small turns that a
/// dead zone withholds look like another misalignment; each with the likeliest of several values up to the neighbouring ones of the search.
fn steep_starts(case: &DiagnosisCase, state: &ModelState, hypothesis: &Hypothesis) -> Vec<(ModelState, Hypothesis)> {
    let as_given = ModelState { held: state.held.clone(), ..case.start(state.noise) };
    let with_value = |start: ModelState| {
        let at = |step: i32| {
            let value = hypothesis.value * SIZE_FACTOR.powf(f64::from(step) / f64::from(PARTS));
            let tried = Hypothesis { value, ..hypothesis.clone() };
            let mut state = start.clone();
            state.held.push(FittedHypothesis::fixed(tried.clone()));
            (case.normal(&mut state).chi2(), tried)
        };
        let all: Vec<(f64, Hypothesis)> = (-PARTS..=PARTS).into_par_iter().map(at).collect();
        let likeliest = all.into_iter().min_by(|one, other| one.0.total_cmp(&other.0));
        (start, likeliest.map_or_else(|| hypothesis.clone(), |(_, own)| own))
    };
    [state.clone(), as_given].map(with_value).into()
}

/// χ² reduction less the penalties, and less by how much the thirds are predicted worse.
fn score(fit: &Fit) -> f64 {
    let predicted = |held: &FittedHypothesis| held.held_out.iter().flatten().sum::<f64>();
    fit.2.held.last().map_or(fit.0, |held| fit.0 - shape_penalty(&held.hypothesis) + predicted(held).min(0.0))
}

/// Amplitude as a share of its largest value.
fn share_of_limit(hypothesis: &Hypothesis) -> f64 {
    hypothesis.value.abs() / hypothesis.amplitude.size().max
}

/// The fit with the highest score, each shape of its time course with the penalty of a shape
/// parameter. Among equal fits, that with the smallest amplitude, as a share of its largest value.
fn simplest(tried: Vec<Fit>) -> Option<Fit> {
    let share = |fit: &Fit| fit.2.held.last().map_or(0.0, |held| share_of_limit(&held.hypothesis));
    let best = tried.iter().map(score).fold(f64::NEG_INFINITY, f64::max);
    let equal = tried.into_iter().filter(|fit| score(fit) > best - EQUAL_CHI2);
    equal.min_by(|one, other| share(one).total_cmp(&share(other)))
}

/// Removes time courses that explain nearly the same as a likelier one of the same amplitude and gyros without more shapes, or as the
/// constant amplitude.
fn without_needless_courses(candidates: Vec<&Candidate>) -> Vec<&Candidate> {
    let key = |candidate: &Candidate| (candidate.hypothesis.amplitude.constant(), candidate.hypothesis.gyros);
    let shapes = |candidate: &Candidate| candidate.hypothesis.course_shapes.len();
    let is_needless = |place: usize| {
        let own = candidates[place];
        let explains_it = |other: &&Candidate| {
            key(other) == key(own) && shapes(other) <= shapes(own) && own.gain.chi2 < (1.0 + NEEDLESS) * other.gain.chi2
        };
        own.hypothesis.amplitude.kind.is_some() && candidates[..place].iter().any(explains_it)
    };
    (0..candidates.len()).filter(|&place| !is_needless(place)).map(|place| candidates[place]).collect()
}
