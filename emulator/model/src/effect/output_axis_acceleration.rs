//! Acceleration about the output axis turns the float, standard for single-degree-of-freedom gyros.

use super::{EffectInputs, GyroEffect, GyroSubStep};
use crate::attitude::MotionState;

effect! {
    /// Sensed rate in proportion to the acceleration about the output axis.
    pub struct OutputAxisAcceleration ("output-axis-acceleration", "output-axis acceleration") {
        /// Sensed rate + seconds · dω_out/dt.
        seconds: 0.0, -1.0..=1.0, "s";
    }
    amplitudes: [{ per_day: 1.0, per_k: 1.0 }],
    paper: "0",
    source: "standard for the type",
    { const NEEDS_OUTPUT_AXIS: bool = true; }
}

impl GyroEffect for OutputAxisAcceleration {
    type State = ();

    #[inline]
    fn apply(&self, _state: &mut (), head: &mut GyroSubStep, surroundings: &EffectInputs) {
        // The integral of the acceleration is the change of the rate.
        let rate = |moment: &MotionState| surroundings.axes.about_output(moment.rate_control_arcsec_s);
        head.added_arcsec += self.seconds * (rate(&surroundings.step.end) - rate(&surroundings.step.start));
    }
}
