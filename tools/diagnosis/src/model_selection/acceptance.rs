//! Acceptance of a selection: formulas, overfitted gyros, rejected and superfluous hypotheses.

use geu_model::Configuration;
use geu_model::parameter_spec::Role;
use rayon::prelude::*;

use crate::diagnosis_case::DiagnosisCase;
use crate::fitted_hypothesis::FittedHypothesis;
use crate::measured::TIMING;
use crate::model_state::ModelState;
use crate::noise::Walk;
use crate::normal_equations::NormalEquations;
use crate::null_distribution::Thresholds;
use crate::residual_map::{CALIBRATED, SIGNIFICANT, residual_maps};
use crate::search::{Candidate, passes_cross_validation, search};
use crate::signature_bank::SignatureBank;
use crate::significance::{THREE_SIGMA_CHI2, THREE_SIGMAS};
use geu_hypothesis::Hypothesis;
use geu_protocol::Gyros;

use super::noise::{drift_noise_fall, unstated_flicker_fall};
use super::selected::{FEW_SAMPLES, MAX_PER_GYRO, RejectedHypothesis, SelectedModel};

/// A smaller share of the whole χ² reduction may be an error of the other hypotheses: a signature with a cosine of 0.995 to the true
/// one leaves as much.
const NEGLIGIBLE: f64 = 0.01;

/// A χ² reduction that is negligible against that of all hypotheses and the lag, with calibration parameters fitted in any case.
pub(super) fn negligible(case: &DiagnosisCase, state: &ModelState, normal: &NormalEquations) -> f64 {
    let calibration = &case.nuisances[..case.nuisances.len() - 1];
    let start = case.residual(&case.start(state.noise));
    let without = NormalEquations::new(case.whitenings(&state.noise), &start, calibration, &case.a_priori(&[]));
    NEGLIGIBLE * (without.chi2() - normal.chi2())
}

/// True for a drift, in proportion to a temperature or not.
fn is_drift(hypothesis: &Hypothesis) -> bool {
    hypothesis.amplitude.constant().number().unit.starts_with("arcsec/h")
}

impl SelectedModel {
    /// True if a formula might be better: beside the hypotheses, in place of one of them, or if there are several on a gyro or noise.
    pub fn is_doubtful(&self, case: &DiagnosisCase, formulas: &SignatureBank, thresholds: &Thresholds) -> bool {
        let held = &self.state.held;
        let has_several = |gyro: usize| held.iter().filter(|held| held.hypothesis.gyros[gyro]).count() > 1;
        if self.is_noisy() || (0..TIMING).any(has_several) {
            return true;
        }
        let margin = |state: &ModelState, normal: &NormalEquations| {
            let candidates = search(formulas, normal, state, Some(thresholds));
            candidates.first().map(|best| best.gain.chi2 - thresholds.required(best.family))
        };
        margin(&self.state, &self.normal).is_some_and(|best| best > 0.0)
            || (0..held.len()).any(|index| {
                let (state, normal, chi2) = self.without(case, index);
                margin(&state, &normal).is_some_and(|best| best > chi2.fall - chi2.threshold)
            })
    }

    /// True if the drift of any of these gyros walks or flickers by more than configured.
    fn has_larger_drift_noise(&self, gyros: &Gyros) -> bool {
        self.noise.iter().any(|found| {
            let is_of_drift = matches!(found.walk, Walk::Rate | Walk::Flicker);
            is_of_drift && gyros[found.channel] && found.is_significant(&self.state)
        })
    }

    fn is_noisy(&self) -> bool {
        self.noise.iter().any(|found| found.is_significant(&self.state))
    }

    pub(super) fn negligible(&self, case: &DiagnosisCase) -> f64 {
        negligible(case, &self.state, &self.normal)
    }

    /// True if an effect on this channel withholds motions.
    pub(super) fn withholds(&self, channel: usize) -> bool {
        channel < TIMING && self.on(channel).any(|(_, held)| held.hypothesis.amplitude.filters_motion())
    }

