//! What else would do: for each thing found, every other hypothesis in its place, beside the nuisances and all else that was found.
//!
//! A rival that explains the data nearly as well cannot be told apart by them, whatever the search took: what was found is then one
//! of a group. How alike the two are on this motion is the whitened cosine of their signatures.

use geu_model::course::TimeFunction;
use rayon::prelude::*;

use crate::bank::{ConstantSignature, HypothesisFamily, SignatureBank};
use crate::gyros::{ALL_GYROS, Gyros, is_within, only};
use crate::hypothesis::Hypothesis;
use crate::late::{self, LAG_CHI2, LaggedFit, following_temperature};
use crate::measured::{Series, TIMING};
use crate::normal::NormalEquations;
use crate::signature::Signature;
use crate::spots::{Spot, spots};
use crate::state::{DiagnosisCase, FittedHypothesis, ModelState};

/// Those that explain a smaller share of what was found explains are none: the square of a cosine of 0.3.
const LEAST_SHARE: f64 = 0.09;
/// Rivals whose shapes are fitted.
const CLIMBED: usize = 24;
/// Rivals at most.
const MOST: usize = 64;
/// A group whose members cannot be told apart: what χ² falls by differs by less than this, three sigma.
pub const APART_CHI2: f64 = 9.0;
/// Other courses of what was found that are so far behind are fitted by the model before they are said to be apart: signatures tell
/// of the effect's own shapes on a grid alone. Of what is not linear, however far.
const NEAR_CHI2: f64 = 30.0;
/// As many at most.
const FITTED: usize = 3;

/// A hypothesis in the place of one that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Alternative {
    /// What it is.
    pub hypothesis: Hypothesis,
    /// Its family.
    pub family: HypothesisFamily,
    /// Cosine of the two signatures, whitened and beside the nuisances; without sign.
    pub cosine: f64,
    /// Up to how far behind it is fitted by the model.
    reach_chi2: f64,
    /// By how much more χ² falls with the one that was found, less what that is dearer; 0 where it falls no more.
    pub behind_chi2: f64,
}

/// What is paid for a name: what chance does in its family. A rival that is cheaper may be so much farther behind.
pub struct Penalties<'a> {
    /// For the one that was found.
    pub found: f64,
    /// For a hypothesis.
    pub of: &'a (dyn Fn(HypothesisFamily, &Hypothesis) -> f64 + Sync),
}

