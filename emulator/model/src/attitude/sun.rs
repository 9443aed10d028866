//! The sun as an attitude and a direction to it mean it: θ, ψ, and how far the sun stands out of the XZ plane.

use crate::package::{cross, dot};
use crate::units::ARCSEC_PER_RAD;

/// Direction of the sun in the control frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sun {
    /// Solar aspect angle θ: between the direction to the sun and the boresight, +X.
    pub theta_rad: f64,
    /// Angle ψ about the sun vector: 0 where the boresight is nearest the north ecliptic pole.
    pub psi_rad: f64,
    /// Rotation about X and Y from the attitude that θ and ψ define, in which the sun is in the XZ plane on the side of
    /// +Z: what a sun sensor sees of an attitude that is not held so.
    pub departure_control_arcsec: [f64; 2],
}

impl Sun {
    /// The sun seen from `attitude` (control frame to inertial, real part first, of unit length); `sun_inertial` is the
    /// direction to it, of unit length. The north ecliptic pole of the inertial frame is its Z axis turned by `obliquity_rad`
    /// about X.
    pub fn seen(attitude: [f64; 4], sun_inertial: [f64; 3], obliquity_rad: f64) -> Sun {
        let (sin, cos) = libm::sincos(obliquity_rad);
        let sun = to_control(attitude, sun_inertial);
        let pole = to_control(attitude, [0.0, -sin, cos]);
        let theta_rad = libm::atan2(libm::hypot(sun[1], sun[2]), sun[0]);
        // The boresight's part across the sun vector, and what stands across both: Y where the sun is in XZ.
        let across = [1.0 - sun[0] * sun[0], -sun[0] * sun[1], -sun[0] * sun[2]];
        let third = [0.0, sun[2], -sun[1]];
        let psi_rad = libm::atan2(-dot(pole, third), dot(pole, across));
        let sin_theta = libm::sin(theta_rad);
        let about_x_rad = if sin_theta > 0.0 { libm::asin(sun[1].clamp(-1.0, 1.0)) / sin_theta } else { 0.0 };
        let about_y_rad = libm::atan2(sun[2], sun[0]) - theta_rad;
        Sun { theta_rad, psi_rad, departure_control_arcsec: [about_x_rad, about_y_rad].map(|rad| rad * ARCSEC_PER_RAD) }
    }

    /// On the straight line from this to `to`; ψ goes the shorter way.
    #[must_use]
    pub fn towards(&self, to: &Sun, share: f64) -> Sun {
        let part = |from: f64, to: f64| from + (to - from) * share;
        let [from_x, from_y] = self.departure_control_arcsec;
        let [to_x, to_y] = to.departure_control_arcsec;
        Sun {
            theta_rad: part(self.theta_rad, to.theta_rad),
            psi_rad: self.psi_rad + super::recorded::shorter_way(to.psi_rad - self.psi_rad) * share,
            departure_control_arcsec: [part(from_x, to_x), part(from_y, to_y)],
        }
    }
}

/// An inertial direction in the control frame: turned by the conjugate.
fn to_control([w, x, y, z]: [f64; 4], inertial: [f64; 3]) -> [f64; 3] {
    let axis = [-x, -y, -z];
    let twice = cross(axis, inertial).map(|part| 2.0 * part);
    let again = cross(axis, twice);
    std::array::from_fn(|index| inertial[index] + w * twice[index] + again[index])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::RAD_PER_DEG;

    fn product([a, b, c, d]: [f64; 4], [e, f, g, h]: [f64; 4]) -> [f64; 4] {
        [
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        ]
    }

    /// The attitude of θ and ψ in a frame whose X axis is the direction to the sun and whose Z axis is the pole:
    /// from the boresight at the sun and Z away from the pole, a turn by ψ about the sun vector, then by θ about Y.
    fn attitude(theta_deg: f64, psi_deg: f64) -> [f64; 4] {
        let half = |deg: f64| libm::sincos(deg * RAD_PER_DEG / 2.0);
        let ((sin_psi, cos_psi), (sin_theta, cos_theta)) = (half(psi_deg + 180.0), half(theta_deg));
        product([cos_psi, sin_psi, 0.0, 0.0], [cos_theta, 0.0, sin_theta, 0.0])
    }

    #[test]
    fn theta_and_psi_of_an_attitude_come_back_with_the_sun_in_the_xz_plane() {
        for (theta_deg, psi_deg) in [(90.0, 0.0), (60.0, 40.0), (119.0, -170.0), (75.0, 179.0)] {
            let seen = Sun::seen(attitude(theta_deg, psi_deg), [1.0, 0.0, 0.0], 0.0);
            let [theta, psi] = [seen.theta_rad, seen.psi_rad].map(|rad| rad / RAD_PER_DEG);
            assert!((theta - theta_deg).abs() < 1e-9 && (psi - psi_deg).abs() < 1e-9, "{theta} {psi}");
            assert!(seen.departure_control_arcsec.iter().all(|turn| turn.abs() < 1e-6), "{seen:?}");
        }
    }

    #[test]
    fn the_pole_stands_where_the_obliquity_says() {
        // The boresight at the north ecliptic pole of an equatorial frame: θ = 90°, ψ = 0, Z at the sun on +X.
        let obliquity_rad = 23.439_291_1 * RAD_PER_DEG;
        let turned = libm::sincos(obliquity_rad / 2.0);
        let equatorial = product([turned.1, turned.0, 0.0, 0.0], attitude(90.0, 0.0));
        let seen = Sun::seen(equatorial, [1.0, 0.0, 0.0], obliquity_rad);
        assert!((seen.theta_rad / RAD_PER_DEG - 90.0).abs() < 1e-9 && seen.psi_rad.abs() < 1e-9, "{seen:?}");
    }

    #[test]
    fn a_sun_out_of_the_plane_is_a_departure_about_x_as_a_sun_sensor_reads_it() {
        // From θ = 60° the unit turns by 100″ about X: the sun stands 100″ · sin 60° out of the plane, towards +Y.
        let (sin, cos) = libm::sincos(100.0 / ARCSEC_PER_RAD / 2.0);
        let turned = product(attitude(60.0, 0.0), [cos, sin, 0.0, 0.0]);
        let [about_x, about_y] = Sun::seen(turned, [1.0, 0.0, 0.0], 0.0).departure_control_arcsec;
        assert!((about_x - 100.0).abs() < 1e-3 && about_y.abs() < 0.1, "{about_x} {about_y}");
    }

    #[test]
    fn between_two_suns_psi_goes_the_shorter_way() {
        let at = |psi_deg: f64| Sun { psi_rad: psi_deg * RAD_PER_DEG, ..Sun::default() };
        assert!((at(179.0).towards(&at(-179.0), 0.5).psi_rad / RAD_PER_DEG - 180.0).abs() < 1e-9);
    }
}
