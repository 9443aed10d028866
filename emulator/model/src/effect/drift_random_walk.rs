//! Random drift: the drift rate walks (Casteren §3.1, table 1: 3.6″/h over 30 min, taken as 3 sigma).

use geu_protocol::Gyro;

use super::{EffectInputs, EffectState, GyroEffect, GyroSubStep, Temperatures};
use crate::noise::{GaussMarkov, NoiseStream};

effect! {
    /// Random walk of the drift rate.
    pub struct DriftRandomWalk ("drift-random-walk", "drift random walk") {
        /// Growth of the drift rate's deviation with the root of time.
        arcsec_per_s_per_sqrt_s: 0.0, 0.0..=1.0, "arcsec/s/√s";
        /// Correlation time; inf is a pure walk, which is right for hours; 10 000 s keeps sigma at 2″/h.
        correlation_time_s: (f64::INFINITY), 1.0..=f64::INFINITY, "s", TimeConstant;
    }
    amplitudes: [{ per_day: 1.0, per_k: 1.0 }],
    paper: "3.6 arcsec/h (3 sigma) over 30 min: 8e-6",
    source: "Casteren §3.1, table 1",
    {
        const IS_NOISE: bool = true;
    }
}

/// Accumulated walk.
#[derive(Debug, Clone)]
pub struct State {
    stream: NoiseStream,
    rate_arcsec_s: GaussMarkov,
    /// Mean rate over the sample interval now running.
    mean_arcsec_s: f64,
}

impl EffectState for State {
    fn start(seed: u64, gyro: Gyro, code: &str) -> State {
        State { stream: NoiseStream::new(seed, gyro, code), rate_arcsec_s: GaussMarkov(0.0), mean_arcsec_s: 0.0 }
    }
}

impl GyroEffect for DriftRandomWalk {
    type State = State;

    #[inline]
    fn begin(&self, state: &mut State, _temperatures: &Temperatures, length_s: f64) {
        let State { stream, rate_arcsec_s, mean_arcsec_s } = state;
        *mean_arcsec_s = if self.arcsec_per_s_per_sqrt_s == 0.0 && rate_arcsec_s.0 == 0.0 {
            0.0
        } else {
            rate_arcsec_s.advance(self.arcsec_per_s_per_sqrt_s, self.correlation_time_s, length_s, stream)
        };
    }

    #[inline]
    fn apply(&self, state: &mut State, head: &mut GyroSubStep, surroundings: &EffectInputs) {
        head.drift_arcsec += state.mean_arcsec_s * surroundings.step.length_s;
    }
}
