//! The transfer function bends to one side: a scale-factor error that grows with the rate (IEEE Std 528, nonlinearity;
//! IEEE Std 1431 for Coriolis gyros).

use super::{EffectInputs, GyroEffect, GyroSubStep};
use crate::units::PPM;

effect! {
    /// A quadratic term of the sensed rate.
    pub struct ScaleFactorQuadratic ("scale-factor-quadratic", "quadratic scale factor") {
        /// Sensed rate lower by ppm·10⁻⁶ · ω_in²/full scale; full scale is 720″/s, or the largest rate of a described unit.
        ppm: 0.0, -5000.0..=5000.0, "ppm";
    }
    amplitudes: [{ per_day: 5000.0, per_k: 5000.0 }],
    paper: "0",
    source: "IEEE Std 528, 1431",
}

impl GyroEffect for ScaleFactorQuadratic {
    type State = ();

    #[inline]
    fn apply(&self, _state: &mut (), head: &mut GyroSubStep, surroundings: &EffectInputs) {
        let length_s = surroundings.step.length_s;
        if self.ppm == 0.0 || length_s == 0.0 {
            return;
        }
        let share = head.input_arcsec / length_s / surroundings.full_scale_arcsec_s;
        head.added_arcsec -= self.ppm * PPM * share * head.input_arcsec;
    }
}
