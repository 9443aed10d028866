//! Rates about input and spin axes together turn a float of unequal inertias, standard for the type.

use super::{EffectInputs, GyroEffect, GyroSubStep};
use crate::units::ARCSEC_PER_RAD;

effect! {
    /// Sensed rate in proportion to the product of input and spin rates.
    pub struct Anisoinertia ("anisoinertia", "anisoinertia") {
        /// Sensed rate + seconds · ω_in (arcsec/s) · ω_spin (rad/s).
        seconds: 0.0, -1.0..=1.0, "s";
    }
    amplitudes: [{ per_day: 1.0, per_k: 1.0 }],
    paper: "0",
    source: "standard for the type",
    { const NEEDS_OUTPUT_AXIS: bool = true; }
}

impl GyroEffect for Anisoinertia {
    type State = ();

    #[inline]
    fn apply(&self, _state: &mut (), head: &mut GyroSubStep, surroundings: &EffectInputs) {
        let step = surroundings.step;
        if self.seconds == 0.0 || step.length_s == 0.0 {
            return;
        }
        let spin_rad_s = surroundings.axes.about_spin(step.angle_control_arcsec) / ARCSEC_PER_RAD / step.length_s;
        head.added_arcsec += self.seconds * head.input_arcsec * spin_rad_s;
    }
}
