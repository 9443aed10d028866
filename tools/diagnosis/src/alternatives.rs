//! Alternatives: for each hypothesis, every other one in its place, beside the nuisances and all other hypotheses.
//!
//! An alternative that explains the data nearly as well is not distinguishable by them: both belong to one ambiguity group. The whitened
//! cosine of the signatures gives their similarity on this motion.

use std::collections::HashSet;

use geu_model::parameter_spec::{ParameterSpec, Role};
use rayon::prelude::*;

use crate::diagnosis_case::DiagnosisCase;
use crate::fitted_hypothesis::FittedHypothesis;
use crate::measured::{CHANNELS, Series};
use crate::model_state::ModelState;
use crate::normal_equations::NormalEquations;
use crate::shape_search::LENGTHS;
use crate::signature::Signature;
use crate::signature_bank::{ConstantSignature, HypothesisFamily, SignatureBank, Variation};
use crate::significance::{FOUR_SIGMA_CHI2, THREE_SIGMA_CHI2};
use crate::spots::{Spot, spots};
use crate::temperature_lag::{LaggedFit, likeliest};
use geu_hypothesis::Hypothesis;
use geu_protocol::Gyros;

/// Minimum share of the χ² reduction of the hypothesis, and minimum square of the cosine of both: what is not similar explains something
/// else, which no hypothesis of the model explains yet.
const MIN_SHARE: f64 = 0.09;
/// Alternatives with optimised shape parameters.
const OPTIMISED: usize = 24;
/// Maximum number of alternatives.
const MAX_ALTERNATIVES: usize = 64;
/// Maximum number of formulas among them: many agree on one motion.
const FORMULAS: usize = 3;
/// Difference of χ² below which hypotheses are not distinguishable, four sigma: the hypothesis found is the best of many similar ones.
/// With three sigma, noise excluded the true one in 2 of 222 recordings with one effect (docs/diagnosis.md).
pub const AMBIGUITY_CHI2: f64 = FOUR_SIGMA_CHI2;
/// Difference of χ² below which another hypothesis with shape parameters or a nonlinear amplitude is fitted by the model before it is
/// excluded: signatures have them on a grid only. Time courses of the same nonlinear amplitude on the same gyros are fitted at any
/// difference.
const NEAR_CHI2: f64 = 30.0;
/// Maximum number of other fits.
const FITTED: usize = 6;

/// A hypothesis in place of another.
#[derive(Debug, Clone, PartialEq)]
pub struct Alternative {
    /// The hypothesis.
    pub hypothesis: Hypothesis,
    /// Family.
    pub family: HypothesisFamily,
    /// Absolute cosine of the two whitened signatures without their projections on the nuisances.
    pub cosine: f64,
    /// Difference of χ² up to which the model fits it.
    reach_chi2: f64,
    /// χ² above that of the original hypothesis, less the difference of their penalties; 0 or more.
    pub delta_chi2: f64,
}

/// Penalties of hypotheses. An alternative with a lower penalty may have a higher χ² by the difference.
pub struct Penalties<'a> {
    /// Penalty of the original hypothesis.
    pub found: f64,
    /// Penalty of any hypothesis.
    pub of: &'a (dyn Fn(HypothesisFamily, &Hypothesis) -> f64 + Sync),
}

/// χ² above that of the original hypothesis, less what the penalty of the original is higher by; 0 or more.
fn delta(chi2: f64, penalty_difference: f64) -> f64 {
    (chi2 - penalty_difference.max(0.0)).max(0.0)
}

