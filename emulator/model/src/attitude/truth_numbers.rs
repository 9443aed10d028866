//! Configuration of an external truth, which a simulator reports during the run.

use crate::parameter_spec::numbers;

numbers! {
    /// Parameters of an external truth.
    pub struct TruthNumbers {
        /// A faster turn between two samples is a jump of the attitude, not motion. The default is over five times the
        /// range of a gyro, 18.2 deg/s (32767 arcsec in 0.5 s), so that every gyro saturates before.
        max_rate_deg_s: 100.0, 0.01..=3600.0, "°/s";
        /// At a pace of its own the unit begins so long after the first sample, wall clock, and stays so far behind the
        /// simulator: a sample that is later by less is on time. 0 is right for a simulator that reports ahead of time.
        start_delay_s: 0.1, 0.0..=10.0, "s";
        /// Angle from the inertial frame's Z axis to the north ecliptic pole, about X; psi depends on it. 23.4392911 for an
        /// equatorial frame of J2000, 0 for an ecliptic one.
        obliquity_deg: 23.4392911, -180.0..=180.0, "°";
    }
}
