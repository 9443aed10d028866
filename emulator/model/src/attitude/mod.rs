//! True attitude: solar aspect angle θ and angle about the sun vector ψ over time, and the inertial rotation they mean.
//!
//! θ lies between sun vector and boresight (+X); ψ is 0 where the boresight is nearest the north ecliptic pole; Y stays
//! perpendicular to the sun vector (Casteren §1, figure 4). A manoeuvre becomes [`Segment`]s of constant acceleration;
//! [`Motion`] integrates the inertial rates over any interval.

mod body_rates;
mod manoeuvre;
mod motion;
mod profile;
mod recorded;
mod spline;
mod streamed;
mod sun;
mod truth_numbers;

pub use body_rates::{RateSegment, length_s};
pub use manoeuvre::{Manoeuvre, Scenario};
pub use motion::{LimitCycle, Motion, MotionState, MotionStep};
pub use profile::{AttitudeProfile, InfeasibleManoeuvre, Leg};
pub use recorded::{AttitudeRow, AttitudeRowsError, GAP_SPACINGS, RecordedAttitude, median_spacing_s};
pub use streamed::{Knot, SampleQuality, StreamedAttitude, turn_between_arcsec};
pub use sun::Sun;
pub use truth_numbers::TruthNumbers;

/// An interval over which θ and ψ have constant accelerations. Radians; times from the segment's start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Length; infinite for the hold that ends a finite scenario.
    pub duration_s: f64,
    /// θ.
    pub theta: Quadratic,
    /// ψ.
    pub psi: Quadratic,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quadratic {
    /// At the segment's start.
    pub start_rad: f64,
    /// At the segment's start.
    pub rate_rad_s: f64,
    pub acceleration_rad_s2: f64,
}

impl Quadratic {
    pub const fn at(start_rad: f64) -> Quadratic {
        Quadratic { start_rad, rate_rad_s: 0.0, acceleration_rad_s2: 0.0 }
    }

    #[inline]
    pub fn is_at_rest(&self) -> bool {
        self.rate_rad_s == 0.0 && self.acceleration_rad_s2 == 0.0
    }

    /// The change since the segment's start.
    #[inline]
    pub fn change_rad(&self, t_s: f64) -> f64 {
        (self.rate_rad_s + 0.5 * self.acceleration_rad_s2 * t_s) * t_s
    }

    #[inline]
    pub fn angle_rad(&self, t_s: f64) -> f64 {
        self.start_rad + self.change_rad(t_s)
    }

    #[inline]
    pub fn rate_rad_s(&self, t_s: f64) -> f64 {
        self.rate_rad_s + self.acceleration_rad_s2 * t_s
    }
}
