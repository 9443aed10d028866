//! A temperature that is told late: what follows it in the place of another course, with the lag that suits best.
//!
//! How late is looked for with signatures, which shift for nothing; the model is run where these say that it is.

use geu_model::course::{KINDS, TimeFunction};
use rayon::prelude::*;

use crate::amplitude::AmplitudeRef;
use crate::bank::{ConstantSignature, HypothesisFamily, SignatureBank, Variation};
use crate::gyros::Gyros;
use crate::hypothesis::Hypothesis;
use crate::normal::{NormalEquations, Products, SignatureFit};
use crate::signature::Signature;
use crate::state::{DiagnosisCase, FittedHypothesis, ModelState};

/// How late a temperature may be told, s; early where a part of the electronics is warm only after the sensor.
const LATE_S: [f64; 9] = [-300.0, 0.0, 150.0, 300.0, 450.0, 600.0, 900.0, 1200.0, 1800.0];
/// Steps in which the best of them is bettered, s: from half of the widest gap on.
const NEARER_S: [f64; 4] = [150.0, 75.0, 40.0, 20.0];
/// What a lag must lower χ² by, three sigma.
pub const LAG_CHI2: f64 = 9.0;
/// What explains less than this share of what the change does, by its signature, is not fitted.
const HOPE: f64 = 0.5;

/// What follows the temperature, fitted in the place of a change.
pub struct LaggedFit {
    /// Everything held, with it.
    pub state: ModelState,
    /// The equations of that.
    pub normal: NormalEquations,
    /// What is paid for the lag, where there was none.
    pub lag_chi2: f64,
    /// Index of it.
    index: usize,
}

impl LaggedFit {
    /// It, with what is paid for its family and gyros.
    pub fn held(&self) -> &FittedHypothesis {
        &self.state.held[self.index]
    }

    /// What is left, and what is paid.
    pub fn score(&self) -> f64 {
        self.normal.squares() + self.held().penalty + self.lag_chi2
    }
}

/// The family of what follows the temperature, and the amplitude with that course.
pub fn following_temperature(amplitude: AmplitudeRef) -> Option<(HypothesisFamily, AmplitudeRef)> {
    let kind = kind()?;
    Some((HypothesisFamily::of_kind(kind), amplitude.with(kind)?))
}

/// The course that follows the temperature, of [`KINDS`].
fn kind() -> Option<usize> {
    KINDS.iter().position(|kind| kind.shapes.is_empty() && kind.law(&[]) == TimeFunction::Temperature)
}

/// What is paid for the lag of a state, one for all that follows the temperature.
pub fn lag_chi2(state: &ModelState) -> f64 {
    if state.shifts.temperature_s == 0.0 { 0.0 } else { LAG_CHI2 }
}

/// Puts what follows the temperature in the place of the change at `index`, with the lag that suits best of those that are accepted;
/// `price` is what a change of a family costs. Nothing where the amplitude has no such course, where that explains much less, or where
/// it is held already.
pub fn likeliest(
    case: &DiagnosisCase,
    bank: &SignatureBank,
    state: &ModelState,
    index: usize,
    price: &(dyn Fn(HypothesisFamily, &Hypothesis) -> f64 + Sync),
    is_accepted: &(dyn Fn(&LaggedFit) -> bool + Sync),
) -> Option<LaggedFit> {
    let found = &state.held[index].hypothesis;
    let (family, amplitude) = following_temperature(found.amplitude)?;
    let is_held = |(other, held): (usize, &FittedHypothesis)| {
        let shares = held.hypothesis.gyros.iter().zip(found.gyros).any(|(one, other)| *one && other);
        other != index && held.hypothesis.amplitude == amplitude && shares
    };
    if state.held.iter().enumerate().any(is_held) {
        return None;
    }
    let others = case.normal_without(state, index);
    let spot = spot(bank, &others, found)?;
    if spot.gain.chi2 < HOPE * (others.chi2() - case.normal(&mut state.clone()).chi2()) {
        return None;
    }
    let size = if spot.base.is_linear { spot.gain.size } else { spot.base.size };
    let change = Hypothesis { amplitude, value: size, course_shapes: Vec::new(), ..found.clone() };
    let fitted = |late_s: f64| {
        let mut own = state.clone();
        let held_out = others.held_out(&spot.products(bank, &others, late_s, &change.gyros));
        let penalty = price(family, &change);
        own.held[index] = FittedHypothesis::new(change.clone()).accepted(penalty, held_out);
        own.set_temperature_lag(late_s);
        let normal = case.fit(&mut own);
        let lag_chi2 = lag_chi2(&own) - lag_chi2(state);
        let late = LaggedFit { state: own, normal, lag_chi2, index };
        is_accepted(&late).then_some(late)
    };
    let mut all_s = vec![spot.late_s, state.shifts.temperature_s, 0.0];
    all_s.sort_by(f64::total_cmp);
    all_s.dedup();
    best_of(&all_s, fitted, LaggedFit::score)
}

/// What follows the temperature in the place of a change, by signatures.
struct Spot<'a> {
    base: &'a ConstantSignature,
    variation: Variation,
    late_s: f64,
    gain: SignatureFit,
}

impl Spot<'_> {
    /// Its products where the temperature is told so much later than it was.
    fn products(&self, bank: &SignatureBank, normal: &NormalEquations, late_s: f64, gyros: &Gyros) -> Products {
        Signature::of(&bank.late(late_s), normal, self.base, &self.variation, gyros).products
    }
}

/// Where signatures explain most.
fn spot<'a>(bank: &'a SignatureBank, normal: &NormalEquations, found: &Hypothesis) -> Option<Spot<'a>> {
    let variation = Variation::Course { kind: kind()?, shapes: Vec::new() };
    let constant = found.amplitude.constant();
    let bases: Vec<&ConstantSignature> = bank.bases.iter().filter(|base| base.amplitude == constant).collect();
    let at = |late_s: f64| {
        let late = bank.late(late_s);
        let spots = bases.iter().filter_map(|&base| {
            let gain = normal.gain(&Signature::of(&late, normal, base, &variation, &found.gyros).products)?;
            base.is_valid_at(gain.size).then(|| Spot { base, variation: variation.clone(), late_s, gain })
        });
        spots.max_by(|one, other| one.gain.chi2.total_cmp(&other.gain.chi2))
    };
    let score = |spot: &Spot| -spot.gain.chi2;
    let mut best = best_of(&LATE_S, at, score)?;
    for step_s in NEARER_S {
        let near = [best.late_s - step_s, best.late_s + step_s];
        let near = near.map(|late_s| late_s.clamp(LATE_S[0], LATE_S[LATE_S.len() - 1]));
        if let Some(nearer) = best_of(&near, at, score).filter(|nearer| score(nearer) < score(&best)) {
            best = nearer;
        }
    }
    Some(best)
}

/// The lag with the least score.
fn best_of<T: Send>(all_s: &[f64], at: impl Fn(f64) -> Option<T> + Sync, score: impl Fn(&T) -> f64) -> Option<T> {
    let tried: Vec<T> = all_s.par_iter().filter_map(|late_s| at(*late_s)).collect();
    tried.into_iter().min_by(|one, other| score(one).total_cmp(&score(other)))
}
