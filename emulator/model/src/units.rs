//! Constants and conversions. Angles arcsec, time s, temperature °C, relative errors ppm.

use std::f64::consts::PI;

/// Arcsec in a radian.
pub const ARCSEC_PER_RAD: f64 = 648_000.0 / PI;
/// Arcsec in a degree.
pub const ARCSEC_PER_DEG: f64 = 3600.0;
/// Radian in a degree.
pub const RAD_PER_DEG: f64 = PI / 180.0;
/// Seconds in a day.
pub const S_PER_DAY: f64 = 86_400.0;
/// Nominal length of a sample, on-board time.
pub const HALF_SECOND_S: f64 = 0.5;
/// The same, ns.
pub const HALF_SECOND_NS: i64 = 500_000_000;
/// A relative error of 1 ppm.
pub const PPM: f64 = 1e-6;
/// Rate of the sun as seen from the earth, rad/s: 360° per 365.25 d, constant (Casteren §6).
pub const SUN_RATE_RAD_S: f64 = 2.0 * PI / (365.25 * S_PER_DAY);
/// One orbit, s; ψ' at orbital speed is 360° in this time (model.md).
pub const ORBIT_S: f64 = 6180.0;

/// On-board time at which a half second begins, since the start of the first, s.
pub fn on_board_s(half_second: u64) -> f64 {
    half_second as f64 * HALF_SECOND_S
}
