//! What of an explanation may be believed.

use geu_model::Configuration;
use rayon::prelude::*;

use crate::bank::SignatureBank;
use crate::measured::TIMING;
use crate::normal::NormalEquations;
use crate::null::Thresholds;
use crate::search::{Candidate, search};
use crate::state::DiagnosisCase;

use super::selected::{Explained, MOST_OF_ONE, RejectedHypothesis};
use super::walks::walked;

/// What the search finds beyond chance by more than this, three sigma, is there, whether or not there is anything that explains it.
pub(super) const REFUSED_CHI2: f64 = 9.0;
/// What explains less than this share of all that was found is no more than a fault of the rest: a signature that is like the true one
/// to a cosine of 0.995 leaves as much.
const NEGLIGIBLE: f64 = 0.01;
/// What all thirds together must gain, each foretold by the others, for an effect to stand beside another one of its gyro: three sigma.
const FORETOLD_CHI2: f64 = 9.0;

impl Explained {
    /// Whether a formula might do better: as well in the place of one of the changes, or instead of a pile of them, or of noise.
    pub fn is_doubtful(&self, case: &DiagnosisCase, formulas: &SignatureBank, thresholds: &Thresholds) -> bool {
        let is_pile = |gyro: usize| self.state.held.iter().filter(|held| held.hypothesis.gyros[gyro]).count() > 1;
        let is_noisy = self.noise.iter().any(|found| found.is_told(case.believed, &self.state));
        if is_noisy || (0..TIMING).any(is_pile) {
            return true;
        }
        let here = search(formulas, &self.normal, &self.state, &|family| thresholds.of(family));
        if here.first().is_some_and(|best| best.gain.chi2 > thresholds.of(best.family)) {
            return true;
        }
        (0..self.state.held.len()).any(|index| {
            let (state, normal) = self.without(case, index);
            let worth = normal.squares() - self.normal.squares() - self.cost(index, &state);
            let candidates = search(formulas, &normal, &state, &|family| thresholds.of(family));
            let best = candidates.first().map(|best| best.gain.chi2 - thresholds.of(best.family));
            best.is_some_and(|best| best > worth)
        })
    }

    /// A fall of χ² that is next to nothing beside that of all that was found, the lag among it; calibration numbers move in any case.
    pub(super) fn negligible(&self, case: &DiagnosisCase) -> f64 {
        let sixteen = &case.nuisances[..case.nuisances.len() - 1];
        let start = case.residual(&case.start(self.state.noise));
        NEGLIGIBLE
            * (NormalEquations::new(case.whitenings(&self.state.noise), &start, sixteen).chi2() - self.normal.chi2())
    }

    /// Whether a formula is what explains, and no small mend of other things that do.
    pub fn stands_on_a_formula(&self, case: &DiagnosisCase) -> bool {
        let is_formula = |index: &usize| self.state.held[*index].hypothesis.amplitude.formula().is_some();
        (0..self.state.held.len()).filter(is_formula).any(|index| self.worth(case, index).0 > self.negligible(case))
    }

    /// Gyros that stay unexplained: those on which something is left that nothing explains, and those whose changes are a pile. A
    /// pile is noise as a last resort beside several changes, a formula beside anything, a change that the other thirds do not
    /// foretell beside another one, or more than anything should have, which explains everything, and so nothing.
    pub fn overfitted_gyros(&self, believed: &Configuration) -> [bool; 4] {
        std::array::from_fn(|gyro| {
            let own = || self.on(gyro).map(|(_, held)| held);
            let has_formula = own().any(|held| held.hypothesis.amplitude.formula().is_some());
            let is_noisy = self.noise.iter().any(|found| found.channel == gyro && found.is_told(believed, &self.state));
            if self.refused.is_some_and(|refused| refused.gyros[gyro]) {
                return true;
            }
            let is_told_once = own().any(|held| held.held_out.iter().flatten().sum::<f64>() < FORETOLD_CHI2);
            own().count() > if has_formula || is_noisy || is_told_once { 1 } else { MOST_OF_ONE }
        })
    }

    /// What a hypothesis would make of the score, with the white noise as it is without it.
    pub(super) fn refusal(
        &mut self,
        case: &DiagnosisCase,
        bank: &SignatureBank,
        thresholds: &Thresholds,
        candidate: &Candidate,
    ) -> RejectedHypothesis {
        let noise = self.fitted_white(case);
        let (residual, columns) = case.linearised(&mut self.state);
        let normal = NormalEquations::departed(case.whitenings(&noise), &residual, &columns, &self.state.sixteen);
        let own = candidate.spot.signature(bank, &normal).products;
        let gain = normal.gain(&own).map_or(0.0, |gain| gain.chi2);
        let worth = gain - thresholds.price(candidate.family, &candidate.hypothesis);
        RejectedHypothesis {
            gyros: candidate.hypothesis.gyros,
            score: self.score_with(case, thresholds, &noise) - worth,
        }
    }

    /// The score, and what was refused only where that would have a better one: walks may explain what it does.
    pub(super) fn settled(mut self, case: &DiagnosisCase, thresholds: &Thresholds) -> (Explained, f64) {
        let score = self.score(case, thresholds);
        self.refused = self.refused.filter(|refused| refused.score + REFUSED_CHI2 < score);
        let best = self.refused.map_or(score, |refused| refused.score);
        (self, best)
    }

    /// Drops each change that, beside all the others, is not worth what was paid for it. Where walks are larger than believed, what was
    /// paid is too little: then a change must also better a walk in its place.
    pub fn prune(&mut self, case: &DiagnosisCase) {
        let is_noisy = self.noise.iter().any(|found| found.is_told(case.believed, &self.state));
        loop {
            let without = |index: usize| {
                let (mut state, normal) = self.without(case, index);
                let walked = if is_noisy { walked(case, &mut state, &self.state.held[index].hypothesis) } else { 0.0 };
                let spare = normal.squares() - self.normal.squares() - self.cost(index, &state);
                (spare - walked, index, state, normal)
            };
            let all: Vec<_> = (0..self.state.held.len()).into_par_iter().map(without).collect();
            match all.into_iter().min_by(|one, other| one.0.total_cmp(&other.0)) {
                Some((worth, index, state, normal)) if worth <= 0.0 => {
                    self.forget(index);
                    (self.state, self.normal) = (state, normal);
                }
                _ => break,
            }
        }
    }
}
