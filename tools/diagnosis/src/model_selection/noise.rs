//! Random walks and flicker above their configured growth, instead of effects or beside them.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::OnceLock;

use rayon::prelude::*;

use crate::diagnosis_case::DiagnosisCase;
use crate::measured::{CHANNELS, Series, TIMING};
use crate::model_state::ModelState;
use crate::noise::{self, Walk, WalkFits};
use crate::normal_equations::Nuisance;
use crate::null_distribution::Thresholds;
use crate::signature_bank::HypothesisFamily;
use crate::whitening::NoiseModel;
use geu_hypothesis::Hypothesis;
use geu_model::noise::flicker::FLICKER_FLOOR;
use geu_model::units::S_PER_H;
use geu_protocol::Gyros;

use super::selected::{FURTHER_WALK_CHI2, IdentifiedNoise, SelectedModel};

/// Fitted walks of a residual, of which those of a channel hold until one is accepted on it; `None` if it is not larger.
type KnownWalks = BTreeMap<(usize, Walk), Option<IdentifiedNoise>>;

impl SelectedModel {
    /// Accepts walks above their configured growth, the likeliest first, as long as they exceed their threshold.
    pub(super) fn free_noise(&mut self, case: &DiagnosisCase, thresholds: &Thresholds) {
        let walks: Vec<(usize, Walk)> = (0..case.measured.gyros().heads())
            .flat_map(|channel| Walk::ALL.map(|walk| (channel, walk)))
            .chain([(TIMING, Walk::Angle)])
            .collect();
        let threshold = thresholds.required(HypothesisFamily::NOISE);
        let mut known = KnownWalks::new();
        for _ in 0..walks.len() {
            let larger = self.larger_walks(case, &walks, &mut known);
            let margin = |found: &IdentifiedNoise| {
                let is_further = self.noise.iter().any(|other| other.has_one_cause_with(found));
                found.fitted.fall - if is_further { FURTHER_WALK_CHI2 } else { threshold }
            };
            match larger.into_iter().max_by(|a, b| margin(a).total_cmp(&margin(b))) {
                Some(found) if margin(&found) > 0.0 => self.accept_walk(found, &mut known),
                _ => break,
            }
        }
        // Walks that exceed the threshold only together.
        for walk in [Walk::Rate, Walk::Angle, Walk::Scale, Walk::Flicker] {
            let of_gyros: Vec<(usize, Walk)> = (0..case.measured.gyros().heads()).map(|gyro| (gyro, walk)).collect();
            let larger = self.larger_walks(case, &of_gyros, &mut known);
            let fall: f64 = larger.iter().map(|found| found.fitted.fall).sum();
            let further = FURTHER_WALK_CHI2 * larger.len().saturating_sub(1) as f64;
            let undeclared = larger.iter().filter(|found| !noise::is_declared(case.nominal, found.channel)).count();
            let threshold = if 2 * undeclared > of_gyros.len() { FURTHER_WALK_CHI2 } else { threshold };
            if larger.len() > 1 && fall > threshold + further {
                larger.into_iter().for_each(|found| self.accept_walk(found, &mut known));
            }
        }
        self.state.noise = self.fitted_white(case);
        self.normal = case.fit(&mut self.state);
    }

    /// Fits those of `walks` that are not accepted yet; returns the ones above their configured growth.
    fn larger_walks(
        &mut self,
        case: &DiagnosisCase,
        walks: &[(usize, Walk)],
        known: &mut KnownWalks,
    ) -> Vec<IdentifiedNoise> {
        let is_accepted = |own: &(usize, Walk)| self.noise.iter().any(|found| (found.channel, found.walk) == *own);
        let open: Vec<(usize, Walk)> = walks.iter().copied().filter(|own| !is_accepted(own)).collect();
        // Errors of an effect that withholds motions walk.
        let negligible: [f64; CHANNELS] =
            std::array::from_fn(|channel| if self.withholds(channel) { self.negligible(case) } else { 0.0 });
        let (residual, nuisances) = case.linearised(&mut self.state);
        let is_unknown = |own: &(usize, Walk)| !known.contains_key(own) && case.measured.is_usable(own.0);
        let unknown: Vec<(usize, Walk)> = open.iter().copied().filter(is_unknown).collect();
        // The same state is reached again: by the next pass, or before any effect.
        let state = self.state.key();
        let key = |own: &(usize, Walk)| {
            let mut hasher = DefaultHasher::new();
            (state, own).hash(&mut hasher);
            hasher.finish()
        };
        let fits: [OnceLock<WalkFits>; CHANNELS] = Default::default();
        let fit = |own: &(usize, Walk)| {
            let (channel, walk) = *own;
            let of_channel = || WalkFits::new(case, channel, self.state.noise[channel], &residual, &nuisances);
            let fitted = || {
                let fitted = fits[channel].get_or_init(of_channel).fit(walk);
                case.walks.keep(key(own), &fitted);
                fitted
            };
            let (before, fitted) =
                (self.state.noise[channel].walk(walk), case.walks.find(key(own)).unwrap_or_else(fitted));
            let is_larger = fitted.noise.walk(walk) > before && fitted.fall > negligible[channel];
            (*own, is_larger.then_some(IdentifiedNoise { channel, walk, before, fitted }))
        };
        let fitted: Vec<_> = unknown.par_iter().map(fit).collect();
        known.extend(fitted);
        open.iter().filter_map(|own| known.get(own).copied().flatten()).collect()
    }

    fn accept_walk(&mut self, found: IdentifiedNoise, known: &mut KnownWalks) {
        self.state.noise[found.channel] = found.fitted.noise;
        known.retain(|(channel, _), _| *channel != found.channel);
        self.noise.push(found);
    }

