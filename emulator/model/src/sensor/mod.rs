//! The absolute sensors, as their data come to ground: the Fine Sun Sensor, the slit star
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

#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SensorNumbers {
    pub fss: Fss,
    pub sse: Sse,
}
