//! Reconstruction: a Kalman filter that re-estimates attitude and transfer functions each sample between attitude
//! fixes, and a smoother over the same history (Casteren §3).
//!
//! *States.* Attitude error about inertial axes; drift, scale factor and two misalignments of each of the three gyros in
//! use; the star sensor's two systematic errors; the settled turn of the package for each degree of θ. The errors are those of
//! a nominal attitude, integrated from the counts by equation 3 and corrected at every fix (a multiplicative filter). Taken
//! about inertial axes an attitude error stands still but for what wrong parameters add, so the transition is the identity
//! but for three rows, and 24 h are a matter of a tenth of a second.
//!
//! *Frames.* What is integrated is the attitude of the package; the control frame, in which the sensors measure and
//! the results are given, is the package turned back by the thermal misalignment δ = k·g: g follows θ − 90° with a first-order lag (§3.4,
//! §5.3), k is a state. That takes the place of three thermal terms in M, and of a guess at their size.
//!
//! *Bounded errors.* A count is a difference of rounded angles, and the float moves between its stops: neither
//! accumulates. Both are noise of the gyros' angle at a fix and at an output, never a noise of the rate. The float
//! motion by its model is subtracted from the counts first (§3.3).
//!
//! *Numbers.* Covariances are updated in Joseph's form, one component of a fix at a time. The smoother is that of Rauch,
//! Tung and Striebel in the form of Bryson and Frazier (Bierman 1973), which inverts no covariance.
//!
//! ```
//! use geu_calibration::filter::{AttitudeFix, FilterNoise, attitude_of, reconstruct};
//! use geu_calibration::{AccumulatedCounts, GyroSet};
//! use geu_model::package::Calibration;
//!
//! let mut counts = AccumulatedCounts::starting_at(0);
//! // 100 s at 10″/s about Z.
//! for sample in 1..=200 {
//!     counts.push(f64::from(sample) * 0.5, &[0.0, 0.0, 5.0, 5.0], 20.0);
//! }
//! let start = AttitudeFix::star(0.0, 90.0, 0.0, 0.5);
//! let mut last = None;
//! reconstruct(&counts, &[Calibration::default(); 4], GyroSet::WithZa, &FilterNoise::PAPER, &[start], |node, own| {
//!     if node == 200 {
//!         last = Some(own.smoothed.attitude);
//!     }
//! })
//! .unwrap();
//! let turned = attitude_of(std::f64::consts::FRAC_PI_2, 0.0, 0.0).rotation_to(&last.unwrap());
//! assert!((turned.angle() * 206_264.806 - 1000.0).abs() < 1e-3);
//! ```

mod covariance;
mod fix;
mod gaps;
mod kalman;
mod noise;
mod survey_day;
mod whiteness;

pub use fix::{AttitudeFix, FixMeasurement, SensitiveAxis, attitude_of};
pub use noise::FilterNoise;
pub use survey_day::{
    AttitudeErrorStats, EffectCost, REQUIREMENT_ARCSEC, SurveyDay, SurveyDayError, SurveyDayReport,
    checkout_calibration, cost_of_effects, survey_day, with_errors,
};
pub use whiteness::{Whiteness, chi2_survival};

use geu_model::package::Calibration;
use nalgebra::{Matrix3, UnitQuaternion};

use self::gaps::fill_gaps;
use self::kalman::Filter;
use crate::counts::AccumulatedCounts;
use crate::effects::{self, MotionStep};
use crate::transfer::{GyroSet, Transfer};

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FilterError {
    /// More gyros than three axes take.
    #[error("gyros in use: expected X, Y and one of ZA and ZB, got all four")]
    FourGyros,
    /// Counts without a sample.
    #[error("counts: expected at least 1 sample, got none")]
    NoCounts,
    /// No fix to start from.
    #[error("fixes: expected one of the whole attitude within 0…{end_s} s, got {got} fixes, none of them such")]
    NoAttitude { end_s: f64, got: usize },
    #[error("fix {index} at {t_s} s: expected finite numbers and sigmas above 0")]
    Fix { index: usize, t_s: f64 },
}

/// The estimate at a node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StateEstimate {
    /// Control frame to inertial.
    pub attitude: UnitQuaternion<f64>,
    /// Covariance of the attitude about the control axes, arcsec², with the bounded errors of the gyros.
    pub covariance_control_arcsec2: Matrix3<f64>,
    /// D of each gyro, in wire order.
    pub drift_arcsec_per_half_s: [f64; 4],
    /// Sigma of D.
    pub drift_sigma_arcsec_per_half_s: [f64; 4],
    /// SF of each gyro, in wire order.
    pub scale_factor: [f64; 4],
    /// Sigma of SF.
    pub scale_factor_sigma: [f64; 4],
}

