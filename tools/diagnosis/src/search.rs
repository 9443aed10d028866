//! The search: every hypothesis of the bank, on every set of gyros, against the residual of a state.

use std::collections::HashMap;

use geu_model::parameter_spec::Role;
use rayon::prelude::*;

use crate::courses::{Mode, is_onset};
use crate::measured::CHANNELS;
use crate::model_state::ModelState;
use crate::normal_equations::{NormalEquations, SignatureFit, THIRDS};
use crate::null_distribution::Thresholds;
use crate::signature_bank::{HypothesisFamily, SignatureBank};
use crate::significance::{THREE_SIGMA_CHI2, TWO_SIGMA_CHI2};
use crate::spots::{Spot, spots};
use geu_hypothesis::Hypothesis;
use geu_hypothesis::amplitude::AmplitudeRef;
use geu_protocol::Gyros;

/// Candidates with optimised shape parameters.
const OPTIMISED: usize = 16;
/// Additional ones on each of several sets of gyros with separate hypotheses, of each time course if steps are searched on a finer grid.
const OPTIMISED_ON_SET: usize = 4;

/// A hypothesis with its fit.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// The hypothesis with the fitted amplitude.
    pub hypothesis: Hypothesis,
    /// Family.
    pub family: HypothesisFamily,
    /// Fit.
    pub gain: SignatureFit,
    /// Cross-validation ([`NormalEquations::cross_validate`]) before a fit.
    pub held_out: [Option<f64>; THIRDS],
    /// Signature.
    pub spot: Spot,
    /// True if neighbouring values add much more or less in proportion.
    pub is_steep: bool,
    /// Value up to which it is not searched.
    pub unsearched: f64,
}

impl Candidate {
    /// Cross-validates a spot.
    pub fn new(bank: &SignatureBank, normal: &NormalEquations, spot: Spot) -> Candidate {
        Candidate {
            hypothesis: spot.hypothesis(bank),
            family: spot.family(bank),
            gain: spot.gain,
            held_out: spot.signature(bank, normal).cross_validate(normal),
            is_steep: bank.bases[spot.base].is_steep(),
            unsearched: bank.unsearched(&bank.bases[spot.base]),
            spot,
        }
    }
}

/// True if a cross-validation ([`NormalEquations::cross_validate`]) is positive in all. A third that contains nearly all information is not
/// predictable; then the others may rise by `THREE_SIGMA_CHI2`.
pub fn passes_cross_validation(held_out: &[Option<f64>; THIRDS]) -> bool {
    let all = held_out.iter().all(Option::is_some);
    let sum: f64 = held_out.iter().flatten().sum();
    sum > if all { 0.0 } else { -THREE_SIGMA_CHI2 }
}

/// Largest number of gyros of which every set is searched.
const MAX_SUBSETS: usize = 4;

/// Sets of these gyros of a unit on which one value of an amplitude may act, among the channels that it reaches.
pub fn sets(gyros: Gyros, amplitude: &AmplitudeRef, reached: [bool; CHANNELS]) -> Vec<Gyros> {
    if amplitude.is_of_unit() {
        return vec![gyros];
    }
    let reached = gyros.filter(|gyro| reached[gyro]);
    let all = (1..=gyros.mask()).map(|mask| gyros.with_mask(mask)).filter(|set| set.is_within(&reached));
    // Of many gyros one, all but one, or all: a cause acts on one gyro or on the unit.
    let is_likely = |set: &Gyros| {
        gyros.heads() <= MAX_SUBSETS || set.count() == 1 || set.count() + 1 >= gyros.heads() || *set == reached
    };
    all.filter(is_likely).collect()
}

/// Penalty of the shapes of a time course: that of a shape parameter for each.
pub fn shape_penalty(hypothesis: &Hypothesis) -> f64 {
    TWO_SIGMA_CHI2 * hypothesis.course_shapes.len() as f64
}

/// Penalty of a set of several gyros beside one gyro or all of them, at the default unit: there are ten, together a tenth as likely, since a cause acts on
/// one gyro or on all.
pub fn set_penalty(gyros: &Gyros, amplitude: &AmplitudeRef) -> f64 {
    if !amplitude.is_of_unit() && is_several(gyros) { 2.0 * 100f64.ln() } else { 0.0 }
}

/// True for several gyros, neither one nor all.
pub fn is_several(gyros: &Gyros) -> bool {
    (2..gyros.heads()).contains(&gyros.count())
}

/// The disjoint sets of gyros with the highest sum of positive scores. Gyros have independent noise, so that the χ² reductions of
/// hypotheses on different gyros add up.
pub fn separate_sets(scored: impl Iterator<Item = (Gyros, f64)>) -> Vec<Gyros> {
    let mut scored = scored.peekable();
    let Some(unit) = scored.peek().map(|(gyros, _)| gyros.unit()) else { return Vec::new() };
    let count = 1 << unit.heads();
    let mut of_set = vec![0.0; count];
    scored.for_each(|(gyros, score)| of_set[gyros.mask()] = score.max(of_set[gyros.mask()]));
    // For each set its best sum, and the disjoint set that contains its first gyro.
    let mut best = vec![(0.0, 0); count];
    for all in 1..count {
        let first = all & all.wrapping_neg();
        let sets = (1..=all).filter(|set| set & all == *set && set & first != 0);
        let sums = sets.map(|set| (of_set[set] + best[all ^ set].0, set));
        best[all] = sums.fold((f64::NEG_INFINITY, 0), |best, own| if own.0 > best.0 { own } else { best });
    }
    let mut sets = Vec::new();
    let mut rest = count - 1;
    while rest != 0 {
        let set = best[rest].1;
        sets.extend((of_set[set] > 0.0).then(|| unit.with_mask(set)));
        rest ^= set;
    }
    sets
}

