//! Temperature lag: an effect that follows a delayed temperature in place of another time course, with the likeliest delay.
//!
//! Signatures, which the delay changes without a model run, select the delay; the model runs only with the best one.

use geu_model::time_profile::COURSES;
use rayon::prelude::*;

use crate::diagnosis_case::DiagnosisCase;
use crate::fitted_hypothesis::FittedHypothesis;
use crate::model_state::ModelState;
use crate::normal_equations::NormalEquations;
use crate::signature_bank::{HypothesisFamily, SignatureBank, Variation};
use crate::significance::THREE_SIGMA_CHI2;
use crate::spots::Spot;
use geu_hypothesis::Hypothesis;
use geu_hypothesis::amplitude::AmplitudeRef;

/// Grid of delays, s; negative if a part of the electronics warms up after the sensor.
const GRID_S: [f64; 9] = [-300.0, 0.0, 150.0, 300.0, 450.0, 600.0, 900.0, 1200.0, 1800.0];
/// Steps of the refinement, s, from half of the largest spacing.
const STEPS_S: [f64; 4] = [150.0, 75.0, 40.0, 20.0];
/// A signature is not fitted if it explains less than this share of the hypothesis that it replaces.
const MIN_SHARE: f64 = 0.5;

/// Fit of an effect that follows the temperature in place of a hypothesis.
pub struct LaggedFit {
    /// All hypotheses, with it.
    pub state: ModelState,
    /// Normal equations.
    pub normal: NormalEquations,
    /// Penalty of the lag if the state had none.
    pub lag_chi2: f64,
    index: usize,
}

impl LaggedFit {
    /// The hypothesis, with the penalty of its family and gyros.
    pub fn held(&self) -> &FittedHypothesis {
        &self.state.held[self.index]
    }

    /// χ² plus penalties.
    pub fn score(&self) -> f64 {
        self.normal.squares() + self.held().penalty + self.lag_chi2
    }
}

/// Index in [`COURSES`] of the time course that follows the temperature.
fn kind() -> Option<usize> {
    COURSES.iter().position(|course| course.follows_temperature)
}

/// Penalty of the lag of a state, common to all hypotheses that follow the temperature.
pub fn lag_chi2(state: &ModelState) -> f64 {
    if state.shifts.temperature_s == 0.0 { 0.0 } else { THREE_SIGMA_CHI2 }
}

/// Replaces the hypothesis at `index` by one that follows the temperature, with the likeliest of the accepted delays. `penalty` gives
/// the penalty of a family. `None` if the amplitude has no such time course, if it explains much less, or if the state has it already.
pub fn likeliest(
    case: &DiagnosisCase,
    bank: &SignatureBank,
    state: &ModelState,
    index: usize,
    penalty: &(dyn Fn(HypothesisFamily, &Hypothesis) -> f64 + Sync),
    is_accepted: &(dyn Fn(&LaggedFit) -> bool + Sync),
) -> Option<LaggedFit> {
    let found = &state.held[index].hypothesis;
    let kind = kind()?;
    let (family, amplitude) = (HypothesisFamily::of_kind(kind), found.amplitude.with(kind)?);
    if state
        .held
        .iter()
        .enumerate()
        .any(|(other, held)| other != index && held.hypothesis.conflicts(amplitude, &found.gyros))
    {
        return None;
    }
    let others = case.normal_without(state, index);
    let mut without = state.clone();
    without.held.remove(index);
    let is_possible = |spot: &Spot| spot.is_valid(bank) && spot.is_physical(bank, &without);
    let (late_s, spot) = best_signature(bank, &others, found, kind, is_possible)?;
    if spot.gain.chi2 < MIN_SHARE * (others.chi2() - case.normal(&mut state.clone()).chi2()) {
        return None;
    }
    let value = spot.hypothesis(bank).value;
    let hypothesis = Hypothesis { amplitude, value, course_shapes: Vec::new(), ..found.clone() };
    let fitted = |late_s: f64| {
        let mut own = state.clone();
        own.held[index] = FittedHypothesis::new(hypothesis.clone()).with_penalty(penalty(family, &hypothesis));
        own.set_temperature_lag(late_s);
        let normal = case.fit(&mut own);
        own.held[index].held_out = case.cross_validate(&own, index);
        let lag_chi2 = lag_chi2(&own) - lag_chi2(state);
        let late = LaggedFit { state: own, normal, lag_chi2, index };
        is_accepted(&late).then_some(late)
    };
    let mut all_s = vec![late_s, state.shifts.temperature_s, 0.0];
    all_s.sort_by(f64::total_cmp);
    all_s.dedup();
    best_of(&all_s, fitted, LaggedFit::score)
}

/// Delay and signature of the best fit in place of a hypothesis.
fn best_signature(
    bank: &SignatureBank,
    normal: &NormalEquations,
    found: &Hypothesis,
    kind: usize,
    is_possible: impl Fn(&Spot) -> bool + Sync,
) -> Option<(f64, Spot)> {
    let constant: AmplitudeRef = found.amplitude.constant();
    let bases: Vec<usize> = (0..bank.bases.len()).filter(|&base| bank.bases[base].amplitude == constant).collect();
    let at = |late_s: f64| {
        let late = bank.late(late_s);
        let fit = |&base: &usize| {
            let variation = Variation::Course { kind, shapes: Vec::new() };
            Spot::fit(&late, normal, base, variation, found.gyros).filter(&is_possible)
        };
        let best = bases.iter().filter_map(fit).max_by(|one, other| one.gain.chi2.total_cmp(&other.gain.chi2))?;
        Some((late_s, best))
    };
    let score = |(_, spot): &(f64, Spot)| -spot.gain.chi2;
    let mut best = best_of(&GRID_S, at, score)?;
    for step_s in STEPS_S {
        let near = [best.0 - step_s, best.0 + step_s].map(|late_s| late_s.clamp(GRID_S[0], GRID_S[GRID_S.len() - 1]));
        if let Some(nearer) = best_of(&near, at, score).filter(|nearer| score(nearer) < score(&best)) {
            best = nearer;
        }
    }
    Some(best)
}

/// The result at the delay with the lowest score.
fn best_of<T: Send>(all_s: &[f64], at: impl Fn(f64) -> Option<T> + Sync, score: impl Fn(&T) -> f64) -> Option<T> {
    let tried: Vec<T> = all_s.par_iter().filter_map(|late_s| at(*late_s)).collect();
    tried.into_iter().min_by(|one, other| score(one).total_cmp(&score(other)))
}
