//! Attitude controller on board: samples in, a torque out.
//!
//! Equation 3 converts counts to increments, which give an attitude; a proportional-derivative controller returns the
//! spacecraft to its attitude at the start. The gyros are its only sensors: it cannot see their errors.

use geu_calibration::{GyroSelection, PriorCalibration, Tracker};
use geu_model::units::ARCSEC_PER_RAD;
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::Sample;
use geu_recording::ReceivedSample;
use nalgebra::{UnitQuaternion, Vector3};

use crate::spacecraft::INERTIA_KG_M2;

/// The loop's natural frequency: slow against the 1 s from a motion to the torque that answers it, rad/s.
const BANDWIDTH_RAD_S: f64 = 0.15;
/// Critical damping.
const DAMPING: f64 = 1.0;
/// Share of a new rate in the filtered rate: a count of 1″ in a sample interval is a rate of 2″/s, which the torque must not follow.
const RATE_SHARE: f64 = 0.3;

/// The control loop.
pub struct AttitudeController {
    tracker: Tracker,
    rate_rad_s: Vector3<f64>,
    /// Estimated pointing error about the control axes.
    pub error_rad: Vector3<f64>,
}

impl AttitudeController {
    /// A controller that holds the attitude of the start with the selected gyros.
    pub fn new(prior: &PriorCalibration, gyros: GyroSelection) -> AttitudeController {
        AttitudeController {
            tracker: Tracker::new(prior, gyros, UnitQuaternion::identity()),
            rate_rad_s: Vector3::zeros(),
            error_rad: Vector3::zeros(),
        }
    }

    /// Processes a sample, and returns its events.
    pub fn push(&mut self, sample: Sample) -> Vec<String> {
        let row = ReceivedSample { time: None, is_received: false, sample, has_clock: true };
        let Some(track) = self.tracker.push(&row) else { return vec![] };
        self.error_rad = track.attitude.scaled_axis();
        if let Some(increment) = track.increment_control_arcsec {
            let rate = Vector3::from(increment) / (ARCSEC_PER_RAD * SAMPLE_INTERVAL_S);
            self.rate_rad_s += (rate - self.rate_rad_s) * RATE_SHARE;
        }
        track.events.iter().map(ToString::to_string).collect()
    }

    /// The torque for the estimated error and rate.
    pub fn torque_n_m(&self) -> Vector3<f64> {
        let acceleration = self.error_rad * BANDWIDTH_RAD_S + self.rate_rad_s * (2.0 * DAMPING);
        -acceleration.component_mul(&Vector3::from(INERTIA_KG_M2)) * BANDWIDTH_RAD_S
    }
}
