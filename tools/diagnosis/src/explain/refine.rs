//! What the data tell of an effect beside its size, once it is held, and whether there can be such a one.

use rayon::prelude::*;

use geu_model::course::TimeFunction;
use geu_model::number::Role;

use crate::bank::SignatureBank;
use crate::hypothesis::Hypothesis;
use crate::late::{self, LaggedFit};
use crate::normal::THIRDS;
use crate::null::Thresholds;
use crate::search::pays;
use crate::state::{DiagnosisCase, FittedHypothesis};

use super::selected::Explained;

/// A shape that has a default is told where χ² falls by this, two sigma, or where it is known to a fifth.
const SHAPE_CHI2: f64 = 4.0;
/// See [`SHAPE_CHI2`].
const SHAPE_KNOWN: f64 = 0.2;
/// Least distance from an onset that is tried, s.
const ONSET_S: f64 = 10.0;
/// Distance from an onset beyond which none is tried, s.
const MOST_ONSET_S: f64 = 2000.0;
/// What χ² may rise by where an onset is moved: rounding of counts alone makes 1 or 2.
const ONSET_CHI2: f64 = 4.0;
/// Half the width of that, in sigmas, from which on χ² is no parabola there, whose half width would be 2.
const FLAT_SIGMAS: f64 = 3.0;
/// Sigmas from which on a size is one.
const KNOWN_SIGMAS: f64 = 1.0;
/// Sigmas within which a number of counts is a whole one.
const WHOLE_SIGMAS: f64 = 4.0;

/// Whether what was found is a thing that there can be: within its limits, larger than its own sigma, and a whole number where it is
/// one of counts.
pub(super) fn is_possible(held: &FittedHypothesis) -> bool {
    let size = &held.hypothesis.parameters()[0];
    let is_whole = size.role != Role::Count || {
        let off = (size.value - size.value.round()).abs();
        size.value.round() != 0.0 && off <= WHOLE_SIGMAS * held.sigmas[0].max(0.01)
    };
    // Of what is smaller nobody can say that it is there: another number of the same change undoes it.
    let is_known = size.value.abs() > KNOWN_SIGMAS * held.sigmas[0];
    is_whole && is_known && held.hypothesis.is_within_limits() && held.sigmas[0].is_finite()
}

impl Explained {
    /// Where the last change follows the temperature, or swings as a temperature may, looks for how late the temperature is told.
    pub(super) fn shift_temperature(&mut self, case: &DiagnosisCase, bank: &SignatureBank, thresholds: &Thresholds) {
        let Some(last) = self.state.held.last() else { return };
        if !matches!(last.hypothesis.law(), Some(TimeFunction::Periodic { .. } | TimeFunction::Temperature)) {
            return;
        }
        let price = |family, change: &Hypothesis| thresholds.price(family, change);
        let own = last.held_out;
        let foretold = |held_out: &[Option<f64>; THIRDS]| held_out.iter().flatten().sum::<f64>();
        // What follows the temperature anyway must be foretold better with the lag than without.
        let is_foretold =
            |late: &LaggedFit| !last.follows_temperature() || foretold(&late.held().held_out) > foretold(&own);
        let is_accepted =
            |late: &LaggedFit| pays(&late.held().held_out) && is_foretold(late) && is_possible(late.held());
        let index = self.state.held.len() - 1;
        let Some(late) = late::likeliest(case, bank, &self.state, index, &price, &is_accepted) else { return };
        if late.score() < self.normal.squares() + last.penalty {
            (self.state, self.normal) = (late.state, late.normal);
        }
    }

    /// Takes a number of counts as the whole one that it is.
    pub(super) fn take_whole(&mut self, case: &DiagnosisCase) {
        let last = self.state.held.last_mut().expect("just put");
        if last.hypothesis.amplitude.is_count() {
            let sigma = last.sigmas[0];
            last.hypothesis.value = last.hypothesis.value.round();
            last.is_free[0] = false;
            last.invalidate();
            self.normal = case.fit(&mut self.state);
            self.state.held.last_mut().expect("still there").sigmas[0] = sigma;
        }
    }

    /// Frees those shapes of the last change that the data tell.
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
            let is_known = own.sigmas[index] < SHAPE_KNOWN * own.hypothesis.parameters()[index].value.abs();
            let fall = self.normal.squares() - normal.squares();
            if is_possible(own) && (fall > SHAPE_CHI2 || fall >= 0.0 && is_known) {
                (self.state, self.normal) = (tried, normal);
            }
        }
    }

    /// Puts onsets in the middle of where χ² is nearly the least, with the sigma of what is as likely everywhere there: between two
    /// motions an onset may lie anywhere.
    pub fn widen_onsets(&mut self, case: &DiagnosisCase) {
        for index in 0..self.state.held.len() {
            let parameters = self.state.held[index].hypothesis.parameters();
            let Some(place) = parameters.iter().position(|parameter| parameter.role == Role::Onset) else { continue };
            if !self.state.held[index].is_free[place] {
                continue;
            }
            let least = self.normal.chi2();
            let parameter = &parameters[place];
            let moved = |by_s: f64| {
                let mut state = self.state.clone();
                let value = (parameter.value + by_s).clamp(parameter.least, parameter.greatest);
                state.held[index].hypothesis.set(place, value);
                state.held[index].is_free[place] = false;
                state.held[index].invalidate();
                let normal = case.normal(&mut state);
                (normal.chi2() - least, state)
            };
            let reach_s = |sign: f64| {
                let (mut near, mut far) = (0.0, ONSET_S);
                while moved(sign * far).0 <= ONSET_CHI2 && far < MOST_ONSET_S {
                    (near, far) = (far, 2.0 * far);
                }
                while far - near > 0.1 * far {
                    let middle = 0.5 * (near + far);
                    if moved(sign * middle).0 > ONSET_CHI2 { far = middle } else { near = middle }
                }
                near
            };
            let sides: Vec<f64> = [-1.0, 1.0].into_par_iter().map(reach_s).collect();
            let half_s = 0.5 * (sides[0] + sides[1]);
            if half_s <= FLAT_SIGMAS * self.state.held[index].sigmas[place] {
                continue;
            }
            let (rise, mut state) = moved(0.5 * (sides[1] - sides[0]));
            if rise > ONSET_CHI2 {
                self.state.held[index].sigmas[place] = sides[0].max(sides[1]);
                continue;
            }
            self.normal = case.fit(&mut state);
            state.held[index].sigmas[place] = half_s / 3.0_f64.sqrt();
            self.state = state;
        }
    }
}
