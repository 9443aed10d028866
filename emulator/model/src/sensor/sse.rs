//! The slit star sensor: fixes of the attitude at the reference times (Casteren §5, §6).
//!
//! The reference times are the starts and ends of all legs of a scenario, where θ and ψ are at rest. At each, the star
//! in the field crosses every slit, and each crossing is a fix. Its error has a random part, drawn anew each time, and a
//! systematic part that belongs to the slit and to the star: it cancels between two fixes of one star through one slit.
//! A leg that comes back to where it began (a pointing, a full turn) ends on the star it began with, though the sun has
//! moved on meanwhile; after any other, the same slit is all that can be the same.
//!
//! A truth from a file has no legs, and so no fixes.

use std::collections::VecDeque;
use std::fmt;

use crate::attitude::{Leg, LimitCycle};
use crate::noise::NoiseStream;
use crate::parameter_spec::numbers;
use crate::units::{ARCSEC_PER_DEG, RAD_PER_DEG, SUN_RATE_RAD_S};

numbers! {
    /// What a fix of the slit star sensor is worth.
    pub struct Sse {
        /// Random error of θ and of ψ, 1 sigma, of each fix.
        random_arcsec: 0.5, 0.0..=3600.0, "arcsec";
        /// Systematic error of θ and of ψ, 1 sigma over the slits: a few arcsec (Casteren §5).
        slit_arcsec: 3.0, 0.0..=3600.0, "arcsec";
        /// Error of a star's place, 1 sigma over the stars (Casteren §5 names it and gives no value).
        star_arcsec: 0.0, 0.0..=3600.0, "arcsec";
    }
}

pub const SLITS: [&str; 2] = ["A", "B"];
/// A star is in the field within this angle of the boresight: in 100 minutes the sun takes it 0.07° away.
const FIELD_RAD: f64 = 1.0 * RAD_PER_DEG;

/// A star: one in each patch of the sky, about a degree wide, so that the same place always shows the same star.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Star {
    /// Ring of ecliptic latitude, from the south pole.
    ring: u32,
    patch: u32,
}

impl fmt::Display for Star {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "S{:03}{:03}", self.ring, self.patch)
    }
}

impl Star {
    /// The star nearest the middle of the patch in which a unit vector (z to the ecliptic pole) points.
    fn at([x, y, z]: [f64; 3]) -> Star {
        let ring = ((libm::asin(z.clamp(-1.0, 1.0)) / RAD_PER_DEG + 90.0) as u32).min(179);
        let longitude_deg = (libm::atan2(y, x) / RAD_PER_DEG).rem_euclid(360.0);
        let patches = Star::patches(ring);
        Star { ring, patch: ((longitude_deg / 360.0 * patches) as u32).min(patches as u32 - 1) }
    }

    fn patches(ring: u32) -> f64 {
        (360.0 * libm::sin((f64::from(ring) + 0.5) * RAD_PER_DEG)).ceil()
    }

    fn direction(self) -> [f64; 3] {
        let (sin_latitude, cos_latitude) = libm::sincos((f64::from(self.ring) - 89.5) * RAD_PER_DEG);
        let longitude_deg = (f64::from(self.patch) + 0.5) * 360.0 / Star::patches(self.ring);
        let (sin, cos) = libm::sincos(longitude_deg * RAD_PER_DEG);
        [cos * cos_latitude, sin * cos_latitude, sin_latitude]
    }

    fn is_in_field(self, boresight: [f64; 3]) -> bool {
        let cosine: f64 = self.direction().iter().zip(boresight).map(|(a, b)| a * b).sum();
        cosine >= libm::cos(FIELD_RAD)
    }
}

