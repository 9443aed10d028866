//! Walks that are larger than configured: noise that the data speak of, in the place of effects or beside them.

use rayon::prelude::*;

use crate::bank::HypothesisFamily;
use crate::hypothesis::Hypothesis;
use crate::measured::{CHANNELS, TIMING};
use crate::noise::{self, Walk};
use crate::null::Thresholds;
use crate::state::{DiagnosisCase, ModelState};
use crate::whitening::NoiseModel;

use super::selected::{Explained, NoiseFound, TOGETHER_CHI2};

impl Explained {
    /// Lets walks be larger than configured where that pays, the one that pays most first.
    pub(super) fn free_noise(&mut self, case: &DiagnosisCase, thresholds: &Thresholds) {
        let questions: Vec<(usize, Walk)> = (0..TIMING)
            .flat_map(|channel| [(channel, Walk::Angle), (channel, Walk::Rate)])
            .chain([(TIMING, Walk::Angle)])
            .collect();
        for _ in 0..questions.len() {
            let (residual, nuisances) = case.linearised(&mut self.state);
            let open = questions.par_iter().filter(|(channel, walk)| {
                let is_taken = |found: &NoiseFound| (found.channel, found.walk) == (*channel, *walk);
                !self.noise.iter().any(is_taken) && case.measured.blocks[*channel].iter().any(|block| block.is_good)
            });
            let fits = open.map(|&(channel, walk)| NoiseFound {
                channel,
                walk,
                fitted: noise::fit(case, channel, &self.state.noise[channel], walk, &residual, &nuisances),
            });
            // One that would rather be smaller says nothing of the others.
            let is_larger = |found: &NoiseFound| {
                found.fitted.noise.walk(found.walk) > self.state.noise[found.channel].walk(found.walk)
            };
            // Walks of one kind on several gyros have one cause: only the first is asked for everything.
            let spare = |found: &NoiseFound| {
                let is_further = self.noise.iter().any(|other| other.walk == found.walk && other.channel != TIMING);
                found.fitted.fall - if is_further { TOGETHER_CHI2 } else { thresholds.of(HypothesisFamily::NOISE) }
            };
            let larger: Vec<NoiseFound> = fits.filter(is_larger).collect();
            match larger.into_iter().max_by(|a, b| spare(a).total_cmp(&spare(b))) {
                Some(found) if spare(&found) > 0.0 => {
                    self.take_walk(found);
                }
                _ => break,
            }
        }
        self.free_together(case, thresholds);
        self.state.noise = self.fitted_white(case);
        self.normal = case.fit(&mut self.state);
    }

    fn take_walk(&mut self, found: NoiseFound) {
        self.state.noise[found.channel] = found.fitted.noise;
        self.noise.push(found);
    }

    /// Lets a walk be larger on all gyros that have it as configured, where it pays on none of them alone but on all together.
    fn free_together(&mut self, case: &DiagnosisCase, thresholds: &Thresholds) {
        for walk in [Walk::Rate, Walk::Angle] {
            let (residual, nuisances) = case.linearised(&mut self.state);
            let is_open = |channel: &usize| {
                !self.noise.iter().any(|found| (found.channel, found.walk) == (*channel, walk))
                    && case.measured.blocks[*channel].iter().any(|block| block.is_good)
            };
            let fits: Vec<NoiseFound> = (0..TIMING)
                .filter(is_open)
                .map(|channel| NoiseFound {
                    channel,
                    walk,
                    fitted: noise::fit(case, channel, &self.state.noise[channel], walk, &residual, &nuisances),
                })
                .filter(|found| found.fitted.noise.walk(walk) > self.state.noise[found.channel].walk(walk))
                .collect();
            let fall: f64 = fits.iter().map(|found| found.fitted.fall).sum();
            // A question more, and a number more for each further gyro.
            let more = TOGETHER_CHI2 * fits.len().saturating_sub(1) as f64;
            if fits.len() > 1 && fall > thresholds.of(HypothesisFamily::NOISE) + more {
                fits.into_iter().for_each(|found| self.take_walk(found));
            }
        }
    }

    /// The noise with its white part as what is left tells it.
    pub(super) fn fitted_white(&mut self, case: &DiagnosisCase) -> [NoiseModel; CHANNELS] {
        let (residual, nuisances) = case.linearised(&mut self.state);
        let white = |channel: usize| noise::fit_white(case, channel, &self.state.noise[channel], &residual, &nuisances);
        let all: Vec<_> = (0..CHANNELS).into_par_iter().map(white).collect();
        std::array::from_fn(|channel| all[channel])
    }

    /// Takes back the walks of these gyros: they are as configured.
    pub fn reset_noise(&mut self, case: &DiagnosisCase, gyros: &[bool; 4]) {
        let (gone, kept): (Vec<NoiseFound>, _) =
            self.noise.iter().partition(|found| gyros.get(found.channel) == Some(&true));
        self.noise = kept;
        for found in &gone {
            let noise = &mut self.state.noise[found.channel];
            *noise = noise.with(found.walk, found.configured(case.believed));
        }
        if !gone.is_empty() {
            self.normal = case.fit(&mut self.state);
        }
    }
}

/// What a larger walk of the rate does in the place of a change, on its gyros.
pub(super) fn walked(case: &DiagnosisCase, state: &mut ModelState, change: &Hypothesis) -> f64 {
    if change.amplitude.is_of_unit() {
        return 0.0;
    }
    let (residual, nuisances) = case.linearised(state);
    let of = |channel: usize| {
        noise::fit(case, channel, &state.noise[channel], Walk::Rate, &residual, &nuisances).fall.max(0.0)
    };
    (0..TIMING).filter(|&channel| change.gyros[channel]).map(of).sum()
}
