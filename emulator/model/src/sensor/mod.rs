//! The absolute sensors, as their data come to ground (model.md, Absolute sensors): the Fine Sun Sensor, the slit star
//! sensor.
//!
//! Both see the attitude itself: θ and ψ with the departure by the limit cycle, which is added to the rates and never
//! to θ and ψ, so the departure is its integral, small turns (α, β) about X and Y. With the sun at (cos θ, 0, sin θ) in
//! the control frame, that turns it to (cos(θ + β), α sin θ, sin(θ + β)): the angle in the XZ plane becomes θ + β, the
//! angle out of it α sin θ. A turn about X, the boresight, moves no star across the boresight: the star sensor sees
//! θ + β and ψ.
//!
//! Their noise depends on seed and sensor alone, never on a gyro's.
//!
//! ```
//! use geu_model::Configuration;
//! use geu_model::attitude::{LimitCycle, Motion, AttitudeProfile};
//! use geu_model::sensor::SunSensor;
//! let configuration = Configuration::reference();
//! let motion = Motion::new(AttitudeProfile::new(&configuration.scenario).unwrap(), LimitCycle::default());
//! let mut sensor = SunSensor::new(configuration.sensors.fss, configuration.seed);
//! let seen = sensor.see(&motion).unwrap();
//! assert_eq!((seen.theta_arcsec, seen.roll_arcsec), (324_000.0, 0.0));
//! ```

mod fss;
mod sse;

pub use fss::{Fss, SunAngles, SunSensor};
pub use sse::{SLITS, SlitFix, Sse, Star, StarSensor};

use crate::number::ParameterSet;

#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SensorNumbers {
    pub fss: Fss,
    pub sse: Sse,
}

impl SensorNumbers {
    /// Keys in the configuration, with what each is.
    pub const KEYS: [(&'static str, &'static str); 2] = [
        ("fss", "Fine Sun Sensor: two axes, 2 Hz (Casteren §1, §6)"),
        ("sse", "slit star sensor: fixes at the reference times (Casteren §5)"),
    ];

    /// The numbers of the sensor at `index` of [`SensorNumbers::KEYS`].
    pub fn numbers(&self, index: usize) -> &dyn ParameterSet {
        let Self { fss, sse } = self;
        [fss as &dyn ParameterSet, sse][index]
    }

    /// The numbers of the sensor at `index` of [`SensorNumbers::KEYS`].
    pub fn numbers_mut(&mut self, index: usize) -> &mut dyn ParameterSet {
        let Self { fss, sse } = self;
        let [first, second] = [fss as &mut dyn ParameterSet, sse];
        if index == 0 { first } else { second }
    }
}
