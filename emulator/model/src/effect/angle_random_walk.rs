//! White noise of the rate: the accumulated angle walks.

use geu_protocol::Gyro;

use super::{Amplitude, Effect, EffectInputs, EffectSpec, GyroEffect, GyroSubStep};
use crate::noise::NoiseStream;
use crate::parameter_spec::numbers;

numbers! {
    /// Random walk of the angle.
    pub struct AngleRandomWalk {
        /// Growth of the angle's deviation with the root of time.
        arcsec_per_sqrt_s: 0.0, 0.0..=100.0, "arcsec/√s";
    }
}

impl Effect for AngleRandomWalk {
    const SPEC: EffectSpec = EffectSpec {
        code: "angle-random-walk",
        title: "angle random walk",
        amplitudes: &[Amplitude { per_day: 100.0, per_k: 100.0 }],
        paper: "0.01",
        source: "implied by Casteren table 1",
    };
    const IS_NOISE: bool = true;
}

/// The stream, and what it gave for the sample now running.
#[derive(Debug, Clone)]
pub struct State {
    stream: NoiseStream,
    rate_arcsec_s: f64,
}

impl GyroEffect for AngleRandomWalk {
    type State = State;

    fn start(seed: u64, gyro: Gyro) -> State {
        State { stream: NoiseStream::new(seed, gyro, Self::SPEC.code), rate_arcsec_s: 0.0 }
    }

    #[inline]
    fn begin(&self, state: &mut State, length_s: f64) {
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
