//! The transfer function bends (Casteren §3.2, §5, figure 7).
//!
//! Over ±720″/s the departure from the best (minimax) line is a quarter of the cubic's end value: 800 ppm bend by 0.02 %.

use super::{EffectInputs, GyroEffect, GyroSubStep};
use crate::units::PPM;

effect! {
    /// A cubic term of the sensed rate.
    pub struct ScaleFactorNonlinearity ("scale-factor-nonlinearity", "scale-factor nonlinearity") {
        /// Sensed rate lower by cubic_ppm·10⁻⁶ · full scale · (ω_in/full scale)³; full scale is 720″/s, or the largest rate of a described unit.
        cubic_ppm: 0.0, -5000.0..=5000.0, "ppm";
    }
    amplitudes: [{ per_day: 5000.0, per_k: 5000.0 }],
    paper: "800: 0.02 % from the best line",
    source: "Casteren §3.2, §5, figure 7",
}

impl GyroEffect for ScaleFactorNonlinearity {
    type State = ();

    #[inline]
    fn apply(&self, _state: &mut (), head: &mut GyroSubStep, surroundings: &EffectInputs) {
        let (length_s, full_scale_arcsec_s) = (surroundings.step.length_s, surroundings.full_scale_arcsec_s);
        if self.cubic_ppm == 0.0 || length_s == 0.0 {
            return;
        }
        let share = head.input_arcsec / length_s / full_scale_arcsec_s;
        head.added_arcsec -= self.cubic_ppm * PPM * full_scale_arcsec_s * share * share * share * length_s;
    }
}
