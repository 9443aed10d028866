//! The input axis points beside its control axis (Casteren §3.4, eq 2).

use super::{EffectInputs, GyroEffect, GyroSubStep};
use crate::units::ARCSEC_PER_RAD;

effect! {
    /// A departure of the input axis from the calibration: added to the off-axis terms of the gyro's row of M. The
    /// term along the gyro's own axis stays unity, so its number must stay 0.
    pub struct Misalignment ("misalignment", "misalignment") {
        /// Projection of the input axis on X.
        x_arcsec: 0.0, -3600.0..=3600.0, "arcsec";
        /// Projection of the input axis on Y.
        y_arcsec: 0.0, -3600.0..=3600.0, "arcsec";
        /// Projection of the input axis on Z.
        z_arcsec: 0.0, -3600.0..=3600.0, "arcsec";
    }
    amplitudes: [{ per_day: 3600.0, per_k: 3600.0 }, { per_day: 3600.0, per_k: 3600.0 }, { per_day: 3600.0, per_k: 3600.0 }],
    paper: "an arcminute after launch",
    source: "Casteren §3.4",
}

impl GyroEffect for Misalignment {
    type State = ();

    #[inline]
    fn apply(&self, _state: &mut (), head: &mut GyroSubStep, surroundings: &EffectInputs) {
        let [x, y, z] = surroundings.step.angle_control_arcsec;
        head.input_arcsec += (self.x_arcsec * x + self.y_arcsec * y + self.z_arcsec * z) / ARCSEC_PER_RAD;
    }
}
