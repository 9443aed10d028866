//! Drift that follows the sensor temperature, which the heater holds at 70 °C (Casteren §2, §3.1).

use geu_protocol::Gyro;

use super::{Amplitude, Effect, EffectInputs, EffectSpec, GyroEffect, GyroSubStep};
use crate::parameter_spec::numbers;
use crate::temperature::SENSOR_NOMINAL_C;

numbers! {
    /// Drift in proportion to the sensor's departure from 70 °C.
    pub struct DriftSensorTemperature {
        /// Added to D for each K above 70 °C.
        arcsec_per_h_per_k: 0.0, -3600.0..=3600.0, "arcsec/h/K";
    }
}

impl Effect for DriftSensorTemperature {
    const SPEC: EffectSpec = EffectSpec {
        code: "drift-sensor-temperature",
        title: "drift with sensor temperature",
        amplitudes: &[Amplitude { per_day: 3600.0, per_k: 3600.0 }],
        paper: "0",
        source: "Casteren §2, §3.1",
    };
}

impl GyroEffect for DriftSensorTemperature {
    type State = ();

    fn start(_seed: u64, _gyro: Gyro) {}

    #[inline]
    fn apply(&self, _state: &mut (), head: &mut GyroSubStep, surroundings: &EffectInputs) {
        let excess_k = surroundings.temperatures.sensor_c - SENSOR_NOMINAL_C;
        head.drift_arcsec += self.arcsec_per_h_per_k * excess_k / 3600.0 * surroundings.step.length_s;
    }
}
