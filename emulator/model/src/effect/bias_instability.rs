//! Flicker of the drift: bias instability (IEEE Std 528; Allan deviation as in IEEE Std 952, annex).

use geu_protocol::Gyro;

use super::{EffectInputs, EffectState, GyroEffect, GyroSubStep, Temperatures};
use crate::noise::{Flicker, NoiseStream};

effect! {
    /// Flicker of the drift rate.
    pub struct BiasInstability ("bias-instability", "bias instability") {
        /// Flicker of the drift; the Allan deviation is 0.664 times this from 10 s to 10⁴ s.
        arcsec_per_h: 0.0, 0.0..=3600.0, "arcsec/h";
    }
    amplitudes: [{ per_day: 3600.0, per_k: 3600.0 }],
    paper: "0",
    source: "IEEE Std 528, 952",
    {
        const IS_NOISE: bool = true;
    }
}

/// The flicker, from the first sample interval with the effect on.
#[derive(Debug, Clone)]
pub struct State {
    stream: NoiseStream,
    flicker: Option<Flicker>,
    /// Mean drift over the sample interval now running.
    arcsec_per_s: f64,
}

impl EffectState for State {
    fn start(seed: u64, gyro: Gyro, code: &str) -> State {
        State { stream: NoiseStream::new(seed, gyro, code), flicker: None, arcsec_per_s: 0.0 }
    }
}

impl GyroEffect for BiasInstability {
    type State = State;

    #[inline]
    fn begin(&self, state: &mut State, _temperatures: &Temperatures, length_s: f64) {
        let State { stream, flicker, arcsec_per_s } = state;
        if self.arcsec_per_h == 0.0 && flicker.is_none() {
            return;
        }
        let flicker = flicker.get_or_insert_with(|| Flicker::stationary(stream));
        *arcsec_per_s = self.arcsec_per_h / 3600.0 * flicker.advance(length_s, stream);
    }

    #[inline]
    fn apply(&self, state: &mut State, head: &mut GyroSubStep, surroundings: &EffectInputs) {
        head.drift_arcsec += state.arcsec_per_s * surroundings.step.length_s;
    }
}
