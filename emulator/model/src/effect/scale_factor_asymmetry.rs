//! The scale factor differs for positive and negative rates (Casteren figure 7).

use super::{EffectInputs, GyroEffect, GyroSubStep};
use crate::units::PPM;

effect! {
    /// A scale factor of its own for positive rates.
    pub struct ScaleFactorAsymmetry ("scale-factor-asymmetry", "scale-factor asymmetry") {
        /// SF is multiplied by 1 + ppm·10⁻⁶ while ω_in > 0.
        ppm: 0.0, -5000.0..=5000.0, "ppm";
    }
    amplitudes: [{ per_day: 5000.0, per_k: 5000.0 }],
    paper: "within the band of the nonlinearity",
    source: "Casteren figure 7",
}

impl GyroEffect for ScaleFactorAsymmetry {
    type State = ();

    #[inline]
    fn apply(&self, _state: &mut (), head: &mut GyroSubStep, _surroundings: &EffectInputs) {
        if head.input_arcsec > 0.0 {
            head.scale_factor *= 1.0 + self.ppm * PPM;
        }
    }
}
