//! The search: every hypothesis of the bank, on every set of gyros, against the residual of a state.

use rayon::prelude::*;

use crate::measured::{CHANNELS, TIMING};
use crate::model_state::ModelState;
use crate::normal_equations::{NormalEquations, SignatureFit, THIRDS};
use crate::null_distribution::Thresholds;
use crate::signature_bank::{HypothesisFamily, SignatureBank};
use crate::spots::{Spot, spots};
use geu_hypothesis::Hypothesis;
use geu_hypothesis::amplitude::AmplitudeRef;
use geu_hypothesis::gyros::{ALL_GYROS, Gyros};

/// Maximum rise of χ² in the predictable thirds if one is not predictable: three sigma.
const MAX_RISE_CHI2: f64 = 9.0;
/// χ² reduction by a shape parameter for which it is fitted, two sigma; the penalty of each shape of a time course.
pub const SHAPE_CHI2: f64 = 4.0;
/// Candidates with optimised shape parameters.
const OPTIMISED: usize = 16;

/// A hypothesis with its fit.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// The hypothesis with the fitted amplitude.
    pub hypothesis: Hypothesis,
    /// Family.
    pub family: HypothesisFamily,
    /// Fit.
    pub gain: SignatureFit,
    /// Cross-validation ([`NormalEquations::cross_validate`]).
    pub held_out: [Option<f64>; THIRDS],
    /// Signature.
    pub spot: Spot,
}

/// True if a cross-validation ([`NormalEquations::cross_validate`]) is positive in all. A third that contains nearly all information is not
/// predictable; then the others may rise by `MAX_RISE_CHI2`.
pub fn passes_cross_validation(held_out: &[Option<f64>; THIRDS]) -> bool {
    let all = held_out.iter().all(Option::is_some);
    let sum: f64 = held_out.iter().flatten().sum();
    sum > if all { 0.0 } else { -MAX_RISE_CHI2 }
}

/// Sets of gyros on which one value of an amplitude may act, among the channels that it reaches.
pub fn sets(amplitude: &AmplitudeRef, reached: [bool; CHANNELS]) -> Vec<Gyros> {
    if amplitude.is_of_unit() {
        return vec![ALL_GYROS];
    }
    let all = (1u8..16).map(|mask| std::array::from_fn(|gyro| mask & (1 << gyro) != 0));
    all.filter(|set: &Gyros| (0..TIMING).all(|gyro| reached[gyro] || !set[gyro])).collect()
}

/// Penalty of the shapes of a time course: that of a shape parameter for each.
pub fn shape_penalty(hypothesis: &Hypothesis) -> f64 {
    SHAPE_CHI2 * hypothesis.course_shapes.len() as f64
}

/// Penalty of a set of two or three gyros beside one gyro or all of them: there are ten, together a tenth as likely, since a cause acts on
/// one gyro or on all.
pub fn set_penalty(gyros: &Gyros, amplitude: &AmplitudeRef) -> f64 {
    let count = gyros.iter().filter(|has| **has).count();
    if !amplitude.is_of_unit() && (count == 2 || count == 3) { 2.0 * 100f64.ln() } else { 0.0 }
}

/// The best candidate of each amplitude and set of gyros, best first, without any that a configuration cannot contain beside the
/// hypotheses of the state. Scores have the penalties of `thresholds`, if any.
pub fn search(
    bank: &SignatureBank,
    normal: &NormalEquations,
    state: &ModelState,
    thresholds: Option<&Thresholds>,
) -> Vec<Candidate> {
    let is_held =
        |spot: &Spot| state.held.iter().any(|held| held.hypothesis.conflicts(spot.amplitude(bank), &spot.gyros));
    let is_possible = |spot: &Spot| !is_held(spot) && spot.hypothesis(bank).is_within_limits() && spot.is_valid(bank);
    let of_base =
        |index: usize| spots(bank, normal, index, |reached| sets(&bank.bases[index].amplitude, reached), is_possible);
    let found: Vec<Vec<Spot>> = (0..bank.bases.len()).into_par_iter().map(of_base).collect();
    let required = |family| thresholds.map_or(0.0, |thresholds| thresholds.required(family));
    let score =
        |spot: &Spot| spot.gain.chi2 - required(spot.family(bank)) - set_penalty(&spot.gyros, &spot.amplitude(bank));
    let mut best: Vec<Spot> = Vec::new();
    for spot in found.into_iter().flatten() {
        let is_same = |other: &Spot| other.gyros == spot.gyros && other.amplitude(bank) == spot.amplitude(bank);
        match best.iter().position(is_same) {
            Some(place) if score(&best[place]) < score(&spot) => best[place] = spot,
            Some(_) => {}
            None => best.push(spot),
        }
    }
    best.sort_by(|a, b| score(b).total_cmp(&score(a)));
    best.truncate(OPTIMISED);
    let optimised = |spot: Spot| {
        let best = spot.optimised(bank, normal, |_| true).unwrap_or(spot);
        best.as_step(bank, normal, SHAPE_CHI2).filter(is_possible).unwrap_or(best)
    };
    let mut best: Vec<Spot> = best.into_par_iter().map(optimised).collect();
    best.sort_by(|a, b| score(b).total_cmp(&score(a)));
    without_repetitions(bank, &mut best);
    let candidate = |spot: Spot| Candidate {
        hypothesis: spot.hypothesis(bank),
        family: spot.family(bank),
        gain: spot.gain,
        held_out: normal.cross_validate(&spot.signature(bank, normal).products),
        spot,
    };
    best.into_iter().map(candidate).collect()
}

/// Removes all but the best of each amplitude and set of gyros, since a step may have two origins.
fn without_repetitions(bank: &SignatureBank, best: &mut Vec<Spot>) {
    let mut seen: Vec<(AmplitudeRef, Gyros)> = Vec::new();
    best.retain(|spot| {
        let key = (spot.amplitude(bank), spot.gyros);
        let is_new = !seen.contains(&key);
        seen.push(key);
        is_new
    });
}
