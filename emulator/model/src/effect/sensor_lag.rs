//! The sensed rate follows the true rate with a first-order lag: the bandwidth of the sensor (IEEE Std 528; IEEE Std 1431
//! for Coriolis gyros).
//!
//! Exact for a rate that is constant over a sub-step. It starts settled on the first rate.

use super::{EffectInputs, GyroEffect, GyroSubStep};

effect! {
    /// Lag of the sensed rate.
    pub struct SensorLag ("sensor-lag", "sensor lag") {
        /// Time constant with which the sensed rate follows the rate about the input axis.
        time_constant_s: 0.0, 0.0..=10.0, "s";
    }
    amplitudes: [{ per_day: 10.0, per_k: 10.0 }],
    paper: "0",
    source: "IEEE Std 528, 1431",
    {
        const FILTERS_MOTION: bool = true;
    }
}

/// Sensed part of the rate about the input axis, arcsec/s; nothing without a lag.
pub type State = Option<f64>;

impl GyroEffect for SensorLag {
    type State = State;

    #[inline]
    fn apply(&self, state: &mut State, head: &mut GyroSubStep, surroundings: &EffectInputs) {
        let length_s = surroundings.step.length_s;
        if self.time_constant_s == 0.0 {
            *state = None;
            return;
        }
        if length_s == 0.0 {
            return;
        }
        let rate_arcsec_s = head.input_arcsec / length_s;
        let behind_arcsec_s = state.unwrap_or(rate_arcsec_s) - rate_arcsec_s;
        let caught_up = -libm::expm1(-length_s / self.time_constant_s);
        *state = Some(rate_arcsec_s + behind_arcsec_s * (1.0 - caught_up));
        head.added_arcsec += behind_arcsec_s * self.time_constant_s * caught_up;
    }
}