    /// Cross-validates each hypothesis beside the others.
    pub fn cross_validate(&mut self, case: &DiagnosisCase) {
        let held_out = |index: usize| case.cross_validate(&self.state, index);
        let all: Vec<_> = (0..self.state.held.len()).into_par_iter().map(held_out).collect();
        self.state.held.iter_mut().zip(all).for_each(|(held, own)| held.held_out = own);
    }

    /// True if each hypothesis is predicted beside the others.
    pub(super) fn is_predicted(&mut self, case: &DiagnosisCase) -> bool {
        self.cross_validate(case);
        self.state.held.iter().all(|held| passes_cross_validation(&held.held_out))
    }

    /// True if a formula explains more than errors of the other hypotheses.
    pub fn requires_formula(&self, case: &DiagnosisCase) -> bool {
        let is_formula = |index: &usize| self.state.held[*index].hypothesis.amplitude.formula().is_some();
        let mut formulas = (0..self.state.held.len()).filter(is_formula);
        formulas.any(|index| self.chi2_fall(case, index).fall > self.negligible(case))
    }

    /// Gyros with a rejected hypothesis, or with hypotheses that explain anything and thus nothing: more than [`MAX_PER_GYRO`]; two beside
    /// larger noise; or two on this gyro alone, if one is a formula or not predicted by the other thirds. A hypothesis on several gyros has the
    /// evidence of the others.
    pub fn overfitted_gyros(&self, nominal: &Configuration) -> Gyros {
        nominal.device.all_gyros().filter(|gyro| {
            if self.rejected.is_some_and(|rejected| rejected.gyros[gyro]) {
                return true;
            }
            let count = self.on(gyro).count();
            let is_noisy = self.noise.iter().any(|found| found.channel == gyro && found.is_significant(&self.state));
            let alone = || {
                self.on(gyro)
                    .map(|(_, held)| held)
                    .filter(|held| held.hypothesis.gyros == held.hypothesis.gyros.only(gyro))
            };
            let is_doubtful = |held: &FittedHypothesis| {
                // Between two motions the amplitude of what settles and its time constant are one number.
                let parameters = held.hypothesis.parameters();
                let mut free = parameters.iter().zip(&held.is_free).filter(|(_, is_free)| **is_free);
                let settles = free.any(|(parameter, _)| parameter.role == Role::TimeConstant);
                held.hypothesis.amplitude.formula().is_some()
                    || held.held_out.iter().flatten().sum::<f64>() < THREE_SIGMA_CHI2
                    || !settles && held.hypothesis.value.abs() < THREE_SIGMAS * held.sigmas[0]
            };
            count > MAX_PER_GYRO || is_noisy && count > 1 || alone().count() > 1 && alone().any(is_doubtful)
        })
    }

    /// Gyros with another effect beside a nonlinear effect that withholds motions, such as a dead zone: the withheld motion may be
    /// described by another calibration and further effects as well.
    pub fn beside_nonlinear_filter(&self, bank: &SignatureBank) -> Gyros {
        let is_nonlinear = |held: &FittedHypothesis| {
            let amplitude = held.hypothesis.amplitude.constant();
            amplitude.filters_motion() && bank.bases.iter().any(|base| base.amplitude == amplitude && !base.is_linear)
        };
        let all = bank.gyros();
        all.filter(|gyro| self.on(gyro).count() > 1 && self.on(gyro).any(|(_, held)| is_nonlinear(held)))
    }

    /// Gyros of which the residual follows a variable of the residual map, which noise does not; by more than the errors of the hypotheses.
    /// The noise of the reference is in its rates: where the unit hardly turns, it looks like a calibration parameter beyond its limit.
    pub fn following_variables(&self, case: &DiagnosisCase) -> Gyros {
        let [map] = residual_maps(case, &self.state.noise, [&case.run(&self.state)], &[]);
        let limit = self.negligible(case).sqrt().max(SIGNIFICANT);
        let follows = |gyro: usize| map.whole[gyro][CALIBRATED..].iter().flatten().any(|sigmas| sigmas.abs() > limit);
        case.measured.gyros().filter(follows)
    }

