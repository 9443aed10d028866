//! Random drift: the drift rate walks (Casteren §3.1, table 1: 3.6″/h over 30 min, taken as 3 sigma).
//!
//! Drawn exactly for any length T of the half second: the change of the rate is σ√T·z₁, and the angle gained beside
//! rate × T is T·(z₁/2 + z₂/√12) times σ√T, the integral of the walk. With a correlation time τ the rate first decays
//! by exp(−T/τ) and the walk's variance is τ(1 − exp(−2T/τ))/2 instead of T.

use geu_protocol::Gyro;

use super::{Amplitude, Effect, EffectSpec, Head, HeadLaw, Surroundings};
use crate::noise::Stream;
use crate::number::numbers;

numbers! {
    /// Random walk of the drift rate.
    pub struct DriftRandomWalk {
        /// Growth of the drift rate's deviation with the root of time.
        arcsec_per_s_per_sqrt_s: 0.0, 0.0..=1.0;
        /// Correlation time; inf is a pure walk, which is right for hours; 10 000 s keeps sigma at 2″/h.
        correlation_time_s: (f64::INFINITY), 1.0..=f64::INFINITY;
    }
}

impl Effect for DriftRandomWalk {
    const SPEC: EffectSpec = EffectSpec {
        code: "drift-random-walk",
        title: "drift random walk",
        amplitudes: &[Amplitude { per_day: 1.0, per_k: 1.0 }],
        paper: "3.6 arcsec/h (3 sigma) over 30 min: 8e-6",
        source: "Casteren §3.1, table 1",
    };
}

/// The walk so far.
#[derive(Debug, Clone)]
pub struct State {
    stream: Stream,
    rate_arcsec_s: f64,
    /// Mean rate over the half second now running.
    mean_arcsec_s: f64,
}

impl HeadLaw for DriftRandomWalk {
    type State = State;

    fn start(seed: u64, gyro: Gyro) -> State {
        State { stream: Stream::new(seed, gyro, Self::SPEC.code), rate_arcsec_s: 0.0, mean_arcsec_s: 0.0 }
    }

    #[inline]
    fn begin(&self, state: &mut State, length_s: f64) {
        if self.arcsec_per_s_per_sqrt_s == 0.0 && state.rate_arcsec_s == 0.0 {
            state.mean_arcsec_s = 0.0;
            return;
        }
        let (decay, variance_s) = if self.correlation_time_s.is_finite() {
            let decay = libm::exp(-length_s / self.correlation_time_s);
            (decay, self.correlation_time_s * (1.0 - decay * decay) / 2.0)
        } else {
            (1.0, length_s)
        };
        let sigma = self.arcsec_per_s_per_sqrt_s * variance_s.sqrt();
        let (end, between) = (state.stream.standard_normal(), state.stream.standard_normal());
        let before = state.rate_arcsec_s;
        state.rate_arcsec_s = before * decay + sigma * end;
        state.mean_arcsec_s = before * (1.0 + decay) / 2.0 + sigma * (end / 2.0 + between / 12f64.sqrt());
    }

    #[inline]
    fn apply(&self, state: &mut State, head: &mut Head, surroundings: &Surroundings) {
        head.drift_arcsec += state.mean_arcsec_s * surroundings.step.length_s;
    }
}
