//! Bias drift: a torque on the float without rotation (Casteren §3.1, table 1).

use super::{EffectInputs, GyroEffect, GyroSubStep};

effect! {
    /// A departure of D from the calibration.
    pub struct Drift ("drift", "bias drift") {
        /// Added to D, so counts fall.
        arcsec_per_h: 0.0, -36000.0..=36000.0, "arcsec/h";
    }
    amplitudes: [{ per_day: 36_000.0, per_k: 3600.0 }],
    paper: "at most 1.5 deg/h; changes less than 6 arcsec/h in 2 weeks, a ramp of 0.4 arcsec/h per day",
    source: "Casteren §3.1, table 1",
}

impl GyroEffect for Drift {
    type State = ();

    #[inline]
    fn apply(&self, _state: &mut (), head: &mut GyroSubStep, surroundings: &EffectInputs) {
        head.drift_arcsec += self.arcsec_per_h / 3600.0 * surroundings.step.length_s;
    }
}