    /// Rejects a candidate, beside those rejected on other gyros: the score with all of them, with the white noise fitted without. Where
    /// angles are dequantised, the signatures of small motions contain the rounding that the motion answers, so that a candidate that is
    /// not acceptable is no evidence.
    pub(super) fn reject(
        &mut self,
        case: &DiagnosisCase,
        bank: &SignatureBank,
        thresholds: &Thresholds,
        candidate: &Candidate,
    ) {
        let weights = &case.measured.weights;
        if (0..TIMING).any(|gyro| candidate.hypothesis.gyros[gyro] && weights[gyro].is_some()) {
            return;
        }
        let noise = self.fitted_white(case);
        let (residual, columns) = case.linearised(&mut self.state);
        let normal =
            NormalEquations::new(case.whitenings(&noise), &residual, &columns, &case.a_priori(&self.state.calibration));
        let gain = normal.gain(&candidate.spot.signature(bank, &normal).products).map_or(0.0, |gain| gain.chi2);
        let margin = gain - thresholds.penalty(candidate.family, &candidate.hypothesis);
        let before = self.rejected.unwrap_or_else(|| RejectedHypothesis {
            gyros: case.measured.gyros().with_mask(0),
            score: self.score_with(case, thresholds, &noise),
        });
        let gyros = before.gyros.and(candidate.hypothesis.gyros);
        self.rejected = Some(RejectedHypothesis { gyros, score: before.score - margin });
    }

    /// The score, and the rejected hypothesis only if it has a better one: walks may explain the same.
    pub(super) fn settled(mut self, case: &DiagnosisCase, thresholds: &Thresholds) -> (SelectedModel, f64) {
        let score = self.score(case, thresholds);
        self.rejected = self.rejected.filter(|rejected| rejected.score + THREE_SIGMA_CHI2 < score);
        let best = self.rejected.map_or(score, |rejected| rejected.score);
        (self, best)
    }

    /// Removes each hypothesis whose χ² reduction beside all others is less than its penalty, or without which the score is lower, each time
    /// with the white noise fitted again: noise fitted beside a hypothesis weights what it explains. With walks above their configured
    /// growth the penalty is too low: then a hypothesis must also be better than a walk or flicker in its place, and a drift beside a larger
    /// noise of the drift must exceed three thresholds. The drift of every gyro flickers: without stated noise a hypothesis must be better
    /// than that. Returns true if one was removed.
    pub fn prune(&mut self, case: &DiagnosisCase, thresholds: &Thresholds) -> bool {
        let is_noisy = self.is_noisy();
        let count = self.state.held.len();
        while !self.state.held.is_empty() {
            let noise = self.fitted_white(case);
            let score = self.score_with(case, thresholds, &noise);
            let without = |index: usize| {
                let chi2 = self.chi2_fall(case, index);
                let mut others = self.without_all(case, &[index]);
                let hypothesis = &self.state.held[index].hypothesis;
                let walk = match is_noisy {
                    true => drift_noise_fall(case, &mut others.state, hypothesis),
                    false => unstated_flicker_fall(case, &mut others.state, hypothesis),
                };
                let noise = others.fitted_white(case);
                let is_uncertain = is_drift(hypothesis) && self.has_larger_drift_noise(&hypothesis.gyros);
                let threshold = if is_uncertain { FEW_SAMPLES * chi2.threshold } else { chi2.threshold };
                let margin = (chi2.fall - threshold).min(others.score_with(case, thresholds, &noise) - score);
                (margin - walk, others)
            };
            let all: Vec<_> = (0..self.state.held.len()).into_par_iter().map(without).collect();
            match all.into_iter().min_by(|one, other| one.0.total_cmp(&other.0)) {
                Some((margin, others)) if margin <= 0.0 => *self = others,
                _ => break,
            }
        }
        self.state.held.len() < count
    }
}
