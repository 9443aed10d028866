//! White noise of the rate: the accumulated angle walks.

use geu_protocol::Gyro;

use super::{EffectInputs, EffectState, GyroEffect, GyroSubStep, Temperatures};
use crate::noise::NoiseStream;

effect! {
    /// Random walk of the angle.
    pub struct AngleRandomWalk ("angle-random-walk", "angle random walk") {
        /// Growth of the angle's deviation with the root of time.
        arcsec_per_sqrt_s: 0.0, 0.0..=100.0, "arcsec/√s";
    }
    amplitudes: [{ per_day: 100.0, per_k: 100.0 }],
    paper: "0.01",
    source: "implied by Casteren table 1",
    {
        const IS_NOISE: bool = true;
    }
}

/// The stream, and what it gave for the sample now running.
#[derive(Debug, Clone)]
pub struct State {
    stream: NoiseStream,
    rate_arcsec_s: f64,
}

impl EffectState for State {
    fn start(seed: u64, gyro: Gyro, code: &str) -> State {
        State { stream: NoiseStream::new(seed, gyro, code), rate_arcsec_s: 0.0 }
    }
}

impl GyroEffect for AngleRandomWalk {
    type State = State;

    #[inline]
    fn begin(&self, state: &mut State, _temperatures: &Temperatures, length_s: f64) {
        state.rate_arcsec_s = if self.arcsec_per_sqrt_s == 0.0 {
            0.0
        } else {
            self.arcsec_per_sqrt_s * state.stream.standard_normal() / length_s.sqrt()
        };
    }

    #[inline]
    fn apply(&self, state: &mut State, head: &mut GyroSubStep, surroundings: &EffectInputs) {
        head.added_arcsec += state.rate_arcsec_s * surroundings.step.length_s;
    }
}
