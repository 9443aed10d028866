//! Motion about the sun vector and with it: eqs 5–7 of the paper, integrated along a path.
//!
//! θ is the solar aspect angle, ψ the angle about the sun vector. The tests compare with the closed forms: eq 8 for θ and ψ
//! held (with −sin ψ in its middle row; the paper prints −sin θ there, and −sin ψ in eq 13), eqs 9–13 for a pointing that
//! holds the star instead, Δφ_z = 0.

use geu_model::units::{ARCSEC_PER_RAD, SUN_RATE_RAD_S};
use libm::sincos;

/// The sun's angular velocity, arcsec/s.
const SUN_RATE_ARCSEC_S: f64 = SUN_RATE_RAD_S * ARCSEC_PER_RAD;

/// Equation 6 from sine and cosine of θ and of ψ.
fn sun_rate((sin_theta, cos_theta): (f64, f64), (sin_psi, cos_psi): (f64, f64)) -> [f64; 3] {
    [cos_psi * sin_theta, -sin_psi, -cos_psi * cos_theta].map(|part| part * SUN_RATE_ARCSEC_S)
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Time, s.
    pub t_s: f64,
    pub theta_rad: f64,
    /// Angle about the sun vector, not reduced to one turn.
    pub psi_rad: f64,
}

/// Inertial rotation about the control axes from one point to the next, arcsec: eq 5 with eqs 6 and 7 over a step in which
/// θ and ψ hardly bend.
pub fn step_control_arcsec(from: &Point, to: &Point) -> [f64; 3] {
    let theta = sincos((from.theta_rad + to.theta_rad) / 2.0);
    let sun = sun_rate(theta, sincos((from.psi_rad + to.psi_rad) / 2.0)).map(|rate| rate * (to.t_s - from.t_s));
    let about_sun_arcsec = (to.psi_rad - from.psi_rad) * ARCSEC_PER_RAD;
    [
        about_sun_arcsec * theta.1 + sun[0],
        (to.theta_rad - from.theta_rad) * ARCSEC_PER_RAD + sun[1],
        about_sun_arcsec * theta.0 + sun[2],
    ]
}

/// The path that a step of inertial rotation about Y and Z makes of a point: the inverse of [`step_control_arcsec`].
pub fn follow(from: &Point, t_s: f64, about_y_arcsec: f64, about_z_arcsec: f64) -> Point {
    let mut to = Point { t_s, ..*from };
    // The rates of the middle, which the first pass finds.
    for _ in 0..2 {
        let theta = sincos((from.theta_rad + to.theta_rad) / 2.0);
        let sun = sun_rate(theta, sincos((from.psi_rad + to.psi_rad) / 2.0)).map(|rate| rate * (t_s - from.t_s));
        to.theta_rad = from.theta_rad + (about_y_arcsec - sun[1]) / ARCSEC_PER_RAD;
        to.psi_rad = from.psi_rad + (about_z_arcsec - sun[2]) / theta.0 / ARCSEC_PER_RAD;
    }
    to
}

#[cfg(test)]
mod tests {
    use geu_model::units::RAD_PER_DEG;
    use libm::{cos, sin, tan};

    use super::*;

    /// 360° per 365.25 d in arcsec/s: 1 296 000 / 31 557 600.
    const RATE: f64 = 0.041_067_761;

    /// Components of the sun's motion along the control axes, arcsec/s (eq 6).
    fn sun_rate_control_arcsec_s(theta_rad: f64, psi_rad: f64) -> [f64; 3] {
        sun_rate(sincos(theta_rad), sincos(psi_rad))
    }

    /// Inertial rate of a pointing that holds the star, without rotation about Z (eqs 9–13), arcsec/s: the sun-referenced
    /// rotation about Z compensates the sun's, and adds one about X (eq 10).
    fn star_pointing_rate_control_arcsec_s(theta_rad: f64, psi_rad: f64) -> [f64; 3] {
        let about_x = cos(psi_rad) * (cos(theta_rad) / tan(theta_rad) + sin(theta_rad));
        [SUN_RATE_ARCSEC_S * about_x, -SUN_RATE_ARCSEC_S * sin(psi_rad), 0.0]
    }

