//! Fits of a larger walk to the residual of one channel.

use std::borrow::Cow;
use std::sync::OnceLock;

use super::minimum::minimise;
use super::{GROWTH_STEP, ITERATIONS, Walk, deviance, fit_white, likeliest_white, start};
use crate::diagnosis_case::DiagnosisCase;
use crate::measured::Series;
use crate::normal_equations::Nuisance;
use crate::whitening::NoiseModel;

/// A logarithm that changes by less has converged.
const CONVERGED: f64 = 0.02;

/// A fitted walk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedNoise {
    /// The noise with it.
    pub noise: NoiseModel,
    /// 1 sigma of the natural logarithm of the growth.
    pub log_sigma: f64,
    /// Reduction of −2 ln of the likelihood from the noise before.
    pub fall: f64,
}

/// The residual of one channel with the noise of which a walk may be larger.
pub struct WalkFits<'a> {
    case: &'a DiagnosisCase<'a>,
    channel: usize,
    noise: NoiseModel,
    residual: &'a Series,
    nuisances: &'a [Nuisance],
    /// −2 ln of the likelihood, and that with the likeliest white noise.
    deviance: f64,
    with_own_white: OnceLock<f64>,
}

impl<'a> WalkFits<'a> {
    pub fn new(
        case: &'a DiagnosisCase<'a>,
        channel: usize,
        noise: NoiseModel,
        residual: &'a Series,
        nuisances: &'a [Nuisance],
    ) -> WalkFits<'a> {
        let blocks = Cow::Borrowed(&case.measured.blocks[channel][..]);
        let deviance = deviance(case, channel, blocks, residual, nuisances)(&noise);
        WalkFits { case, channel, noise, residual, nuisances, deviance, with_own_white: OnceLock::new() }
    }

    /// Fits one walk together with the white noise. A walk that is no larger than the noise has stays as it is.
    pub fn fit(&self, walk: Walk) -> FittedNoise {
        let WalkFits { case, channel, ref noise, residual, nuisances, .. } = *self;
        let deviance = deviance(case, channel, Cow::Borrowed(&case.measured.blocks[channel]), residual, nuisances);
        let Some(start) = start(case, channel, noise, walk) else {
            return FittedNoise { noise: *noise, log_sigma: f64::NAN, fall: 0.0 };
        };
        let with =
            |log_walk: f64, log_white: f64| NoiseModel { white: log_white.exp(), ..noise.with(walk, log_walk.exp()) };
        // A walk that is not likelier near its configured growth is not larger.
        let near = [0.5 * GROWTH_STEP, 2.0 * GROWTH_STEP];
        if near.iter().all(|by| deviance(&with(start + by, noise.white.ln())) >= self.deviance) {
            return FittedNoise { noise: *noise, log_sigma: f64::NAN, fall: 0.0 };
        }
        // Walk and white noise in turn until both converge: first over the whole range, then near the last value.
        let (mut log_walk, mut log_white) = (start, noise.white.ln());
        let (mut below, mut above) = (4.0, 7.0);
        for _ in 0..ITERATIONS {
            let before = log_walk;
            log_walk = minimise(log_walk - below, log_walk + above, |log_walk| deviance(&with(log_walk, log_white)));
            log_white = likeliest_white(case, channel, log_white, |log_white| deviance(&with(log_walk, log_white)));
            (below, above) = (0.5, 0.5);
            if (log_walk - before).abs() < CONVERGED {
                break;
            }
        }
        // Both likelihoods with their own white noise.
        let before =
            *self.with_own_white.get_or_init(|| deviance(&fit_white(case, channel, noise, residual, nuisances)));
        let best = deviance(&with(log_walk, log_white));
        let step = 0.1;
        let bend =
            deviance(&with(log_walk + step, log_white)) + deviance(&with(log_walk - step, log_white)) - 2.0 * best;
        let log_sigma = (2.0 * step * step / bend.max(1e-9)).sqrt();
        FittedNoise { noise: with(log_walk, log_white), log_sigma, fall: before - best }
    }
}
