//! The search: every hypothesis of the bank, on every set of gyros, against what the state leaves.

use rayon::prelude::*;

use crate::amplitude::AmplitudeRef;
use crate::bank::{HypothesisFamily, SignatureBank};
use crate::gyros::{ALL_GYROS, Gyros, overlap};
use crate::hypothesis::Hypothesis;
use crate::measured::{CHANNELS, TIMING};
use crate::normal::{NormalEquations, SignatureFit, THIRDS};
use crate::spots::{Spot, spots};
use crate::state::ModelState;

/// What noise alone may take away from the thirds that have little of it: three sigma, however much the gain is.
const HARM_CHI2: f64 = 9.0;
/// Candidates whose shapes are fitted.
const CLIMBED: usize = 16;

/// A hypothesis with what it explains.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// What it is, at the size that fits.
    pub hypothesis: Hypothesis,
    /// Its family.
    pub family: HypothesisFamily,
    /// What it explains.
    pub gain: SignatureFit,
    /// By how much better each third is foretold by the others ([`NormalEquations::held_out`]).
    pub held_out: [Option<f64>; THIRDS],
    /// What it was found by.
    pub spot: Spot,
}

impl Candidate {
    /// Whether it pays on what was not fitted.
    pub fn passes_cross_validation(&self) -> bool {
        pays(&self.held_out)
    }
}

/// Whether a hypothesis by which each third is so much better foretold pays on what was not fitted. Where a third has nearly all that
/// tells of it, and cannot be foretold, it is enough that it does no harm to the others.
pub fn pays(held_out: &[Option<f64>; THIRDS]) -> bool {
    let all = held_out.iter().all(Option::is_some);
    let sum: f64 = held_out.iter().flatten().sum();
    sum > if all { 0.0 } else { -HARM_CHI2 }
}

/// Sets of gyros that an amplitude may act on together with one value, of the channels that it reaches.
pub fn sets(amplitude: &AmplitudeRef, reached: [bool; CHANNELS]) -> Vec<Gyros> {
    if amplitude.is_of_unit() {
        return vec![ALL_GYROS];
    }
    let all = (1u8..16).map(|mask| std::array::from_fn(|gyro| mask & (1 << gyro) != 0));
    all.filter(|set: &Gyros| (0..TIMING).all(|gyro| reached[gyro] || !set[gyro])).collect()
}

/// What a set of gyros costs beside one gyro or all of them: there are ten ways to choose two or three of four.
pub fn set_penalty(gyros: &Gyros, amplitude: &AmplitudeRef) -> f64 {
    let count = gyros.iter().filter(|has| **has).count();
    if !amplitude.is_of_unit() && (count == 2 || count == 3) { 2.0 * 10f64.ln() } else { 0.0 }
}

/// The best candidate of each code and set of gyros, the best first; those of `held` codes on their own gyros left out where a
/// configuration holds only one.
pub fn search(
    bank: &SignatureBank,
    normal: &NormalEquations,
    state: &ModelState,
    penalty: &(dyn Fn(HypothesisFamily) -> f64 + Sync),
) -> Vec<Candidate> {
    let is_held = |spot: &Spot| {
        state.held.iter().any(|held| {
            held.hypothesis.amplitude == spot.amplitude(bank) && overlap(&held.hypothesis.gyros, &spot.gyros)
        })
    };
    let is_possible = |spot: &Spot| !is_held(spot) && spot.hypothesis(bank).is_within_limits() && spot.stands(bank);
    let of_base =
        |index: usize| spots(bank, normal, index, |reached| sets(&bank.bases[index].amplitude, reached), is_possible);
    let found: Vec<Vec<Spot>> = (0..bank.bases.len()).into_par_iter().map(of_base).collect();
    let score =
        |spot: &Spot| spot.gain.chi2 - penalty(spot.family(bank)) - set_penalty(&spot.gyros, &spot.amplitude(bank));
    let mut best: Vec<Spot> = Vec::new();
    for spot in found.into_iter().flatten() {
        // One for each code and set of gyros, whatever its shapes.
        let is_same = |other: &Spot| other.gyros == spot.gyros && other.amplitude(bank) == spot.amplitude(bank);
        match best.iter().position(is_same) {
            Some(place) if score(&best[place]) < score(&spot) => best[place] = spot,
            Some(_) => {}
            None => best.push(spot),
        }
    }
    best.sort_by(|a, b| score(b).total_cmp(&score(a)));
    // Between the points of the grid.
    best.truncate(CLIMBED);
    let climbed = |spot: Spot| spot.climbed(bank, normal, |_| true).unwrap_or(spot);
    let mut best: Vec<Spot> = best.into_par_iter().map(climbed).collect();
    best.sort_by(|a, b| score(b).total_cmp(&score(a)));
    let candidate = |spot: Spot| Candidate {
        hypothesis: spot.hypothesis(bank),
        family: spot.family(bank),
        gain: spot.gain,
        held_out: normal.held_out(&spot.signature(bank, normal).products),
        spot,
    };
    best.into_iter().map(candidate).collect()
}