/// Alternatives to the hypothesis at `index` of a state, best first.
pub fn alternatives(
    case: &DiagnosisCase,
    bank: &SignatureBank,
    state: &ModelState,
    index: usize,
    penalties: &Penalties,
) -> Vec<Alternative> {
    let achieved = case.normal(&mut state.clone()).chi2();
    let late_s = state.shifts.temperature_s;
    let found = &state.held[index];
    // If only this hypothesis follows the temperature, the lag is part of it.
    let owns_lag = late_s != 0.0
        && found.follows_temperature()
        && state.held.iter().filter(|held| held.follows_temperature()).count() == 1;
    let at_lag = |temperature_s: f64| -> Vec<Alternative> {
        // An alternative that follows the lagged temperature has the penalty of the lag too.
        let penalty = |family, own: &Hypothesis| {
            let needs_lag = owns_lag && temperature_s != 0.0 && own.follows_temperature();
            (penalties.of)(family, own) + if needs_lag { THREE_SIGMA_CHI2 } else { 0.0 }
        };
        let penalties = &Penalties { found: penalties.found, of: &penalty };
        let mut others = state.clone();
        others.held.remove(index);
        others.set_temperature_lag(temperature_s);
        let normal = case.normal(&mut others);
        // χ² reduction of the model run: the signature of a nonlinear amplitude holds only near its value.
        let fall = normal.chi2() - achieved;
        let mut all = in_place_of(case, &bank.late(temperature_s), &normal, state, index, fall, penalties);
        let own = Signature::new(&normal, &case.signature(state, index));
        let is_near =
            |other: &&mut Alternative| other.delta_chi2 > AMBIGUITY_CHI2 && other.delta_chi2 < other.reach_chi2;
        let (always, near): (Vec<_>, Vec<_>) =
            all.iter_mut().filter(is_near).partition(|other| other.reach_chi2 == f64::INFINITY);
        let tried = always.into_iter().chain(near.into_iter().take(FITTED)).collect::<Vec<_>>();
        tried.into_par_iter().for_each(|other| {
            let is_same = other.hypothesis.amplitude.constant() == found.hypothesis.amplitude.constant();
            let fitted = |start: Hypothesis| -> Option<Alternative> {
                // With the same shape parameters fitted.
                let mut held = FittedHypothesis::new(start);
                let own_shapes = held.hypothesis.own_shapes.len();
                (1..=own_shapes).filter(|&shape| is_same && found.is_free[shape]).for_each(|shape| held.free(shape));
                let mut instead = others.clone();
                instead.held.insert(index, held);
                let chi2 = case.fit(&mut instead).squares() - achieved;
                let hypothesis = instead.held[index].hypothesis.clone();
                let delta_chi2 = delta(chi2, penalties.found - penalty(other.family, &hypothesis));
                let cosine = own.cosine(&normal, &Signature::new(&normal, &case.signature(&instead, index)));
                let is_possible = chi2.is_finite() && hypothesis.is_within_limits();
                is_possible.then(|| Alternative { hypothesis, delta_chi2, cosine, ..other.clone() })
            };
            let duration_s = case.measured.duration_s();
            let squares = |start: &Hypothesis| {
                let mut instead = others.clone();
                instead.held.insert(index, FittedHypothesis::fixed(start.clone()));
                case.normal(&mut instead).squares()
            };
            let from_onset =
                if is_same { with_its_onset(&found.hypothesis, &other.hypothesis, duration_s) } else { Vec::new() };
            let likeliest = from_onset.into_iter().map(|start| (squares(&start), start));
            let likeliest = likeliest.min_by(|one, two| one.0.total_cmp(&two.0)).map(|(_, start)| start);
            let starts = [Some(other.hypothesis.clone()), likeliest].into_iter().flatten();
            if let Some(best) = starts.filter_map(fitted).min_by(|one, two| one.delta_chi2.total_cmp(&two.delta_chi2))
                && best.delta_chi2 < other.delta_chi2
            {
                *other = best;
            }
        });
        all
    };
    let mut all = at_lag(late_s);
    if owns_lag {
        all.extend(at_lag(0.0));
    }
    if found.hypothesis.profile().is_some_and(|profile| profile.is_periodic()) {
        all.extend(lagged_temperature(case, bank, state, index, achieved, penalties));
    }
    best_of_each(all)
}