/// The boresight in the inertial frame: x to the sun at t = 0, z to the north ecliptic pole.
fn boresight([theta_rad, psi_rad]: [f64; 2], t_s: f64) -> [f64; 3] {
    // In the sun-referenced frame; the pole is (cos ψ sin θ, −sin ψ, −cos ψ cos θ) in the control frame.
    let ((sin_theta, cos_theta), (sin_psi, cos_psi)) = (libm::sincos(theta_rad), libm::sincos(psi_rad));
    let (x, y, z) = (cos_theta, -sin_psi * sin_theta, cos_psi * sin_theta);
    let (sin, cos) = libm::sincos(SUN_RATE_RAD_S * t_s);
    [x * cos - y * sin, x * sin + y * cos, z]
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SlitFix {
    /// True time since the start.
    pub t_s: f64,
    pub star: Star,
    /// The slit, of [`SLITS`].
    pub slit: &'static str,
    pub theta_deg: f64,
    /// Angle about the sun vector, 0…360.
    pub psi_deg: f64,
    /// Random error of each angle, 1 sigma.
    pub sigma_arcsec: f64,
}

#[derive(Debug, Clone)]
pub struct StarSensor {
    numbers: Sse,
    seed: u64,
    limit_cycle: LimitCycle,
    noise: NoiseStream,
    /// The star before, and true after the first leg.
    last: Option<Star>,
    /// Reference times to come: time, attitude, star.
    to_come: VecDeque<(f64, [f64; 2], Star)>,
}

impl StarSensor {
    /// At the start of a run.
    pub fn new(numbers: Sse, seed: u64, limit_cycle: LimitCycle) -> StarSensor {
        let noise = NoiseStream::of_sensor(seed, "sse");
        StarSensor { numbers, seed, limit_cycle, noise, last: None, to_come: VecDeque::new() }
    }

    /// Takes notice of a leg that begins, in order: its ends are reference times.
    pub fn begin_leg(&mut self, leg: &Leg) {
        let start = match self.last {
            Some(star) => star,
            None => {
                let star = Star::at(boresight(leg.start_rad, leg.start_s));
                self.to_come.push_back((leg.start_s, leg.start_rad, star));
                star
            }
        };
        self.last = Some(start);
        if leg.end_s.is_finite() {
            let boresight = boresight(leg.end_rad, leg.end_s);
            let star = if start.is_in_field(boresight) { start } else { Star::at(boresight) };
            self.to_come.push_back((leg.end_s, leg.end_rad, star));
            self.last = Some(star);
        }
    }

    /// The next fixes not later than `t_s`: one star through every slit.
    pub fn fixes_until(&mut self, t_s: f64) -> Option<[SlitFix; SLITS.len()]> {
        let (t_s, [theta_rad, psi_rad], star) = *self.to_come.front().filter(|next| next.0 <= t_s)?;
        self.to_come.pop_front();
        let about_y_deg = self.limit_cycle.departure_control_arcsec(t_s)[1] / ARCSEC_PER_DEG;
        let of_star = self.systematic(&star.to_string(), self.numbers.star_arcsec);
        Some(SLITS.map(|slit| {
            let of_slit = self.systematic(slit, self.numbers.slit_arcsec);
            let error_deg = [0, 1].map(|axis| {
                let random = self.numbers.random_arcsec * self.noise.standard_normal();
                (random + of_slit[axis] + of_star[axis]) / ARCSEC_PER_DEG
            });
            SlitFix {
                t_s,
                star,
                slit,
                theta_deg: theta_rad / RAD_PER_DEG + about_y_deg + error_deg[0],
                psi_deg: (psi_rad / RAD_PER_DEG + error_deg[1]).rem_euclid(360.0),
                sigma_arcsec: self.numbers.random_arcsec,
            }
        }))
    }

    /// Systematic errors of θ and ψ: the same whenever the slit or star of that name is used in a run.
    fn systematic(&self, name: &str, sigma_arcsec: f64) -> [f64; 2] {
        let mut stream = NoiseStream::of_sensor(self.seed, &format!("sse {name}"));
        [0, 1].map(|_| sigma_arcsec * stream.standard_normal())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Configuration;
    use crate::attitude::{AttitudeProfile, Motion};

    fn fixes(configuration: &Configuration, end_s: f64) -> Vec<SlitFix> {
        let scenario = &configuration.scenario;
        let mut motion = Motion::new(AttitudeProfile::new(scenario).expect("possible"), scenario.limit_cycle);
        let mut sensor = StarSensor::new(configuration.sensors.sse, configuration.seed, scenario.limit_cycle);
        let mut fixes = Vec::new();
        let mut t_s = 0.0;
        while t_s < end_s {
            t_s += 0.5;
            motion.advance(t_s);
            motion.take_legs().iter().for_each(|leg| sensor.begin_leg(leg));
            while let Some(both) = sensor.fixes_until(t_s) {
                fixes.extend(both);
            }
        }
        fixes
    }

    fn reference(overrides: &[&str]) -> Configuration {
        let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
        Configuration::reference_with(&overrides).expect("valid")
    }

    #[test]
    fn every_leg_is_fixed_at_both_ends_and_a_full_turn_on_one_star() {
        let fixes = fixes(&reference(&["scenario.limit_cycle.rate_arcsec_s=0"]), 7500.0);
        // Legs of the default scenario end at 600, 770, 1090, 1260 and 7445.825 s.
        let times: Vec<f64> = fixes.iter().step_by(2).map(|fix| (fix.t_s * 1e3).round() / 1e3).collect();
        assert_eq!(times, [0.0, 600.0, 770.0, 1090.0, 1260.0, 7445.825]);
        let star = |index: usize| fixes[2 * index].star;
        assert_eq!(star(0), star(1), "a pointing");
        assert_eq!(star(4), star(5), "a full turn");
        assert_ne!(star(1), star(2), "a scan about Y");
        for (fix, theta_deg) in fixes.iter().step_by(2).zip([90.0, 90.0, 60.0, 120.0, 90.0, 90.0]) {
            // 5 sigma of slit and random together.
            assert!((fix.theta_deg - theta_deg).abs() < 5.0 * 3.05 / 3600.0);
        }
    }

    #[test]
    fn the_systematic_part_cancels_through_the_same_slit_and_not_between_slits() {
        let quiet = reference(&[
            "scenario.limit_cycle.rate_arcsec_s=0",
            "sensors.sse.random_arcsec=0",
            "sensors.sse.star_arcsec=2",
        ]);
        let fixes = fixes(&quiet, 700.0);
        let [a, b, a_after, b_after] = [0, 1, 2, 3].map(|index| (fixes[index].theta_deg, fixes[index].psi_deg));
        assert_eq!((a, b), (a_after, b_after));
        assert!((a.0 - b.0).abs() > 0.1 / 3600.0 && (a.0 - 90.0).abs() > 0.1 / 3600.0);
    }

    #[test]
    fn the_limit_cycle_shows_in_theta_and_not_in_psi() {
        let exact = ["sensors.sse.random_arcsec=0", "sensors.sse.slit_arcsec=0"];
        let fixes = fixes(&reference(&exact), 1.0);
        // The reference unit's cycle, 4″/s and 5 s, has cos(π/2) = 0 about Y at the start: no departure there.
        assert!((fixes[0].theta_deg - 90.0).abs() < 1e-12 && fixes[0].psi_deg == 0.0);
        let shifted = reference(&[&exact[..], &["scenario.limit_cycle.phase_y_rad=0"]].concat());
        let fixes = self::fixes(&shifted, 1.0);
        assert!(((fixes[0].theta_deg - 90.0) * 3600.0 + 20.0 / std::f64::consts::TAU).abs() < 1e-9);
        assert_eq!(fixes[0].psi_deg, 0.0);
    }

    #[test]
    fn a_star_lies_in_its_own_patch_and_in_the_field_of_all_of_it() {
        for theta_deg in 60..=120 {
            for psi_deg in 0..360 {
                let attitude = [f64::from(theta_deg) * RAD_PER_DEG, (f64::from(psi_deg) + 0.37) * RAD_PER_DEG];
                let boresight = boresight(attitude, 1e6);
                let star = Star::at(boresight);
                assert_eq!(Star::at(star.direction()), star);
                assert!(star.is_in_field(boresight), "{star}");
            }
        }
    }
}
