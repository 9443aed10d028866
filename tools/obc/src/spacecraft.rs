//! The controlled spacecraft: a rigid body with a torque and disturbances.

use nalgebra::{UnitQuaternion, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Moments of inertia about the control axes, kg m²: a telescope of a ton.
pub const INERTIA_KG_M2: [f64; 3] = [700.0, 1000.0, 900.0];
/// Largest torque of the wheels about an axis, N m.
pub const MAX_TORQUE_N_M: f64 = 0.2;
/// Steady torque of the sun's pressure, N m.
const SOLAR_N_M: [f64; 3] = [1e-5, 4e-5, -3e-5];
/// Standard deviation of the torque noise of wheels and mechanisms, N m.
const NOISE_N_M: f64 = 5e-4;
/// Longest step of the integration, s: at 10″/s and 0.2 N m a body turns far less than a milliarcsecond off in an hour.
const STEP_S: f64 = 0.05;

/// A rigid body without external fields.
pub struct Spacecraft {
    /// Control frame to inertial.
    pub attitude: UnitQuaternion<f64>,
    /// About the control axes.
    pub rate_rad_s: Vector3<f64>,
    noise: ChaCha8Rng,
}

impl Spacecraft {
    /// At attitude zero, with a rate; `seed` sets the disturbances.
    pub fn new(rate_rad_s: Vector3<f64>, seed: u64) -> Spacecraft {
        Spacecraft { attitude: UnitQuaternion::identity(), rate_rad_s, noise: ChaCha8Rng::seed_from_u64(seed) }
    }

    /// Simulates `length_s` under a torque, limited to that of the wheels.
    pub fn advance(&mut self, torque_n_m: Vector3<f64>, length_s: f64) {
        let inertia = Vector3::from(INERTIA_KG_M2);
        let noise = Vector3::from_fn(|_, _| self.normal() * NOISE_N_M);
        let commanded = torque_n_m.map(|torque| torque.clamp(-MAX_TORQUE_N_M, MAX_TORQUE_N_M));
        let torque = commanded + noise + Vector3::from(SOLAR_N_M);
        let steps = (length_s / STEP_S).ceil().max(1.0);
        let step_s = length_s / steps;
        for _ in 0..steps as u64 {
            // Euler's equations; the attitude turns by the rate of the step's middle.
            let change = |rate: &Vector3<f64>| {
                (torque - rate.cross(&inertia.component_mul(rate))).component_div(&inertia) * step_s
            };
            let middle = self.rate_rad_s + change(&self.rate_rad_s) * 0.5;
            self.rate_rad_s += change(&middle);
            self.attitude *= UnitQuaternion::from_scaled_axis(middle * step_s);
        }
        self.attitude.renormalize();
    }

    /// Nearly normal: the sum of twelve uniform numbers has variance 1.
    fn normal(&mut self) -> f64 {
        let uniform = |bits: u64| (bits >> 11) as f64 / (1u64 << 53) as f64;
        (0..12).map(|_| uniform(self.noise.next_u64())).sum::<f64>() - 6.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn torque_is_limited_and_turns_the_body_by_its_inertia() {
        let mut body = Spacecraft::new(Vector3::zeros(), 1);
        for _ in 0..40 {
            body.advance(Vector3::new(7.0, 0.0, 0.0), 0.25);
        }
        // 0.2 N m for 10 s on 700 kg m²: 2.857 mrad/s, 14.29 mrad.
        assert!((body.rate_rad_s.x - 0.2 * 10.0 / 700.0).abs() < 2e-5, "{}", body.rate_rad_s);
        assert!((body.attitude.scaled_axis().x - 0.5 * 0.2 * 100.0 / 700.0).abs() < 1e-4);
        assert!(body.rate_rad_s.yz().norm() < 2e-5);
    }

    #[test]
    fn the_same_seed_gives_the_same_motion() {
        let end = |seed| {
            let mut body = Spacecraft::new(Vector3::new(1e-5, 2e-5, 3e-5), seed);
            (0..100).for_each(|_| body.advance(Vector3::zeros(), 0.25));
            body.attitude
        };
        assert_eq!(end(7), end(7));
        assert_ne!(end(7), end(8));
    }
}
