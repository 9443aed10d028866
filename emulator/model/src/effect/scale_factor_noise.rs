//! The scale factor is noisy: white noise of the rate in proportion to the rate (IEEE Std 528; IEEE Std 952 for fibre gyros).

use geu_protocol::Gyro;

use super::{EffectInputs, EffectState, GyroEffect, GyroSubStep, Temperatures};
use crate::noise::NoiseStream;
use crate::units::PPM;

effect! {
    /// White noise of the scale factor.
    pub struct ScaleFactorNoise ("scale-factor-noise", "scale-factor noise") {
        /// White rate noise of density ppm_sqrt_s·10⁻⁶ · |ω_in| per √s.
        ppm_sqrt_s: 0.0, 0.0..=1e5, "ppm·√s";
    }
    amplitudes: [{ per_day: 1e5, per_k: 1e5 }],
    paper: "0",
    source: "IEEE Std 528, 952",
    {
        const IS_NOISE: bool = true;
    }
}

/// The stream, and the relative error that it gave for the sample now running.
#[derive(Debug, Clone)]
pub struct State {
    stream: NoiseStream,
    relative_error: f64,
}

impl EffectState for State {
    fn start(seed: u64, gyro: Gyro, code: &str) -> State {
        State { stream: NoiseStream::new(seed, gyro, code), relative_error: 0.0 }
    }
}

impl GyroEffect for ScaleFactorNoise {
    type State = State;

    #[inline]
    fn begin(&self, state: &mut State, _temperatures: &Temperatures, length_s: f64) {
        state.relative_error = if self.ppm_sqrt_s == 0.0 {
            0.0
        } else {
            self.ppm_sqrt_s * PPM * state.stream.standard_normal() / length_s.sqrt()
        };
    }

    #[inline]
    fn apply(&self, state: &mut State, head: &mut GyroSubStep, _surroundings: &EffectInputs) {
        head.added_arcsec += state.relative_error * head.input_arcsec;
    }
}
