//! Acceleration about the output axis turns the float, standard for single-degree-of-freedom gyros.

use geu_protocol::Gyro;

use super::{Amplitude, Effect, EffectInputs, EffectSpec, GyroEffect, GyroSubStep};
use crate::attitude::MotionState;
use crate::parameter_spec::numbers;

numbers! {
    /// Sensed rate in proportion to the acceleration about the output axis.
    pub struct OutputAxisAcceleration {
        /// Sensed rate + seconds · dω_out/dt.
        seconds: 0.0, -1.0..=1.0, "s";
    }
}

impl Effect for OutputAxisAcceleration {
    const SPEC: EffectSpec = EffectSpec {
        code: "output-axis-acceleration",
        title: "output-axis acceleration",
        amplitudes: &[Amplitude { per_day: 1.0, per_k: 1.0 }],
        paper: "0",
        source: "standard for the type",
    };
}

impl GyroEffect for OutputAxisAcceleration {
    type State = ();

    fn start(_seed: u64, _gyro: Gyro) {}

    #[inline]
    fn apply(&self, _state: &mut (), head: &mut GyroSubStep, surroundings: &EffectInputs) {
        // The integral of the acceleration is the change of the rate.
        let rate = |moment: &MotionState| surroundings.axes.about_output(moment.rate_control_arcsec_s);
        head.added_arcsec += self.seconds * (rate(&surroundings.step.end) - rate(&surroundings.step.start));
    }
}