/// An effect with another time course from its onset on, which hardly ends or decays before the end of a recording, or after halves of the
/// rest; none if either has no onset.
fn with_its_onset(found: &Hypothesis, other: &Hypothesis, duration_s: f64) -> Vec<Hypothesis> {
    let Hypothesis { amplitude, gyros, .. } = *other;
    let shapes = found.amplitude.course_shapes().iter().zip(&found.course_shapes);
    let Some((_, &onset_s)) = shapes.into_iter().find(|(number, _)| number.role == Role::Onset) else {
        return Vec::new();
    };
    let with_length = |halvings: i32| {
        let shape = |number: &ParameterSpec| match number.role {
            Role::Onset => Some(onset_s),
            Role::Duration | Role::TimeConstant => Some((duration_s - onset_s) * 0.5f64.powi(halvings)),
            _ => None,
        };
        let course_shapes: Vec<f64> = amplitude.course_shapes().iter().map(shape).collect::<Option<_>>()?;
        (!course_shapes.is_empty()).then(|| Hypothesis { amplitude, gyros, course_shapes, ..found.clone() })
    };
    let is_length = |number: &ParameterSpec| matches!(number.role, Role::Duration | Role::TimeConstant);
    let has_length = amplitude.course_shapes().iter().any(is_length);
    (0..if has_length { LENGTHS } else { 1 }).filter_map(with_length).collect()
}

/// The alternative to a wave that follows a lagged temperature.
fn lagged_temperature(
    case: &DiagnosisCase,
    bank: &SignatureBank,
    state: &ModelState,
    index: usize,
    achieved: f64,
    penalties: &Penalties,
) -> Option<Alternative> {
    let is_accepted = |late: &LaggedFit| late.held().hypothesis.is_within_limits() && late.normal.squares().is_finite();
    let late = likeliest(case, bank, state, index, penalties.of, &is_accepted)?;
    let hypothesis = late.held().hypothesis.clone();
    let family = HypothesisFamily::of_kind(hypothesis.amplitude.kind?);
    let normal = case.normal_without(state, index);
    let [own, other] = [state, &late.state].map(|state| Signature::new(&normal, &case.signature(state, index)));
    let penalty_difference = penalties.found - late.held().penalty - late.lag_chi2;
    let delta_chi2 = delta(late.normal.squares() - achieved, penalty_difference);
    Some(Alternative { hypothesis, family, cosine: own.cosine(&normal, &other), reach_chi2: 0.0, delta_chi2 })
}

/// Alternatives on data that contain only the hypothesis at `index`: those with the most similar signatures.
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
    let normal = NormalEquations::new(case.whitenings(&state.noise), &whole, &columns, &case.a_priori(&[]));
    in_place_of(case, bank, &normal, state, index, normal.chi2(), &Penalties { found: 0.0, of: &|_, _| 0.0 })
}

