//! The two-axis Fine Sun Sensor: the sun's angles in the XZ plane and out of it, in steps (Casteren §1, §6).

use crate::attitude::{Leg, Motion};
use crate::noise::NoiseStream;
use crate::parameter_spec::numbers;
use crate::units::ARCSEC_PER_RAD;

numbers! {
    /// What the Fine Sun Sensor resolves.
    pub struct Fss {
        /// Resolution: four times that of the gyros, 1 arcsec (Casteren §6).
        step_arcsec: 4.0, 0.001..=3600.0, "arcsec";
        /// Noise of each axis and sample, 1 sigma, before the step is taken; the paper gives none.
        noise_arcsec: 0.0, 0.0..=3600.0, "arcsec";
    }
}

/// Instants closer than this are the same: ends of legs are sums of ramps, and rounded.
const GRAIN_S: f64 = 1e-6;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SunAngles {
    /// Sun angle in the XZ plane, from X towards Z: the solar aspect angle.
    pub theta_arcsec: f64,
    /// Sun angle out of the XZ plane, towards Y.
    pub roll_arcsec: f64,
}

#[derive(Debug, Clone)]
pub struct SunSensor {
    numbers: Fss,
    noise: NoiseStream,
    /// Start and end of the current or last eclipse.
    eclipse_s: (f64, f64),
}

impl SunSensor {
    /// At the start of a run.
    pub fn new(numbers: Fss, seed: u64) -> SunSensor {
        SunSensor { numbers, noise: NoiseStream::of_sensor(seed, "fss"), eclipse_s: (f64::INFINITY, f64::INFINITY) }
    }

    /// Takes notice of a leg that begins, in order; the sensor is blind during an eclipse.
    pub fn begin_leg(&mut self, leg: &Leg) {
        if leg.eclipse {
            self.eclipse_s = (leg.start_s, leg.end_s);
        }
    }

    /// Samples the sun now; nothing in an eclipse, or where θ and ψ are not known.
    pub fn see(&mut self, motion: &Motion) -> Option<SunAngles> {
        // Drawn in every case, so that an eclipse changes no later sample's noise.
        let noise = [self.noise.standard_normal(), self.noise.standard_normal()];
        let now = motion.now();
        let inside = |t_s: f64| self.eclipse_s.0 < t_s && t_s <= self.eclipse_s.1;
        if !motion.knows_sun() || inside(now.t_s - GRAIN_S) {
            return None;
        }
        let [about_x, about_y] = motion.departure_control_arcsec();
        let Fss { step_arcsec, noise_arcsec } = self.numbers;
        // No negative zero: 0 is added.
        let seen =
            |arcsec: f64, noise: f64| ((arcsec + noise_arcsec * noise) / step_arcsec).round() * step_arcsec + 0.0;
        Some(SunAngles {
            theta_arcsec: seen(now.theta_rad * ARCSEC_PER_RAD + about_y, noise[0]),
            roll_arcsec: seen(about_x * libm::sin(now.theta_rad), noise[1]),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attitude::{AttitudeProfile, LimitCycle, Manoeuvre, Scenario};

    fn samples(fss: Fss, scenario: &Scenario, count: usize) -> Vec<Option<SunAngles>> {
        let mut motion = Motion::new(AttitudeProfile::new(scenario).expect("possible"), scenario.limit_cycle);
        let mut sensor = SunSensor::new(fss, 1);
        (1..=count)
            .map(|index| {
                motion.advance(index as f64 * 0.5);
                motion.take_legs().iter().for_each(|leg| sensor.begin_leg(leg));
                sensor.see(&motion)
            })
            .collect()
    }

    fn hold(theta_deg: f64) -> Scenario {
        let limit_cycle = LimitCycle { rate_arcsec_s: 4.0, ..LimitCycle::default() };
        Scenario { theta_deg, psi_deg: 0.0, limit_cycle, manoeuvres: Vec::new() }
    }

    #[test]
    fn the_limit_cycle_shows_in_both_axes_by_its_integral() {
        // Fine steps: the largest departure is 4·5/2π = 3.183″ about Y and that times sin 60° out of the plane.
        let seen = samples(Fss { step_arcsec: 0.001, ..Fss::default() }, &hold(60.0), 1000);
        let largest = |of: &dyn Fn(SunAngles) -> f64| {
            seen.iter().map(|sample| of(sample.expect("sunlit")).abs()).fold(0.0, f64::max)
        };
        let (theta, roll) = (largest(&|sample| sample.theta_arcsec - 216_000.0), largest(&|sample| sample.roll_arcsec));
        // Samples each sample meet the crest of a 5 s sine within 0.05 of it.
        assert!((3.02..3.19).contains(&theta), "{theta}");
        assert!((3.02 * 0.866..3.19 * 0.8661).contains(&roll), "{roll}");
    }

    #[test]
    fn samples_stand_on_whole_steps_and_noise_has_its_sigma() {
        let quiet = samples(Fss::default(), &hold(90.0), 100);
        assert!(
            quiet.iter().flatten().all(|sample| sample.theta_arcsec % 4.0 == 0.0 && sample.roll_arcsec % 4.0 == 0.0)
        );
        let still = Scenario { limit_cycle: LimitCycle::default(), ..hold(90.0) };
        let noisy = samples(Fss { step_arcsec: 0.001, noise_arcsec: 20.0 }, &still, 10_000);
        let squares: f64 = noisy.iter().flatten().map(|sample| sample.roll_arcsec.powi(2)).sum();
        // 5 sigma of a standard deviation over 10 000 draws: 5/√20 000.
        assert!((((squares / 10_000.0).sqrt() / 20.0) - 1.0).abs() < 0.036);
    }

    #[test]
    fn an_eclipse_blinds_it_and_moves_no_later_noise() {
        let fss = Fss { noise_arcsec: 5.0, ..Fss::default() };
        let eclipse = "eclipse";
        let dark = Scenario {
            manoeuvres: ["pointing", eclipse].map(|kind| Manoeuvre::of_kind(kind).expect("a kind")).to_vec(),
            ..hold(90.0)
        };
        let seen = samples(fss, &dark, 4000);
        // 600 s of pointing, 1200 s of eclipse.
        for (index, sample) in seen.iter().enumerate() {
            assert_eq!(sample.is_none(), (1200..3600).contains(&index), "{index}");
        }
        let bright = samples(fss, &hold(90.0), 4000);
        assert_eq!(seen[3600..], bright[3600..]);
    }
}