    /// The noise with its white part fitted to the residual.
    pub(super) fn fitted_white(&mut self, case: &DiagnosisCase) -> [NoiseModel; CHANNELS] {
        let (residual, nuisances) = case.linearised(&mut self.state);
        let white = |channel: usize| noise::fit_white(case, channel, &self.state.noise[channel], &residual, &nuisances);
        let all: Vec<_> = (0..CHANNELS).into_par_iter().map(white).collect();
        std::array::from_fn(|channel| all[channel])
    }

    /// Adds the flicker that every drift has to gyros without stated noise, if it is likelier.
    pub fn add_unstated_flicker(&mut self, case: &DiagnosisCase) {
        let is_open = |gyro: &usize| case.measured.is_usable(*gyro) && self.state.noise[*gyro].flicker == 0.0;
        let open: Vec<usize> = unstated(case, &case.measured.gyros()).filter(is_open).collect();
        if open.is_empty() {
            return;
        }
        let linearised = case.linearised(&mut self.state);
        for gyro in open {
            let (with, fall) = unstated_flicker(case, &self.state.noise[gyro], gyro, &linearised);
            if fall > FURTHER_WALK_CHI2 {
                self.state.noise[gyro] = with;
            }
        }
        self.normal = case.fit(&mut self.state);
    }

    /// Resets the walks of these gyros to their configured growth.
    pub fn reset_noise(&mut self, case: &DiagnosisCase, gyros: &Gyros) {
        let (reset, kept): (Vec<IdentifiedNoise>, _) =
            self.noise.iter().partition(|found| found.channel != TIMING && gyros[found.channel]);
        self.noise = kept;
        for found in &reset {
            let noise = &mut self.state.noise[found.channel];
            *noise = noise.with(found.walk, found.before);
        }
        if !reset.is_empty() {
            self.normal = case.fit(&mut self.state);
        }
    }
}

/// Averaging time at which the Allan deviation of a gyro has its minimum at the earliest, s: there the flicker is as large as the angle
/// random walk. Data sheets of MEMS gyros show it at 100 to 1000 s, and later of others.
const EARLIEST_MINIMUM_S: f64 = 100.0;
/// Shares of the largest flicker that are tried.
const FLICKERS: [f64; 3] = [0.25, 0.5, 1.0];

/// Gyros of a set without stated noise.
fn unstated(case: &DiagnosisCase, gyros: &Gyros) -> impl Iterator<Item = usize> {
    gyros.gyros().map(|gyro| gyro.index()).filter(|gyro| !noise::is_declared(case.nominal, *gyro))
}

/// Largest flicker of a gyro with this angle random walk, per hour.
fn largest_flicker(noise: &NoiseModel) -> f64 {
    noise.angle_walk * S_PER_H / (FLICKER_FLOOR * EARLIEST_MINIMUM_S.sqrt())
}

/// Averaging time at which the Allan deviation is smallest, s, if a walk of the drift makes it earlier than that of any gyro.
pub fn early_minimum_s(noise: &NoiseModel) -> Option<f64> {
    let of_walk = 3f64.sqrt() * noise.angle_walk / noise.rate_walk;
    let of_flicker = EARLIEST_MINIMUM_S * (largest_flicker(noise) / noise.flicker).powi(2);
    Some(of_walk.min(of_flicker)).filter(|minimum_s| *minimum_s < EARLIEST_MINIMUM_S)
}

/// The likeliest of a few flickers of a gyro of which the configuration states no noise, and the reduction of χ²; at most 0 for none.
fn unstated_flicker(
    case: &DiagnosisCase,
    noise: &NoiseModel,
    channel: usize,
    (residual, nuisances): &(Series, Vec<Nuisance>),
) -> (NoiseModel, f64) {
    let largest = largest_flicker(noise);
    let fitted =
        |flicker: f64| noise::fit_white(case, channel, &noise.with(Walk::Flicker, flicker), residual, nuisances);
    let blocks = Cow::Borrowed(&case.measured.blocks[channel][..]);
    let deviance = noise::deviance(case, channel, blocks, residual, nuisances);
    let without = deviance(&fitted(noise.flicker));
    let all = FLICKERS.iter().map(|share| fitted(share * largest)).map(|noise| (noise, without - deviance(&noise)));
    all.max_by(|one, other| one.1.total_cmp(&other.1)).expect("a flicker")
}

/// χ² reduction by a flicker on the gyros of a hypothesis of which the configuration states no noise, in its place.
pub(super) fn unstated_flicker_fall(case: &DiagnosisCase, state: &mut ModelState, hypothesis: &Hypothesis) -> f64 {
    let gyros: Vec<usize> = unstated(case, &hypothesis.gyros).collect();
    if hypothesis.amplitude.is_of_unit() || gyros.is_empty() {
        return 0.0;
    }
    let linearised = case.linearised(state);
    gyros.into_iter().map(|gyro| unstated_flicker(case, &state.noise[gyro], gyro, &linearised).1.max(0.0)).sum()
}

/// χ² reduction by a larger rate random walk or flicker on the gyros of a hypothesis, in its place.
pub(super) fn drift_noise_fall(case: &DiagnosisCase, state: &mut ModelState, hypothesis: &Hypothesis) -> f64 {
    if hypothesis.amplitude.is_of_unit() {
        return 0.0;
    }
    let (residual, nuisances) = case.linearised(state);
    let of_channel = |channel: usize| {
        let fits = WalkFits::new(case, channel, state.noise[channel], &residual, &nuisances);
        [Walk::Rate, Walk::Flicker].into_iter().map(|walk| fits.fit(walk).fall).fold(0.0, f64::max)
    };
    hypothesis.gyros.gyros().map(|gyro| of_channel(gyro.index())).sum()
}
