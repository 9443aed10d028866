//! Fixes of the attitude by the absolute sensors (Casteren §1, §5).

use geu_model::sensor::Fss;
use geu_model::units::{ARCSEC_PER_RAD, RAD_PER_DEG, SUN_RATE_RAD_S};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::covariance::turn_arcsec;
use crate::absolute::AbsoluteData;

/// Time between the samples of the sun sensor that are used: its steps of 4″ are errors of one attitude, not noise of one
/// sample. Not a multiple of the limit cycle's 5 s, so that every phase occurs.
pub(super) const SUN_EVERY_S: f64 = 600.5;

/// The attitude, control frame to inertial, of θ and ψ at `t_s`. The
/// inertial frame is the sun-referenced frame at t = 0: x to the sun, z to the north ecliptic pole.
pub fn attitude_of(theta_rad: f64, psi_rad: f64, t_s: f64) -> UnitQuaternion<f64> {
    let ((sin_theta, cos_theta), (sin_psi, cos_psi)) = (libm::sincos(theta_rad), libm::sincos(psi_rad));
    let sun = Vector3::new(cos_theta, 0.0, sin_theta);
    let pole = Vector3::new(cos_psi * sin_theta, -sin_psi, -cos_psi * cos_theta);
    // Rows are the axes of the sun-referenced frame, seen from the control frame.
    let rows = Matrix3::from_rows(&[sun.transpose(), pole.cross(&sun).transpose(), pole.transpose()]);
    let to_sun_referenced = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rows));
    UnitQuaternion::from_scaled_axis(Vector3::z() * (SUN_RATE_RAD_S * t_s)) * to_sun_referenced
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FixMeasurement {
    /// The attitude, control frame to inertial. What no axis_of_fix looks at need only be near.
    Attitude(UnitQuaternion<f64>),
    Direction {
        /// Measured direction in the control frame.
        control: Vector3<f64>,
        inertial: Vector3<f64>,
    },
}

/// One component of the attitude that a fix sees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensitiveAxis {
    /// The axis, unit vector in the control frame, about which a turn is seen.
    pub direction_control: Vector3<f64>,
    /// Random error, 1 sigma.
    pub sigma_arcsec: f64,
    /// Sensitivity to the star sensor's systematic errors of θ and of ψ; 0 for other sensors.
    pub systematic: [f64; 2],
}

/// A fix of the attitude: what was seen, and how well about which axes.
#[derive(Debug, Clone, PartialEq)]
pub struct AttitudeFix {
    /// Time, s since the start of the counts.
    pub t_s: f64,
    pub seen: FixMeasurement,
    /// About which axes, with errors independent of each other.
    pub axes: Vec<SensitiveAxis>,
}

impl AttitudeFix {
    /// A fix of the slit star sensor: the boresight's direction by θ and ψ, each with `sigma_arcsec` and with its
    /// systematic error. A turn about the boresight is not seen: rank 2.
    pub fn star(t_s: f64, theta_deg: f64, psi_deg: f64, sigma_arcsec: f64) -> AttitudeFix {
        let theta_rad = theta_deg * RAD_PER_DEG;
        // Turning about the sun vector by δψ moves the boresight by δψ sin θ.
        let sin_theta = libm::sin(theta_rad);
        let axes = vec![
            SensitiveAxis { direction_control: Vector3::y(), sigma_arcsec, systematic: [1.0, 0.0] },
            SensitiveAxis {
                direction_control: Vector3::z(),
                sigma_arcsec: sigma_arcsec * sin_theta,
                systematic: [0.0, sin_theta],
            },
        ];
        AttitudeFix { t_s, seen: FixMeasurement::Attitude(attitude_of(theta_rad, psi_deg * RAD_PER_DEG, t_s)), axes }
    }

    /// One fix of the slit star sensor from all the slits that a star crossed: θ and ψ in degrees and the random error of
    /// each, arcsec. A star's own error, `star_arcsec`, is the same for all of them.
    pub fn star_through_slits(t_s: f64, slits: &[([f64; 2], f64)], star_arcsec: f64) -> AttitudeFix {
        let count = slits.len() as f64;
        let first_psi_deg = slits.first().map_or(0.0, |slit| slit.0[1]);
        let theta_deg = slits.iter().map(|slit| slit.0[0]).sum::<f64>() / count;
        // Departures from the first, so that 0 and 360 are neighbours.
        let away_deg = |psi_deg: f64| (psi_deg - first_psi_deg + 180.0).rem_euclid(360.0) - 180.0;
        let psi_deg = first_psi_deg + slits.iter().map(|slit| away_deg(slit.0[1])).sum::<f64>() / count;
        let random = slits.iter().map(|slit| slit.1 * slit.1).sum::<f64>() / (count * count);
        // A sensor without noise is exact to a milliarcsecond.
        AttitudeFix::star(t_s, theta_deg, psi_deg, (random + star_arcsec * star_arcsec).sqrt().max(1e-3))
    }

