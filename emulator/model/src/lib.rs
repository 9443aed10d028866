//! The gyro unit's physics: pure, deterministic, and unable to fail once configured.
//!
//! [`Configuration`] is read from TOML and checked; [`GyroUnit`] steps through on-board samples, never the wall clock,
//! and returns each as a [`geu_protocol::Sample`]. The same configuration, seed and commands give the same numbers on
//! every build and host: transcendental functions come from libm.
//!
//! ```
//! use geu_model::{Configuration, GyroUnit};
//! let mut unit = GyroUnit::new(&Configuration::reference());
//! let ended = unit.end_sample();
//! assert_eq!((ended.sample.sequence, ended.sample.clock_count), (0, 500_000));
//! assert_eq!(ended.end_ns, 500_000_000);
//! ```

pub mod attitude;
pub mod configuration;
pub mod device;
pub mod effect;
pub mod fault;
mod gyro_unit;
pub mod noise;
pub mod package;
pub mod parameter_spec;
pub mod sensor;
pub mod simulation;
pub mod temperature;
pub mod time_profile;
pub mod units;

pub use configuration::Configuration;
pub use gyro_unit::{
    CommandResponse, CompletedSample, FollowedSamples, FollowingGyro, GyroUnit, InjectionRecord, MeasuredTemperatures,
    SomeSamples, SubSteps, Truth,
};
pub use package::Trace;
pub use simulation::Simulation;
