//! The float's motion, taken out of the counts (Casteren §3.3, figure 6).

use geu_model::package::{Axes, Calibration};
use geu_model::units::HALF_SECOND_S;
use geu_protocol::Gyro;

use crate::counts::Counts;
use crate::transfer::Transfer;

/// Rate about the output axis below which the float creeps, share of that rate with which it moves above, and speed of the
/// creep (Casteren §3.3).
const THRESHOLD_ARCSEC: f64 = 1.5 * HALF_SECOND_S;
const TRANSIT_SHARE: f64 = 0.01;
const CREEP_ARCSEC: f64 = 0.015 * HALF_SECOND_S;

/// Follows each float through the rates about its output axis that the counts themselves tell, and takes what its motion
/// added out of the accumulated counts. A float starts at rest in the middle, which it prefers. Rates are known to a count
/// in a half second, so the creep begins and ends a little off; where a stop is, is exact.
pub(super) fn take_out(
    counts: &mut Counts,
    transfer: &Transfer,
    calibrations: &[Calibration; 4],
    clearance_arcsec: &[f64; 4],
) {
    let mut float_arcsec = [0.0f64; 4];
    let mut before = std::array::from_fn(|gyro| counts.accumulated[gyro][0]);
    for node in 1..=counts.len() {
        let now: [f64; 4] = std::array::from_fn(|gyro| counts.accumulated[gyro][node]);
        let turned = transfer.about_control_arcsec(std::array::from_fn(|gyro| now[gyro] - before[gyro]), 1.0);
        before = now;
        for gyro in Gyro::ALL {
            let own = gyro as usize;
            let (float, stop) = (&mut float_arcsec[own], 0.5 * clearance_arcsec[own]);
            let about_output = Axes::of(gyro).about_output(turned);
            *float = if about_output.abs() >= THRESHOLD_ARCSEC {
                *float + TRANSIT_SHARE * about_output
            } else {
                *float - float.clamp(-CREEP_ARCSEC, CREEP_ARCSEC)
            }
            .clamp(-stop, stop);
            counts.accumulated[own][node] -= *float / calibrations[own].scale_factor;
        }
    }
}