    /// A sample of the Fine Sun Sensor: the sun's angle in the XZ plane and out of it. Its steps err by one over √12, beside
    /// its noise; a turn about the sun vector is not seen.
    pub fn sun(t_s: f64, theta_arcsec: f64, roll_arcsec: f64, sensor: &Fss) -> AttitudeFix {
        let (sin_theta, cos_theta) = libm::sincos(theta_arcsec / ARCSEC_PER_RAD);
        let (sin_roll, cos_roll) = libm::sincos(roll_arcsec / ARCSEC_PER_RAD);
        let control = Vector3::new(cos_theta * cos_roll, sin_roll, sin_theta * cos_roll);
        let (sin, cos) = libm::sincos(SUN_RATE_RAD_S * t_s);
        let seen = FixMeasurement::Direction { control, inertial: Vector3::new(cos, sin, 0.0) };
        let Fss { step_arcsec, noise_arcsec } = *sensor;
        // A sensor without either is exact to a milliarcsecond.
        let sigma_arcsec = (step_arcsec * step_arcsec / 12.0 + noise_arcsec * noise_arcsec).sqrt().max(1e-3);
        let axis_of_fix = |direction_control| SensitiveAxis { direction_control, sigma_arcsec, systematic: [0.0; 2] };
        // About Y, and about the axis that carries the sun out of the XZ plane.
        AttitudeFix {
            t_s,
            seen,
            axes: vec![axis_of_fix(Vector3::y()), axis_of_fix(Vector3::new(sin_theta, 0.0, -cos_theta))],
        }
    }

    /// Every fix of the star sensor and a sample of the sun sensor each ten minutes, from files of a recording that
    /// starts at `start_ns` of their time scale.
    pub fn from_sensors(sensors: &AbsoluteData, start_ns: i64) -> Vec<AttitudeFix> {
        let seconds = |t_ns: i64| (t_ns - start_ns) as f64 * 1e-9;
        let star = |fix: &crate::absolute::StarFix| {
            let slits: Vec<([f64; 2], f64)> = fix.slits.iter().map(|slit| (slit.1, slit.2)).collect();
            AttitudeFix::star_through_slits(seconds(fix.t_ns), &slits, sensors.numbers.sse.star_arcsec)
        };
        let mut fixes: Vec<AttitudeFix> = sensors.fixes.iter().map(star).collect();
        let mut next_s = f64::NEG_INFINITY;
        for &(t_ns, [theta_arcsec, roll_arcsec]) in &sensors.sun {
            let t_s = seconds(t_ns);
            if t_s >= next_s {
                fixes.push(AttitudeFix::sun(t_s, theta_arcsec, roll_arcsec, &sensors.numbers.fss));
                next_s = t_s + SUN_EVERY_S;
            }
        }
        fixes
    }

    /// The turn about the control axes from the attitude predicted to what was seen; what was not seen is 0.
    pub(super) fn residual_control_arcsec(&self, predicted: &UnitQuaternion<f64>) -> Vector3<f64> {
        match &self.seen {
            FixMeasurement::Attitude(attitude) => turn_arcsec(predicted, attitude),
            // A turn e makes of the direction u, predicted, u + e × u.
            FixMeasurement::Direction { control, inertial } => {
                control.cross(&(predicted.inverse() * inertial)) * ARCSEC_PER_RAD
            }
        }
    }

    /// True if all numbers are finite and sigmas above 0.
    pub(super) fn is_sound(&self) -> bool {
        let is_seen = match &self.seen {
            FixMeasurement::Attitude(attitude) => attitude.coords.iter().all(|part| part.is_finite()),
            FixMeasurement::Direction { control, inertial } => {
                control.iter().chain(inertial).all(|part| part.is_finite())
            }
        };
        let is_sight = |axis_of_fix: &SensitiveAxis| {
            axis_of_fix.direction_control.iter().chain(&axis_of_fix.systematic).all(|part| part.is_finite())
                && axis_of_fix.sigma_arcsec.is_finite()
                && axis_of_fix.sigma_arcsec > 0.0
        };
        self.t_s.is_finite() && is_seen && self.axes.iter().all(is_sight)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_attitude_has_the_sun_and_the_pole_where_the_model_says() {
        let (theta, psi, t_s) = (1.2, 2.3, 1e6);
        let attitude = attitude_of(theta, psi, t_s);
        let sun = attitude * Vector3::new(theta.cos(), 0.0, theta.sin());
        let longitude = SUN_RATE_RAD_S * t_s;
        assert!((sun - Vector3::new(longitude.cos(), longitude.sin(), 0.0)).norm() < 1e-14);
        let pole = Vector3::new(psi.cos() * theta.sin(), -psi.sin(), -psi.cos() * theta.cos());
        assert!((attitude * pole - Vector3::z()).norm() < 1e-14);
    }

    #[test]
    fn a_small_turn_comes_back_from_every_kind_of_fix() {
        let attitude = attitude_of(1.3, 0.7, 500.0);
        let turn_arcsec = Vector3::new(3.0, -2.0, 5.0);
        let predicted = attitude * UnitQuaternion::from_scaled_axis(-turn_arcsec / ARCSEC_PER_RAD);
        let whole = AttitudeFix { t_s: 500.0, seen: FixMeasurement::Attitude(attitude), axes: vec![] };
        assert!((whole.residual_control_arcsec(&predicted) - turn_arcsec).norm() < 1e-6);
        let sun = AttitudeFix::sun(500.0, 1.3 * ARCSEC_PER_RAD, 0.0, &Fss::default());
        let seen = sun.residual_control_arcsec(&predicted);
        for axis_of_fix in &sun.axes {
            let along = axis_of_fix.direction_control;
            assert!((along.dot(&seen) - along.dot(&turn_arcsec)).abs() < 1e-3, "{seen} {along}");
        }
    }
}
