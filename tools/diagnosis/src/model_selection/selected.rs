//! The state of the selection: hypotheses, noise and their normal equations.

use geu_model::parameter_spec::{ParameterSpec, Role};

use crate::diagnosis_case::DiagnosisCase;
use crate::fitted_hypothesis::FittedHypothesis;
use crate::measured::{CHANNELS, TIMING};
use crate::model_state::ModelState;
use crate::noise::is_declared;
use crate::noise::{FittedNoise, Walk};
use crate::normal_equations::NormalEquations;
use crate::null_distribution::Thresholds;
use crate::outcome::{Chi2Fall, Correction, DiagnosedEffect};
use crate::search::{Candidate, is_several, shape_penalty};
use crate::temperature_lag::lag_chi2;
use crate::whitening::NoiseModel;
use geu_protocol::Gyros;

/// Maximum number of accepted effects on one gyro. The search adds one more, which marks the gyro as overfitted.
pub const MAX_PER_GYRO: usize = 3;
/// Penalty of each further larger walk: the χ² reduction of one parameter that noise exceeds in less than 10 %.
pub(super) const FURTHER_WALK_CHI2: f64 = 2.7;
/// A walk is reported from this multiple of the configured one: rounding of a slow rate can imitate half as much again.
const MIN_WALK: f64 = 2.0;

/// A walk above its configured growth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdentifiedNoise {
    /// The channel.
    pub channel: usize,
    /// The walk.
    pub walk: Walk,
    /// Growth before the fit.
    pub before: f64,
    /// The fit.
    pub fitted: FittedNoise,
}

impl IdentifiedNoise {
    /// True for equal walks of gyros: they have one cause.
    pub(super) fn has_one_cause_with(&self, other: &IdentifiedNoise) -> bool {
        self.walk == other.walk && self.channel != TIMING && other.channel != TIMING
    }

    /// True if rounding cannot imitate it.
    pub fn is_significant(&self, state: &ModelState) -> bool {
        self.channel != TIMING && state.noise[self.channel].walk(self.walk) >= MIN_WALK * self.before
    }
}

/// The best hypotheses of the search on gyros of their own, if they are not possible or the model run does not confirm them.
#[derive(Debug, Clone, Copy)]
pub(super) struct RejectedHypothesis {
    pub(super) gyros: Gyros,
    /// The score with them.
    pub(super) score: f64,
}

/// Factor of a threshold beside noise of which few samples show the size. Of a drift's: three hours have 18 intervals of ten minutes, 16
/// without a constant and a slope, that show how large a fitted noise of the drift is. Of noise that changes from block to block: 15 to 30
/// blocks show its scale; by their median, so that they count for fewer. Student's t with 16 degrees of freedom reaches three times a χ² of 28
/// as rarely as a normal variable reaches 28.
pub const FEW_SAMPLES: f64 = 3.0;
/// Segments of a recording in which reference and motion have errors of their own.
const SEGMENTS: usize = 48;

/// One step of the selection, best candidates first.
#[derive(Debug, Clone)]
pub struct SelectionStep {
    /// Candidates.
    pub candidates: Vec<Candidate>,
    /// Index of the accepted hypothesis in the state.
    pub kept: Option<usize>,
    /// Index of the added candidate, even if it was removed later.
    pub added: Option<usize>,
}

/// Result of the selection.
#[derive(Debug, Clone)]
pub struct SelectedModel {
    /// Parameters and hypotheses.
    pub state: ModelState,
    /// Normal equations.
    pub normal: NormalEquations,
    /// Steps of the selection.
    pub steps: Vec<SelectionStep>,
    /// Walks above their configured growth.
    pub noise: Vec<IdentifiedNoise>,
    /// True if a limit on the number of effects, on one gyro or in all, ended the search or a less likely one.
    pub is_cut: bool,
    /// The rejected hypotheses at the end of the search.
    pub(super) rejected: Option<RejectedHypothesis>,
}

impl SelectedModel {
    pub(super) fn start(case: &DiagnosisCase, mut state: ModelState) -> SelectedModel {
        let normal = case.fit(&mut state);
        SelectedModel { state, normal, steps: Vec::new(), noise: Vec::new(), is_cut: false, rejected: None }
    }

