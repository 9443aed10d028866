//! Scale factor: arcsec per count (Casteren §3.2, table 1).

use geu_protocol::Gyro;

use super::{Amplitude, Effect, EffectInputs, EffectSpec, GyroEffect, GyroSubStep};
use crate::parameter_spec::numbers;
use crate::units::PPM;

numbers! {
    /// A departure of SF from the calibration.
    pub struct ScaleFactor {
        /// SF is multiplied by 1 + ppm·10⁻⁶.
        ppm: 0.0, -50000.0..=50000.0, "ppm";
    }
}

impl Effect for ScaleFactor {
    const SPEC: EffectSpec = EffectSpec {
        code: "scale-factor",
        title: "scale factor",
        amplitudes: &[Amplitude { per_day: 10_000.0, per_k: 1000.0 }],
        paper: "launch +-2000; ageing 40 per month; electronics temperature +12.5 per K",
        source: "Casteren §3.2, table 1",
    };
}

impl GyroEffect for ScaleFactor {
    type State = ();

    fn start(_seed: u64, _gyro: Gyro) {}

    #[inline]
    fn apply(&self, _state: &mut (), head: &mut GyroSubStep, _surroundings: &EffectInputs) {
        head.scale_factor *= 1.0 + self.ppm * PPM;
    }
}
