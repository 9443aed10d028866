//! Drift that follows the sensor temperature, which the heater holds at 70 °C (Casteren §2, §3.1).

use super::{EffectInputs, GyroEffect, GyroSubStep};
use crate::temperature::SENSOR_NOMINAL_C;

effect! {
    /// Drift in proportion to the sensor's departure from 70 °C.
    pub struct DriftSensorTemperature ("drift-sensor-temperature", "drift with sensor temperature") {
        /// Added to D for each K above 70 °C.
        arcsec_per_h_per_k: 0.0, -3600.0..=3600.0, "arcsec/h/K";
    }
    amplitudes: [{ per_day: 3600.0, per_k: 3600.0 }],
    paper: "0",
    source: "Casteren §2, §3.1",
}

impl GyroEffect for DriftSensorTemperature {
    type State = ();

    #[inline]
    fn apply(&self, _state: &mut (), head: &mut GyroSubStep, surroundings: &EffectInputs) {
        let excess_k = surroundings.temperatures.sensor_c - SENSOR_NOMINAL_C;
        head.drift_arcsec += self.arcsec_per_h_per_k * excess_k / 3600.0 * surroundings.step.length_s;
    }
}