    fn close(got: [f64; 3], expected: [f64; 3]) {
        for (got, expected) in got.into_iter().zip(expected) {
            assert!((got - expected).abs() < 2e-9 * (1.0 + expected.abs()), "{got} {expected}");
        }
    }

    #[test]
    fn the_sun_moves_along_the_control_axes_as_eq_6_says() {
        // θ = 60°, ψ = 30°: cos 30 sin 60 = 3/4, −sin 30 = −1/2, −cos 30 cos 60 = −√3/4.
        let rates = sun_rate_control_arcsec_s(60.0 * RAD_PER_DEG, 30.0 * RAD_PER_DEG);
        close(rates, [0.75 * RATE, -0.5 * RATE, -0.433_012_702 * RATE]);
        // The paper prints −sin θ in the middle row of eq 8, −0.866 here: a misprint.
        assert!((rates[1] + 0.866 * RATE).abs() > 0.01);
    }

    #[test]
    fn a_pointing_that_holds_the_star_turns_about_x_by_43_arcsec_per_hour_more() {
        // ψ = 0, θ = 60°: eq 12 gives ω/sin 60 = 1.154 700 538 ω, eq 8 gives ω sin 60 = 0.866 025 404 ω.
        let (star, sun) = (
            star_pointing_rate_control_arcsec_s(60.0 * RAD_PER_DEG, 0.0),
            sun_rate_control_arcsec_s(60.0 * RAD_PER_DEG, 0.0),
        );
        close(star, [1.154_700_538 * RATE, 0.0, 0.0]);
        assert!(((star[0] - sun[0]) * 3600.0 - 42.68).abs() < 0.01);
        // And holding θ and ψ turns about Z, holding the star does not.
        assert!((sun[2] + 0.5 * RATE).abs() < 2e-9);
        // Integrated along the path of the star pointing, the general method gives eq 12: ψ' = ω cos ψ cos θ / sin θ.
        let mut point = Point { t_s: 0.0, theta_rad: 60.0 * RAD_PER_DEG, psi_rad: 0.0 };
        let mut turned = [0.0; 3];
        for index in 1..=1200 {
            let next = follow(&point, f64::from(index) * 0.5, 0.0, 0.0);
            for (sum, angle) in turned.iter_mut().zip(step_control_arcsec(&point, &next)) {
                *sum += angle;
            }
            point = next;
        }
        assert!(
            (turned[0] - 600.0 * star[0]).abs() < 1e-3 && turned[1].abs() < 1e-9 && turned[2].abs() < 1e-9,
            "{turned:?}"
        );
    }

    #[test]
    fn scans_about_the_sun_vector_couple_x_and_z_as_eq_10_says() {
        // Without the sun: 1° about the sun vector at θ = 60° is cos 60° and sin 60° of it about X and Z.
        let from = Point { t_s: 0.0, theta_rad: 60.0 * RAD_PER_DEG, psi_rad: 0.0 };
        let to = Point { psi_rad: RAD_PER_DEG, ..from };
        let turned = step_control_arcsec(&from, &to);
        close([turned[0], turned[2], turned[0] / turned[2]], [1800.0, 3_117.691_453_6, 0.577_350_269]);
    }

    #[test]
    fn following_a_rotation_gives_the_path_back() {
        let from = Point { t_s: 3.0, theta_rad: 1.3, psi_rad: 5.0 };
        let to = Point { t_s: 3.5, theta_rad: 1.301, psi_rad: 5.002 };
        let [_, about_y, about_z] = step_control_arcsec(&from, &to);
        let back = follow(&from, 3.5, about_y, about_z);
        assert!((back.theta_rad - to.theta_rad).abs() < 1e-10 && (back.psi_rad - to.psi_rad).abs() < 1e-8);
    }
}
