//! Refinement of an accepted hypothesis: temperature lag, whole numbers, shape parameters, onsets.

use geu_model::parameter_spec::Role;
use rayon::prelude::*;

use crate::courses::shortest_s;
use crate::diagnosis_case::DiagnosisCase;
use crate::fitted_hypothesis::FittedHypothesis;
use crate::model_state::ModelState;
use crate::normal_equations::{NormalEquations, THIRDS};
use crate::null_distribution::Thresholds;
use crate::search::passes_cross_validation;
use crate::signature_bank::SignatureBank;
use crate::significance::{FOUR_SIGMAS, THREE_SIGMAS, TWO_SIGMA_CHI2};
use crate::temperature_lag::{LaggedFit, likeliest};

use super::selected::SelectedModel;

/// A shape parameter with a default is fitted if χ² falls by [`TWO_SIGMA_CHI2`], or if its relative sigma is below this.
const SHAPE_SIGMA: f64 = 0.2;
/// First shift of an onset in the search for its limits, blocks.
const ONSET: f64 = 2.0;
/// Largest shift of an onset, blocks.
const MAX_ONSET: f64 = 400.0;

/// Fits a state. The amplitude of a last hypothesis that settles between two motions and its onset are one number, and so are that of a wave
/// longer than the recording and its period: then onset or period stay.
pub(super) fn fit_last(case: &DiagnosisCase, state: &mut ModelState) -> NormalEquations {
    let before = state.clone();
    let normal = case.fit(state);
    let Some((last, start)) = state.held.last().zip(before.held.last()) else { return normal };
    let parameters = start.hypothesis.parameters();
    let place = |role: Role| parameters.iter().position(|parameter| parameter.role == role);
    let stays = place(Role::TimeConstant).and_then(|_| place(Role::Onset)).or_else(|| place(Role::Period));
    let Some(stays) = stays.filter(|&place| start.is_free[place] && !is_determined(last)) else { return normal };
    *state = before;
    if let Some(last) = state.held.last_mut() {
        last.fix(stays, parameters[stays].value);
    }
    case.fit(state)
}

/// True if the amplitude exceeds its sigma: a smaller one is compensated by another parameter of the same hypothesis.
fn is_determined(held: &FittedHypothesis) -> bool {
    held.hypothesis.value.abs() > held.sigmas[0]
}

/// True if the parameters are within their limits, the amplitude exceeds its sigma, a number of counts is whole, and a course neither
/// settles nor ends faster than any that is searched.
pub(super) fn is_possible(held: &FittedHypothesis, block_s: f64) -> bool {
    let size = &held.hypothesis.parameters()[0];
    let is_whole = size.role != Role::Count || {
        let off = (size.value - size.value.round()).abs();
        size.value.round() != 0.0 && off <= FOUR_SIGMAS * held.sigmas[0].max(0.01)
    };
    let mut shapes = held.hypothesis.amplitude.course_shapes().iter().zip(&held.hypothesis.course_shapes);
    let is_slow =
        shapes.all(|(number, value)| shortest_s(number.role, block_s).is_none_or(|shortest_s| *value >= shortest_s));
    is_whole && is_slow && is_determined(held) && held.hypothesis.is_within_limits() && held.sigmas[0].is_finite()
}

impl SelectedModel {
    /// Fits the temperature lag if the last hypothesis follows the temperature or oscillates as a temperature may.
    pub(super) fn shift_temperature(&mut self, case: &DiagnosisCase, bank: &SignatureBank, thresholds: &Thresholds) {
        let Some(last) = self.state.held.last() else { return };
        if !last.follows_temperature() && !last.hypothesis.profile().is_some_and(|profile| profile.is_periodic()) {
            return;
        }
        let prediction = |held_out: &[Option<f64>; THIRDS]| held_out.iter().flatten().sum::<f64>();
        let is_accepted = |late: &LaggedFit| {
            let held_out = &late.held().held_out;
            // A hypothesis that follows the temperature already must predict the thirds better with the lag.
            let is_better = !last.follows_temperature() || prediction(held_out) > prediction(&last.held_out);
            passes_cross_validation(held_out) && is_better && is_possible(late.held(), case.measured.block_s())
        };
        let (index, penalty) = (self.state.held.len() - 1, |family, own: &_| thresholds.penalty(family, own));
        let Some(late) = likeliest(case, bank, &self.state, index, &penalty, &is_accepted) else { return };
        if late.score() < self.normal.squares() + last.penalty {
            (self.state, self.normal) = (late.state, late.normal);
        }
    }

    /// Replaces the last hypothesis and another of the same amplitude and gyros, if both follow the temperature, by an effect of
    /// the lagged temperature: a value and its rate of change are to first order that value at another time.
    pub(super) fn join_lagged(&mut self, case: &DiagnosisCase, bank: &SignatureBank, thresholds: &Thresholds) {
        let key = |held: &FittedHypothesis| (held.hypothesis.amplitude.constant(), held.hypothesis.gyros);
        let Some((last, others)) = self.state.held.split_last().filter(|(last, _)| last.follows_temperature()) else {
            return;
        };
        let is_same = |other: &FittedHypothesis| other.follows_temperature() && key(other) == key(last);
        let Some(index) = others.iter().position(is_same) else { return };
        let both = self.normal.squares() + last.penalty + others[index].penalty;
        let mut single = self.state.clone();
        single.held.pop();
        let is_accepted = |late: &LaggedFit| {
            passes_cross_validation(&late.held().held_out) && is_possible(late.held(), case.measured.block_s())
        };
        let penalty = |family, own: &_| thresholds.penalty(family, own);
        let Some(late) = likeliest(case, bank, &single, index, &penalty, &is_accepted) else { return };
        if late.score() < both {
            self.remove(self.state.held.len() - 1);
            (self.state, self.normal) = (late.state, late.normal);
        }
    }

