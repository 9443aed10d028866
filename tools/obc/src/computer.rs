//! What flies on board: samples in, a torque out.
//!
//! Counts become increments by equation 3, increments an attitude, and a proportional-derivative law turns the spacecraft back
//! to where it was at the start. The computer knows nothing but its gyros: an error of theirs it takes for the truth.

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
/// Share of a new rate in the filtered one: a count of 1″ in a sample interval is a rate of 2″/s, which the torque must not follow.
const RATE_SHARE: f64 = 0.3;

/// The control loop.
pub struct AttitudeController {
    tracker: Tracker,
    rate_rad_s: Vector3<f64>,
    /// What it believes the pointing error to be, about the control axes.
    pub error_rad: Vector3<f64>,
}

impl AttitudeController {
    /// A loop that holds the attitude of the start, by gyros in use.
    pub fn new(believed: &PriorCalibration, gyros: GyroSelection) -> AttitudeController {
        AttitudeController {
            tracker: Tracker::new(believed, gyros, UnitQuaternion::identity()),
            rate_rad_s: Vector3::zeros(),
            error_rad: Vector3::zeros(),
        }
    }

    /// Takes a sample, and tells what is worth telling.
    pub fn take(&mut self, sample: Sample) -> Vec<String> {
        let row = ReceivedSample { time: None, is_received: false, sample, has_clock: true };
        let Some(track) = self.tracker.take(&row) else { return vec![] };
        self.error_rad = track.attitude.scaled_axis();
        if let Some(increment) = track.increment_control_arcsec {
            let rate = Vector3::from(increment) / (ARCSEC_PER_RAD * SAMPLE_INTERVAL_S);
            self.rate_rad_s += (rate - self.rate_rad_s) * RATE_SHARE;
        }
        track.events.iter().map(ToString::to_string).collect()
    }

    /// The torque that answers what it knows.
    pub fn torque_n_m(&self) -> Vector3<f64> {
        let acceleration = self.error_rad * BANDWIDTH_RAD_S + self.rate_rad_s * (2.0 * DAMPING);
        -acceleration.component_mul(&Vector3::from(INERTIA_KG_M2)) * BANDWIDTH_RAD_S
    }
}