    /// −2 ln of the likelihood with calibration parameters and lag integrated out, plus all penalties. A walk can imitate anything,
    /// so that its penalty is the highest penalty of the time courses.
    pub fn score(&self, case: &DiagnosisCase, thresholds: &Thresholds) -> f64 {
        self.score_with(case, thresholds, &self.state.noise)
    }

    pub(super) fn score_with(
        &self,
        case: &DiagnosisCase,
        thresholds: &Thresholds,
        noise: &[NoiseModel; CHANNELS],
    ) -> f64 {
        let is_further = |index: &usize| {
            let own = &self.noise[*index];
            self.is_of_unit(case, own.walk) || self.noise[..*index].iter().any(|one| one.has_one_cause_with(own))
        };
        let further = (0..self.noise.len()).filter(is_further).count() as f64;
        let walks = (self.noise.len() as f64 - further) * thresholds.largest() + further * FURTHER_WALK_CHI2;
        let (residual, a_priori) = (case.residual(&self.state), case.a_priori(&self.state.calibration));
        let normal = NormalEquations::new(case.whitenings(noise), &residual, &case.nuisances, &a_priori);
        normal.deviance() + self.penalties() + walks
    }

    /// True for a walk that most gyros of a unit show, of which the configuration states no noise: it is that of the unit.
    fn is_of_unit(&self, case: &DiagnosisCase, walk: Walk) -> bool {
        let own = self.noise.iter().filter(|found| found.walk == walk && !is_declared(case.nominal, found.channel));
        2 * own.count() > case.measured.gyros().heads()
    }

    /// χ² plus all penalties, at the noise of the state.
    pub(super) fn penalised_chi2(&self) -> f64 {
        self.normal.squares() + self.penalties()
    }

    /// Penalties of the hypotheses, of the shapes of their time courses and of the temperature lag.
    fn penalties(&self) -> f64 {
        let penalty = |held: &FittedHypothesis| held.penalty + shape_penalty(&held.hypothesis);
        self.state.held.iter().map(penalty).sum::<f64>() + lag_chi2(&self.state)
    }

    /// True if a time course ends or decays.
    pub fn has_transient(&self) -> bool {
        let ends = |shape: &ParameterSpec| matches!(shape.role, Role::Duration | Role::TimeConstant);
        self.state.held.iter().any(|held| held.hypothesis.amplitude.course_shapes().iter().any(ends))
    }

    /// Hypotheses of a gyro and their indices, without hypotheses of the whole unit.
    pub(super) fn on(&self, gyro: usize) -> impl Iterator<Item = (usize, &FittedHypothesis)> {
        let held = self.state.held.iter().enumerate();
        held.filter(move |(_, held)| !held.hypothesis.amplitude.is_of_unit() && held.hypothesis.gyros[gyro])
    }

    /// χ² reduction by a hypothesis beside all others, and its penalty.
    pub fn chi2_fall(&self, case: &DiagnosisCase, index: usize) -> Chi2Fall {
        self.without(case, index).2
    }

    /// State, equations and rise of χ² without one hypothesis, refitted; its penalty includes that of a lag that only it needs.
    pub(super) fn without(&self, case: &DiagnosisCase, index: usize) -> (ModelState, NormalEquations, Chi2Fall) {
        let mut state = self.state.clone();
        state.remove(index);
        let normal = case.fit(&mut state);
        let fall = normal.squares() - self.normal.squares();
        let threshold = self.state.held[index].penalty + lag_chi2(&self.state) - lag_chi2(&state);
        (state, normal, Chi2Fall { fall, threshold })
    }

    /// The selection without the hypotheses of these indices, refitted.
    pub(super) fn without_all(&self, case: &DiagnosisCase, indices: &[usize]) -> SelectedModel {
        let mut others = self.clone();
        indices.iter().rev().for_each(|&index| drop(others.remove(index)));
        others.normal = case.fit(&mut others.state);
        others
    }

    /// Indices of each two hypotheses that act on a common gyro, or of which one acts on several: a cause acts on one or on all.
    pub(super) fn overlapping_pairs(&self) -> impl Iterator<Item = [usize; 2]> {
        let held = &self.state.held;
        let pairs = (0..held.len()).flat_map(|one| (one + 1..held.len()).map(move |other| [one, other]));
        pairs.filter(|two| {
            let [one, other] = two.map(|index| &held[index].hypothesis.gyros);
            one.overlaps(other) || is_several(one) || is_several(other)
        })
    }

