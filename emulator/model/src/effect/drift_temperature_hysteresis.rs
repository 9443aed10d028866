//! Drift that depends on the direction in which the temperature came: hysteresis (IEEE Std 528; IEEE Std 1431 for Coriolis
//! gyros).
//!
//! A play of the given width follows the electronics temperature. It starts in its middle; once the temperature has taken
//! it up, the drift has the sign of the temperature's direction.

use super::{EffectInputs, GyroEffect, GyroSubStep, Temperatures};

effect! {
    /// Drift with the direction of the electronics temperature.
    pub struct DriftTemperatureHysteresis ("drift-temperature-hysteresis", "drift hysteresis with temperature") {
        /// Added to D at the warm end of the play; at the cold end subtracted.
        arcsec_per_h: 0.0, -3600.0..=3600.0, "arcsec/h";
        /// Width of the play of the electronics temperature.
        width_k: 0.2, 0.001..=100.0, "K", Width;
    }
    amplitudes: [{ per_day: 3600.0, per_k: 3600.0 }],
    paper: "0",
    source: "IEEE Std 528, 1431",
}

/// The play, which also follows the temperature while the effect is absent.
#[derive(Debug, Clone, Default)]
pub struct State {
    /// Temperature of its middle, °C.
    middle_c: Option<f64>,
    /// Drift over the sample interval now running.
    arcsec_per_s: f64,
}

impl GyroEffect for DriftTemperatureHysteresis {
    type State = State;

    #[inline]
    fn begin(&self, state: &mut State, temperatures: &Temperatures, _length_s: f64) {
        let (half_k, now_c) = (0.5 * self.width_k, temperatures.electronics_c);
        let middle_c = state.middle_c.unwrap_or(now_c).max(now_c - half_k).min(now_c + half_k);
        state.middle_c = Some(middle_c);
        state.arcsec_per_s = self.arcsec_per_h * (now_c - middle_c) / (3600.0 * half_k);
    }

    #[inline]
    fn apply(&self, state: &mut State, head: &mut GyroSubStep, surroundings: &EffectInputs) {
        head.drift_arcsec += state.arcsec_per_s * surroundings.step.length_s;
    }
}