/// The rivals of the change at `index` of a state on the data, the best first.
pub fn rivals(
    case: &DiagnosisCase,
    bank: &SignatureBank,
    state: &ModelState,
    index: usize,
    prices: &Penalties,
) -> Vec<Alternative> {
    let achieved = case.normal(&mut state.clone()).chi2();
    // What follows a temperature that is told late is not the model's only word on when it is told.
    let is_own = state.held[index].follows_temperature()
        && state.held.iter().filter(|held| held.follows_temperature()).count() == 1;
    let beside = |temperature_s: f64| -> Vec<Alternative> {
        // The lag was paid for with what was found, and is by what follows the temperature in its place.
        let price = |family, change: &Hypothesis| {
            let needs_lag = is_own && temperature_s != 0.0 && change.law() == Some(TimeFunction::Temperature);
            (prices.of)(family, change) + if needs_lag { LAG_CHI2 } else { 0.0 }
        };
        let prices = &Penalties { found: prices.found, of: &price };
        let mut others = state.clone();
        others.held.remove(index);
        others.set_temperature_lag(temperature_s);
        let normal = case.normal(&mut others);
        // As the model runs it: of what is not linear the signature tells only the last step.
        let fall = normal.chi2() - achieved;
        let late = (temperature_s != 0.0).then(|| bank.late(temperature_s));
        let mut rivals = in_place_of(case, late.as_ref().unwrap_or(bank), &normal, state, index, fall, prices);
        let (found, own) = (&state.held[index], Signature::new(&normal, &case.signature(state, index)));
        let near = |rival: &&mut Alternative| {
            let is_another_course = rival.hypothesis.amplitude.constant() == found.hypothesis.amplitude.constant();
            is_another_course && rival.behind_chi2 > APART_CHI2 && rival.behind_chi2 < rival.reach_chi2
        };
        let near: Vec<&mut Alternative> = rivals.iter_mut().filter(near).take(FITTED).collect();
        near.into_par_iter().for_each(|rival| {
            let mut instead = others.clone();
            instead.held.insert(index, in_the_form_of(found, &rival.hypothesis));
            let behind = case.fit(&mut instead).squares() - achieved;
            let hypothesis = instead.held[index].hypothesis.clone();
            let behind_chi2 = (behind - dearer(prices, rival.family, &hypothesis)).max(0.0);
            if behind.is_finite() && behind_chi2 < rival.behind_chi2 && hypothesis.is_within_limits() {
                let signature = Signature::new(&normal, &case.signature(&instead, index));
                *rival =
                    Alternative { hypothesis, behind_chi2, cosine: own.cosine(&normal, &signature), ..rival.clone() };
            }
        });
        rivals
    };
    let late_s = state.shifts.temperature_s;
    let mut rivals = beside(late_s);
    if late_s != 0.0 && is_own {
        rivals.extend(beside(0.0));
    }
    if matches!(state.held[index].hypothesis.law(), Some(TimeFunction::Periodic { .. })) {
        rivals.extend(late_temperature(case, bank, state, index, achieved, prices));
    }
    best_of_each(rivals)
}

/// In the place of a wave: what follows a temperature that is told late.
fn late_temperature(
    case: &DiagnosisCase,
    bank: &SignatureBank,
    state: &ModelState,
    index: usize,
    achieved: f64,
    prices: &Penalties,
) -> Option<Alternative> {
    let is_accepted =
        |late: &LaggedFit| late.state.held[index].hypothesis.is_within_limits() && late.normal.squares().is_finite();
    let late = late::likeliest(case, bank, state, index, prices.of, &is_accepted)?;
    let hypothesis = late.state.held[index].hypothesis.clone();
    let (family, _) = following_temperature(hypothesis.amplitude)?;
    let normal = case.normal_without(state, index);
    let [own, other] = [state, &late.state].map(|state| Signature::new(&normal, &case.signature(state, index)));
    let dearer = prices.found - late.held().penalty - late.lag_chi2;
    let behind_chi2 = (late.normal.squares() - achieved - dearer.max(0.0)).max(0.0);
    Some(Alternative { hypothesis, family, cosine: own.cosine(&normal, &other), reach_chi2: 0.0, behind_chi2 })
}

/// Another course of what was found, with those of its shapes free that are free there.
fn in_the_form_of(found: &FittedHypothesis, change: &Hypothesis) -> FittedHypothesis {
    let mut held = FittedHypothesis::new(change.clone());
    (1..=change.own_shapes.len()).filter(|&shape| found.is_free[shape]).for_each(|shape| held.free(shape));
    held
}

fn dearer(prices: &Penalties, family: HypothesisFamily, rival: &Hypothesis) -> f64 {
    (prices.found - (prices.of)(family, rival)).max(0.0)
}

/// The rivals where the data are nothing but what the change adds: what looks most like it.
pub fn similar_hypotheses(
    case: &DiagnosisCase,
    bank: &SignatureBank,
    state: &ModelState,
    index: usize,
) -> Vec<Alternative> {
    let mut others = state.clone();
    let held = others.held.remove(index);
    let (_, columns) = case.linearised(&mut others);
    let whole: Series = case.signature(state, index).map(|own| match own {
        Some(values) => values.iter().map(|value| value * held.hypothesis.value).collect(),
        None => vec![0.0; case.measured.block_count()],
    });
    let normal = NormalEquations::new(case.whitenings(&state.noise), &whole, &columns);
    // Nothing but nuisances is left of it.
    let fall = normal.chi2();
    let prices = Penalties { found: 0.0, of: &|_, _| 0.0 };
    in_place_of(case, bank, &normal, state, index, fall, &prices)
}

