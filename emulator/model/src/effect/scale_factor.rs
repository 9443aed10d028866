//! Scale factor: arcsec per count (Casteren §3.2, table 1).

use super::{EffectInputs, GyroEffect, GyroSubStep};
use crate::units::PPM;

effect! {
    /// A departure of SF from the calibration.
    pub struct ScaleFactor ("scale-factor", "scale factor") {
        /// SF is multiplied by 1 + ppm·10⁻⁶.
        ppm: 0.0, -50000.0..=50000.0, "ppm";
    }
    amplitudes: [{ per_day: 10_000.0, per_k: 1000.0 }],
    paper: "launch +-2000; ageing 40 per month; electronics temperature +12.5 per K",
    source: "Casteren §3.2, table 1",
}

impl GyroEffect for ScaleFactor {
    type State = ();

    #[inline]
    fn apply(&self, _state: &mut (), head: &mut GyroSubStep, _surroundings: &EffectInputs) {
        head.scale_factor *= 1.0 + self.ppm * PPM;
    }
}