    /// Rounds the last hypothesis to a whole number if it is a number of counts.
    pub(super) fn round_count(&mut self, case: &DiagnosisCase) {
        let index = self.state.held.len() - 1;
        let last = &mut self.state.held[index];
        if last.hypothesis.amplitude.is_count() {
            let sigma = last.sigmas[0];
            last.fix(0, last.hypothesis.value.round());
            self.normal = case.fit(&mut self.state);
            self.state.held[index].sigmas[0] = sigma;
        }
    }

    /// Fits those shape parameters of the last hypothesis that the data determine.
    pub(super) fn free_shapes(&mut self, case: &DiagnosisCase) {
        let last = self.state.held.len() - 1;
        for index in 0..self.state.held[last].is_free.len() {
            if self.state.held[last].is_free[index] {
                continue;
            }
            let mut tried = self.state.clone();
            tried.held[last].free(index);
            let normal = case.fit(&mut tried);
            let own = &tried.held[last];
            let is_determined = own.sigmas[index] < SHAPE_SIGMA * own.hypothesis.parameters()[index].value.abs();
            let fall = self.normal.squares() - normal.squares();
            if is_possible(own, case.measured.block_s()) && (fall > TWO_SIGMA_CHI2 || fall >= 0.0 && is_determined) {
                (self.state, self.normal) = (tried, normal);
            }
        }
    }

    /// Names the one gyro that shows a hypothesis on all of them: if χ² rises by less than [`TWO_SIGMA_CHI2`] without the others, the motion
    /// does not show it on them.
    pub fn leave_out_gyros(&mut self, case: &DiagnosisCase) {
        for index in 0..self.state.held.len() {
            let hypothesis = &self.state.held[index].hypothesis;
            if hypothesis.amplitude.is_of_unit() || !hypothesis.gyros.is_all() {
                continue;
            }
            let on = |gyro: usize| {
                let mut state = self.state.clone();
                state.held[index].hypothesis.gyros = case.measured.gyros().only(gyro);
                state.held[index].invalidate();
                let normal = case.fit(&mut state);
                is_possible(&state.held[index], case.measured.block_s()).then_some((state, normal))
            };
            let alone = (0..case.measured.gyros().heads()).into_par_iter().filter_map(on);
            let best = alone.min_by(|one, other| one.1.squares().total_cmp(&other.1.squares()));
            let is_equal = |normal: &NormalEquations| normal.squares() < self.normal.squares() + TWO_SIGMA_CHI2;
            if let Some((state, normal)) = best.filter(|(_, normal)| is_equal(normal)) {
                (self.state, self.normal) = (state, normal);
            }
        }
    }

    /// Moves each onset to the middle of the interval in which χ² is nearly minimal, with the sigma of a uniform distribution over it:
    /// between two motions all onsets are equally likely.
    pub fn widen_onsets(&mut self, case: &DiagnosisCase) {
        let block_s = case.measured.block_s();
        for index in 0..self.state.held.len() {
            let parameters = self.state.held[index].hypothesis.parameters();
            let Some(place) = parameters.iter().position(|parameter| parameter.role == Role::Onset) else { continue };
            if !self.state.held[index].is_free[place] {
                continue;
            }
            let min = self.normal.chi2();
            let parameter = &parameters[place];
            let moved = |by_s: f64| {
                let mut state = self.state.clone();
                state.held[index].fix(place, (parameter.value + by_s).clamp(parameter.min, parameter.max));
                let normal = case.normal(&mut state);
                (normal.chi2() - min, state)
            };
            let limit_s = |sign: f64| {
                let (mut inside, mut outside) = (0.0, ONSET * block_s);
                while moved(sign * outside).0 <= TWO_SIGMA_CHI2 && outside < MAX_ONSET * block_s {
                    (inside, outside) = (outside, 2.0 * outside);
                }
                while outside - inside > 0.1 * outside {
                    let middle = 0.5 * (inside + outside);
                    if moved(sign * middle).0 > TWO_SIGMA_CHI2 { outside = middle } else { inside = middle }
                }
                inside
            };
            let (before_s, after_s) = rayon::join(|| limit_s(-1.0), || limit_s(1.0));
            let half_s = 0.5 * (before_s + after_s);
            if half_s <= THREE_SIGMAS * self.state.held[index].sigmas[place] {
                continue;
            }
            let (rise, mut state) = moved(0.5 * (after_s - before_s));
            let fitted = (rise <= TWO_SIGMA_CHI2).then(|| case.fit(&mut state));
            // The amplitude that belongs to the middle may be beyond its limits.
            let is_near = |normal: &NormalEquations| normal.squares() - self.normal.squares() <= TWO_SIGMA_CHI2;
            let Some(normal) = fitted.filter(is_near) else {
                self.state.held[index].sigmas[place] = before_s.max(after_s);
                continue;
            };
            self.normal = normal;
            state.held[index].sigmas[place] = half_s / 3.0_f64.sqrt();
            self.state = state;
        }
    }
}