/// The rivals on what `normal` has to explain, of which the change makes χ² fall by `fall`.
fn in_place_of(
    case: &DiagnosisCase,
    bank: &SignatureBank,
    normal: &NormalEquations,
    state: &ModelState,
    index: usize,
    fall: f64,
    prices: &Penalties,
) -> Vec<Alternative> {
    let own = Signature::new(normal, &case.signature(state, index));
    let held = &state.held[index].hypothesis;
    let of_base = |index: usize| {
        let sets = sets(&bank.bases[index], &held.gyros);
        let is_another = |spot: &Spot| spot.amplitude(bank) != held.amplitude || spot.gyros != held.gyros;
        spots(bank, normal, index, |_| sets.clone(), |spot| is_another(spot) && spot.stands(bank))
    };
    let mut spots: Vec<Spot> = (0..bank.bases.len()).into_par_iter().flat_map_iter(of_base).collect();
    spots.retain(|spot| spot.gain.chi2 >= LEAST_SHARE * fall);
    spots.sort_by(|one, other| other.gain.chi2.total_cmp(&one.gain.chi2));
    let in_group = spots.iter().take_while(|spot| fall - spot.gain.chi2 < APART_CHI2).count();
    spots.truncate(in_group.clamp(CLIMBED, MOST));
    let told = |(place, spot): (usize, &Spot)| -> Option<Alternative> {
        let mut best = spot.with(bank, normal, &spot.variation).filter(|spot| spot.stands(bank))?;
        if place < CLIMBED {
            best = spot.climbed(bank, normal, |spot| spot.stands(bank)).unwrap_or(best);
        }
        let cosine = own.cosine(normal, &best.signature(bank, normal));
        let (hypothesis, family) = (best.hypothesis(bank), best.family(bank));
        let behind_chi2 = (fall - best.gain.chi2 - dearer(prices, family, &hypothesis)).max(0.0);
        let reach_chi2 = match bank.bases[best.base].is_linear {
            true if hypothesis.parameters().len() > 1 => NEAR_CHI2,
            true => 0.0,
            false => f64::INFINITY,
        };
        hypothesis.is_within_limits().then_some(Alternative { hypothesis, family, cosine, reach_chi2, behind_chi2 })
    };
    best_of_each(spots.par_iter().enumerate().filter_map(told).collect())
}

/// The best of each code and set of gyros, in order.
fn best_of_each(all: Vec<Alternative>) -> Vec<Alternative> {
    let mut rivals: Vec<Alternative> = Vec::new();
    for rival in all {
        let is_same = |other: &Alternative| {
            other.hypothesis.amplitude == rival.hypothesis.amplitude && other.hypothesis.gyros == rival.hypothesis.gyros
        };
        match rivals.iter().position(is_same) {
            Some(place) if rivals[place].behind_chi2 > rival.behind_chi2 => rivals[place] = rival,
            Some(_) => {}
            None => rivals.push(rival),
        }
    }
    let first = |rival: &Alternative| (rival.behind_chi2, -rival.cosine);
    rivals.sort_by(|one, other| first(one).partial_cmp(&first(other)).unwrap_or(std::cmp::Ordering::Equal));
    rivals
}

/// Sets of gyros on which a rival is looked for: each alone, all, and those of what was found.
fn sets(base: &ConstantSignature, found: &Gyros) -> Vec<Gyros> {
    if base.amplitude.is_of_unit() {
        return vec![ALL_GYROS];
    }
    let mut sets: Vec<Gyros> = (0..TIMING).map(only).chain([ALL_GYROS, *found]).collect();
    sets.retain(|set| is_within(set, &base.amplitude.gyros()));
    sets.sort_unstable();
    sets.dedup();
    sets
}