impl StateEstimate {
    /// Sigma of the attitude about each control axis, arcsec.
    pub fn sigma_control_arcsec(&self) -> [f64; 3] {
        self.covariance_control_arcsec2.diagonal().map(f64::sqrt).into()
    }

    /// Sigma of the boresight's direction, arcsec: across it, both ways together.
    pub fn boresight_sigma_arcsec(&self) -> f64 {
        (self.covariance_control_arcsec2[(1, 1)] + self.covariance_control_arcsec2[(2, 2)]).sqrt()
    }
}

/// The estimates at one node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NodeEstimates {
    /// From the fixes until then.
    pub filtered: StateEstimate,
    /// From all fixes.
    pub smoothed: StateEstimate,
}

/// One component of a fix against its prediction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innovation {
    /// Index of the fix's axis.
    pub component: usize,
    /// Residual over its predicted sigma: standard normal and independent if the model holds.
    pub normalised: f64,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Reconstruction {
    /// Every component of every fix used, in order of time.
    pub innovations: Vec<Innovation>,
    pub whiteness: Whiteness,
    /// Fixes outside the counts, which were not used.
    pub fixes_outside: usize,
}

/// Reconstructs attitude and transfer functions at every node of `counts`, and passes them to `visit`, the last node first. It keeps the
/// filter's state at each fix and each 1024 nodes; a pivot clearance takes about 150 B of memory for each node besides.
///
/// Fixes may come in any order; their times are seconds since the start of the counts, and the inertial frame is theirs:
/// for [`AttitudeFix::star`] and [`AttitudeFix::sun`] the sun-referenced frame at time 0. The attitude before the first fix is carried back
/// from it by the counts.
///
/// If counts are broken for a gyro in use, its rotation is taken as its mean over the 10 s before, and is uncertain by
/// [`FilterNoise::lost_rate_arcsec_s`] about its input axis throughout; a receive time that jumps breaks no count. Once the
/// attitude is uncertain by more than a degree it is lost, and started anew at the next fix of the whole attitude.
///
/// # Errors
/// All four gyros at once, no sample, no fix of the whole attitude within them, a fix that is no number.
pub fn reconstruct(
    counts: &AccumulatedCounts,
    calibrations: &[Calibration; 4],
    in_use: GyroSet,
    noise: &FilterNoise,
    fixes: &[AttitudeFix],
    visit: impl FnMut(usize, &NodeEstimates),
) -> Result<Reconstruction, FilterError> {
    let gyros = match in_use {
        GyroSet::WithZa => [0, 1, 2],
        GyroSet::WithZb => [0, 1, 3],
        GyroSet::All => return Err(FilterError::FourGyros),
    };
    if counts.is_empty() {
        return Err(FilterError::NoCounts);
    }
    if let Some(index) = fixes.iter().position(|fix| !fix.is_sound()) {
        return Err(FilterError::Fix { index, t_s: fixes[index].t_s });
    }
    let mut at_nodes: Vec<(usize, &AttitudeFix)> =
        fixes.iter().filter_map(|fix| Some((counts.nearest(fix.t_s)?, fix))).collect();
    at_nodes.sort_by(|a, b| a.1.t_s.total_cmp(&b.1.t_s));
    let fixes_outside = fixes.len() - at_nodes.len();
    let (mut counts, lost) = fill_gaps(counts, in_use);
    if let Some(floats) =
        effects::float_motion(calibrations, &noise.clearance_arcsec, steps(&counts, calibrations, in_use))
    {
        for (sums, floats) in counts.to_mut().accumulated.iter_mut().zip(&floats) {
            sums.iter_mut().zip(floats).for_each(|(sum, float)| *sum -= float);
        }
    }
    let mut filter = Filter::start(&counts, lost, calibrations, (in_use, gyros), noise, &at_nodes)
        .ok_or(FilterError::NoAttitude { end_s: counts.end_s(), got: fixes.len() })?;
    filter.forward(&at_nodes);
    let innovations = filter.backward(visit);
    let whiteness = Whiteness::from_innovations(&innovations);
    Ok(Reconstruction { innovations, whiteness, fixes_outside })
}

/// The motion by the counts themselves.
fn steps(
    counts: &AccumulatedCounts,
    calibrations: &[Calibration; 4],
    in_use: GyroSet,
) -> impl ExactSizeIterator<Item = MotionStep> {
    let transfer = Transfer::new(calibrations, in_use);
    let of = move |node: usize| {
        let counted = std::array::from_fn(|gyro| counts.accumulated[gyro][node] - counts.accumulated[gyro][node - 1]);
        (transfer.about_control_arcsec(counted, 1.0), None)
    };
    (1..counts.len() + 1).map(of)
}

#[cfg(test)]
mod tests;