/// Alternatives on the residual of `normal`, of which the hypothesis at `index` reduces χ² by `fall`.
fn in_place_of(
    case: &DiagnosisCase,
    bank: &SignatureBank,
    normal: &NormalEquations,
    state: &ModelState,
    index: usize,
    fall: f64,
    penalties: &Penalties,
) -> Vec<Alternative> {
    let own = Signature::new(normal, &case.signature(state, index));
    let held = &state.held[index].hypothesis;
    let mut others = state.clone();
    others.held.remove(index);
    // Shape parameters of others are linear near their values only.
    let has_shapes = others.held.iter().any(|other| other.is_free.iter().skip(1).any(|is_free| *is_free));
    let is_possible = |spot: &Spot| {
        spot.is_valid(bank) && spot.is_physical(bank, &others) && spot.hypothesis(bank).is_within_limits()
    };
    let of_base = |index: usize| {
        let sets = sets(&bank.bases[index], &held.gyros);
        let is_another = |spot: &Spot| spot.amplitude(bank) != held.amplitude || spot.gyros != held.gyros;
        let is_possible = |spot: &Spot| is_another(spot) && is_possible(spot);
        let at_found = |(kind, gyros): (usize, &Gyros)| {
            let found = Variation::Course { kind, shapes: held.course_shapes.clone() };
            Spot::fit(bank, normal, index, found, *gyros).filter(is_possible)
        };
        // Where the unit turns between the onsets of the grid, another amplitude is similar at the found onset only.
        let kind = held.amplitude.kind.filter(|_| bank.bases[index].has_courses);
        let found = kind.into_iter().flat_map(|kind| sets.iter().map(move |gyros| (kind, gyros))).filter_map(at_found);
        let of_grid = spots(bank, normal, index, [true; CHANNELS], |_| sets.clone(), is_possible);
        found.chain(of_grid).collect::<Vec<_>>()
    };
    let mut spots: Vec<Spot> = (0..bank.bases.len()).into_par_iter().flat_map_iter(of_base).collect();
    spots.retain(|spot| spot.gain.chi2 >= MIN_SHARE * fall);
    spots.sort_by(|one, other| other.gain.chi2.total_cmp(&one.gain.chi2));
    let (mut formulas, mut seen) = (0, HashSet::new());
    // Best first: the grid's or the found course, whichever is better.
    spots.retain(|spot| seen.insert((spot.base, spot.variation.kind(), spot.gyros)));
    spots.retain(|spot| {
        let is_formula = spot.amplitude(bank).formula().is_some();
        formulas += usize::from(is_formula);
        !is_formula || formulas <= FORMULAS
    });
    let in_group = spots.iter().take_while(|spot| fall - spot.gain.chi2 < AMBIGUITY_CHI2).count();
    let is_course = |spot: &Spot| {
        let base = &bank.bases[spot.base];
        !base.is_linear && base.amplitude == held.amplitude.constant() && spot.gyros == held.gyros
    };
    let (first, others) = spots.split_at(spots.len().min(in_group.clamp(OPTIMISED, MAX_ALTERNATIVES)));
    let spots: Vec<&Spot> = first.iter().chain(others.iter().filter(|spot| is_course(spot))).collect();
    let parameters = held.parameters();
    let onset_s: Vec<f64> = parameters.iter().filter(|own| own.role == Role::Onset).map(|own| own.value).collect();
    let alternative = |(place, spot): (usize, &&Spot)| -> Option<Alternative> {
        let mut best = Spot::fit(bank, normal, spot.base, spot.variation.clone(), spot.gyros).filter(is_possible)?;
        if place < OPTIMISED {
            best = spot.optimised(bank, normal, &onset_s, is_possible).unwrap_or(best);
        }
        let cosine = own.cosine(normal, &best.signature(bank, normal));
        let (hypothesis, family) = (best.hypothesis(bank), best.family(bank));
        let delta_chi2 = delta(fall - best.gain.chi2, penalties.found - (penalties.of)(family, &hypothesis));
        let reach_chi2 = match bank.bases[best.base].is_linear {
            true if has_shapes || hypothesis.parameters().len() > 1 => NEAR_CHI2,
            true => 0.0,
            false if is_course(&best) => f64::INFINITY,
            false => NEAR_CHI2,
        };
        let is_similar = cosine * cosine >= MIN_SHARE;
        (is_similar && hypothesis.is_within_limits()).then_some(Alternative {
            hypothesis,
            family,
            cosine,
            reach_chi2,
            delta_chi2,
        })
    };
    best_of_each(spots.par_iter().enumerate().filter_map(alternative).collect())
}

/// The best alternative of each amplitude and set of gyros, sorted.
fn best_of_each(all: Vec<Alternative>) -> Vec<Alternative> {
    let mut best: Vec<Alternative> = Vec::new();
    for other in all {
        let is_same = |best: &&mut Alternative| {
            (best.hypothesis.amplitude, best.hypothesis.gyros) == (other.hypothesis.amplitude, other.hypothesis.gyros)
        };
        match best.iter_mut().find(is_same) {
            Some(best) if best.delta_chi2 > other.delta_chi2 => *best = other,
            Some(_) => {}
            None => best.push(other),
        }
    }
    let key = |own: &Alternative| (own.delta_chi2, -own.cosine);
    best.sort_by(|one, other| key(one).partial_cmp(&key(other)).unwrap_or(std::cmp::Ordering::Equal));
    best
}

/// Sets of gyros of alternatives: each gyro, all, and the set of the hypothesis.
fn sets(base: &ConstantSignature, found: &Gyros) -> Vec<Gyros> {
    if base.amplitude.is_of_unit() {
        return vec![found.unit()];
    }
    let mut sets: Vec<Gyros> = (0..found.heads()).map(|gyro| found.only(gyro)).chain([found.unit(), *found]).collect();
    sets.retain(|set| set.is_within(&base.gyros));
    sets.sort_unstable();
    sets.dedup();
    sets
}