    /// Removes a hypothesis from the state and from the steps.
    pub(super) fn remove(&mut self, index: usize) -> FittedHypothesis {
        for step in &mut self.steps {
            step.kept = step.kept.filter(|&kept| kept != index).map(|kept| kept - usize::from(kept > index));
        }
        self.state.remove(index)
    }

    /// Joins two hypotheses that differ only in their gyros.
    pub fn join(&mut self, case: &DiagnosisCase, one: usize, other: usize) {
        let second = self.remove(other);
        let first = &mut self.state.held[one];
        first.hypothesis.gyros = first.hypothesis.gyros.and(second.hypothesis.gyros);
        first.invalidate();
        first.sigmas.fill(f64::NAN);
        first.penalty = first.penalty.max(second.penalty);
        for (own, other) in first.held_out.iter_mut().zip(second.held_out) {
            *own = own.map_or(other, |own| Some(own + other.unwrap_or(0.0)));
        }
        self.normal = case.fit(&mut self.state);
    }

    /// Removes the hypothesis of a reported effect.
    pub fn drop_stated(&mut self, case: &DiagnosisCase, entry: &DiagnosedEffect) {
        let is_stated =
            |held: &FittedHypothesis| entry.corrections.contains(&Correction::Hypothesis(held.hypothesis.clone()));
        if let Some(index) = self.state.held.iter().position(is_stated) {
            self.remove(index);
            self.normal = case.fit(&mut self.state);
        }
    }

    /// Ratio of the variance of a fitted amplitude to that beside white noise, from the products of its signature and the residual in segments
    /// of the recording (Liang and Zeger 1986).
    fn clustering(&self, case: &DiagnosisCase, index: usize) -> f64 {
        let blocks = case.measured.block_count();
        let signature = case.signature(&self.state, index).map(|own| own.unwrap_or_else(|| vec![0.0; blocks]));
        let signature = case.normal_without(&self.state, index).projected_residual_of(&signature);
        let left = self.normal.projected_residual();
        let length = (blocks / SEGMENTS).max(1);
        let mut products = vec![0.0; blocks.div_ceil(length)];
        let mut square = 0.0;
        for (own, left) in signature[..TIMING].iter().zip(&left) {
            for (block, (own, left)) in own.iter().zip(left).enumerate() {
                products[block / length] += own * left;
                square += own * own;
            }
        }
        products.iter().map(|own| own * own).sum::<f64>() / square
    }

    /// Removes hypotheses beside noise that changes, if their fall of χ² is below their threshold times the largest of `FEW_SAMPLES` and the
    /// ratio of the largest squared innovation to that of normal noise, which is 2 ln of the number of blocks, and times their
    /// clustering. Errors of the reference reach all gyros. Noise with long tails exceeds a threshold more often, also with
    /// hypotheses that are not possible: the rejected ones are no evidence.
    pub fn drop_outliers(&mut self, case: &DiagnosisCase) {
        self.rejected = None;
        loop {
            let left = self.normal.projected_residual();
            let excess = |of_gyro: &Vec<f64>| {
                let largest = of_gyro.iter().map(|value| value * value).fold(0.0, f64::max);
                largest / (2.0 * (of_gyro.len() as f64).ln())
            };
            let gyros = &left[..case.measured.gyros().heads()];
            let factor = gyros.iter().map(excess).fold(FEW_SAMPLES, f64::max);
            let beyond = |index: usize| {
                let Chi2Fall { fall, threshold } = self.chi2_fall(case, index);
                fall - threshold * factor * self.clustering(case, index).max(1.0)
            };
            let falls = (0..self.state.held.len()).map(|index| (index, beyond(index)));
            let Some((index, _)) = falls.filter(|own| own.1 < 0.0).min_by(|a, b| a.1.total_cmp(&b.1)) else { return };
            self.remove(index);
            self.normal = case.fit(&mut self.state);
        }
    }

    /// Removes the hypotheses that act only on these gyros.
    pub fn drop_on(&mut self, case: &DiagnosisCase, gyros: &Gyros) {
        for index in (0..self.state.held.len()).rev() {
            let hypothesis = &self.state.held[index].hypothesis;
            if !hypothesis.amplitude.is_of_unit() && hypothesis.gyros.is_within(gyros) {
                self.remove(index);
            }
        }
        self.normal = case.fit(&mut self.state);
    }
}
