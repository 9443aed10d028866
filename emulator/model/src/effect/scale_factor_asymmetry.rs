//! The scale factor differs for positive and negative rates (Casteren figure 7).

use geu_protocol::Gyro;

use super::{Amplitude, Effect, EffectInputs, EffectSpec, GyroEffect, GyroSubStep};
use crate::parameter_spec::numbers;
use crate::units::PPM;

numbers! {
    /// A scale factor of its own for positive rates.
    pub struct ScaleFactorAsymmetry {
        /// SF is multiplied by 1 + ppm·10⁻⁶ while ω_in > 0.
        ppm: 0.0, -5000.0..=5000.0, "ppm";
    }
}

impl Effect for ScaleFactorAsymmetry {
    const SPEC: EffectSpec = EffectSpec {
        code: "scale-factor-asymmetry",
        title: "scale-factor asymmetry",
        amplitudes: &[Amplitude { per_day: 5000.0, per_k: 5000.0 }],
        paper: "within the band of the nonlinearity",
        source: "Casteren figure 7",
    };
}

impl GyroEffect for ScaleFactorAsymmetry {
    type State = ();

    fn start(_seed: u64, _gyro: Gyro) {}

    #[inline]
    fn apply(&self, _state: &mut (), head: &mut GyroSubStep, _surroundings: &EffectInputs) {
        if head.input_arcsec > 0.0 {
            head.scale_factor *= 1.0 + self.ppm * PPM;
        }
    }
}