/// The best searched time course of each amplitude and set of gyros, best first, without any that a configuration cannot contain beside
/// the hypotheses of the state, on these gyros; only on all of them also effects of the unit and immediate effects. Scores have the penalties
/// of `thresholds`, if any.
pub fn best_spots(
    bank: &SignatureBank,
    normal: &NormalEquations,
    state: &ModelState,
    thresholds: Option<&Thresholds>,
    gyros: &Gyros,
) -> Vec<Spot> {
    let has_all = gyros.is_all();
    let of_base = |index: usize| {
        let amplitude = &bank.bases[index].amplitude;
        if !has_all && (amplitude.is_of_unit() || amplitude.own_shapes().iter().any(is_onset)) {
            return Vec::new();
        }
        let has = std::array::from_fn(|channel| if channel < gyros.heads() { gyros[channel] } else { has_all });
        spots(
            bank,
            normal,
            index,
            has,
            |reached| sets(bank.gyros(), amplitude, reached),
            |spot| is_possible(bank, state, spot),
        )
    };
    let found: Vec<Vec<Spot>> = (0..bank.bases.len()).into_par_iter().map(of_base).collect();
    let score = |spot: &Spot| score(bank, thresholds, spot);
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
    best
}

/// True if a configuration can contain a spot beside the hypotheses of the state.
fn is_possible(bank: &SignatureBank, state: &ModelState, spot: &Spot) -> bool {
    let amplitude = spot.amplitude(bank);
    let is_held = state.held.iter().any(|held| held.hypothesis.conflicts(amplitude, &spot.gyros));
    !is_held && spot.is_valid(bank) && spot.hypothesis(bank).is_within_limits() && spot.is_physical(bank, state)
}

/// χ² reduction less the penalties.
pub fn score(bank: &SignatureBank, thresholds: Option<&Thresholds>, spot: &Spot) -> f64 {
    let required = thresholds.map_or(0.0, |thresholds| thresholds.required(spot.family(bank)));
    spot.gain.chi2 - required - set_penalty(&spot.gyros, &spot.amplitude(bank))
}

/// The best candidate of each amplitude and set of gyros, best first: [`best_spots`] with optimised shape parameters.
pub fn search(
    bank: &SignatureBank,
    normal: &NormalEquations,
    state: &ModelState,
    thresholds: Option<&Thresholds>,
) -> Vec<Candidate> {
    let score = |spot: &Spot| score(bank, thresholds, spot);
    let best = best_spots(bank, normal, state, thresholds, &bank.gyros());
    let separate = separate_sets(best.iter().map(|spot| (spot.gyros, score(spot))));
    let is_finer = bank.step_spacing_s(Mode::Rate).is_some();
    let mut seen: HashMap<(Gyros, Option<usize>), usize> = HashMap::new();
    let is_kept = |(place, spot): (usize, Spot)| {
        let count = seen.entry((spot.gyros, spot.variation.kind().filter(|_| is_finer))).or_default();
        *count += 1;
        (place < OPTIMISED || *count <= OPTIMISED_ON_SET && separate.contains(&spot.gyros)).then_some(spot)
    };
    let settles = |spot: &Spot| spot.variation.shape(Role::TimeConstant).is_some();
    let (settling, others): (Vec<Spot>, Vec<Spot>) =
        best.into_iter().enumerate().filter_map(is_kept).partition(settles);
    let mut best: Vec<Spot> = others.into_par_iter().map(|spot| optimised(bank, normal, state, &[], spot)).collect();
    // What settles may begin with the step or pulse of its amplitude, between two onsets of the grid.
    let settled = |spot: Spot| {
        let same = best.iter().filter(|other| (other.base, other.gyros) == (spot.base, spot.gyros));
        let onsets_s: Vec<f64> = same.filter_map(|other| other.variation.shape(Role::Onset)).collect();
        optimised(bank, normal, state, &onsets_s, spot)
    };
    let settling: Vec<Spot> = settling.into_par_iter().map(settled).collect();
    best.extend(settling);
    best.sort_by(|a, b| score(b).total_cmp(&score(a)));
    without_repetitions(bank, &mut best);
    best.into_iter().map(|spot| Candidate::new(bank, normal, spot)).collect()
}

/// A spot with optimised shape parameters, or the step at the same onset if that explains nearly the same.
pub fn optimised(
    bank: &SignatureBank,
    normal: &NormalEquations,
    state: &ModelState,
    onsets_s: &[f64],
    spot: Spot,
) -> Spot {
    let best = spot.optimised(bank, normal, onsets_s, |spot| spot.is_physical(bank, state)).unwrap_or(spot);
    best.as_step(bank, normal, TWO_SIGMA_CHI2).filter(|spot| is_possible(bank, state, spot)).unwrap_or(best)
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
