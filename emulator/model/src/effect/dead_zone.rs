//! A slow rate is not sensed: lock-in of a laser gyro (IEEE Std 647), dead band of any other (IEEE Std 528).

use super::{EffectInputs, GyroEffect, GyroSubStep};

effect! {
    /// A band about zero in which no rate is sensed.
    pub struct DeadZone ("dead-zone", "dead zone") {
        /// A smaller rate about the input axis is not sensed, a larger one whole.
        arcsec_per_s: 0.0, 0.0..=1000.0, "arcsec/s";
    }
    amplitudes: [{ per_day: 1000.0, per_k: 1000.0 }],
    paper: "0",
    source: "IEEE Std 528, 647",
    {
        const FILTERS_MOTION: bool = true;
    }
}

impl GyroEffect for DeadZone {
    type State = ();

    #[inline]
    fn apply(&self, _state: &mut (), head: &mut GyroSubStep, surroundings: &EffectInputs) {
        if (head.input_arcsec + head.added_arcsec).abs() < self.arcsec_per_s * surroundings.step.length_s {
            head.added_arcsec = -head.input_arcsec;
        }
    }
}
