//! The survey: θ and ψ leg by leg, and the inertial rates that follow.

use std::f64::consts::TAU;

use super::State;
use crate::noise::Noise;

const ARCSEC_PER_DEG: f64 = 3600.0;
/// 360° in 365.25 days (Casteren §6).
const SUN_ARCSEC_S: f64 = 360.0 * ARCSEC_PER_DEG / (365.25 * 86_400.0);
/// 360° about the sun vector in an orbit of 6180 s (Casteren §5).
const ORBITAL_ARCSEC_S: f64 = 360.0 * ARCSEC_PER_DEG / 6180.0;
/// Survey scan about Z (Casteren §5).
const SURVEY_ARCSEC_S: f64 = 3.85 * 60.0;
/// Scan about Y, 12°/min (Casteren §5).
const SLEW_ARCSEC_S: f64 = 12.0 * 60.0;
const ACCELERATION_ARCSEC_S2: f64 = 36.0;

/// A motion segment: the rate rises in a ramp, holds and falls in a ramp, or is 0.
struct Leg {
    start_s: f64,
    duration_s: f64,
    ramp_s: f64,
    theta_deg: f64,
    psi_deg: f64,
    rates_arcsec_s: [f64; 2],
}

impl Leg {
    /// At a time since the leg's start, as parts of the full rate: the rate, and the time at full rate that turns as far.
    fn profile(&self, t: f64) -> (f64, f64) {
        let (t, left) = (t.clamp(0.0, self.duration_s), (self.duration_s - t).max(0.0));
        if self.ramp_s == 0.0 {
            (0.0, 0.0)
        } else if t < self.ramp_s {
            (t / self.ramp_s, t * t / (2.0 * self.ramp_s))
        } else if left > self.ramp_s {
            (1.0, t - self.ramp_s / 2.0)
        } else {
            (left / self.ramp_s, self.duration_s - self.ramp_s - left * left / (2.0 * self.ramp_s))
        }
    }
}

pub struct Survey {
    legs: Vec<Leg>,
    /// Rate, angular frequency and phase of the limit cycle, about X and about Y.
    limit_cycle: [(f64, f64, f64); 2],
}

impl Survey {
    /// Scans about the sun vector at several θ, turns about Y both ways at several speeds, slews that do both, rests.
    pub fn drawn(random: &mut Noise, duration_s: f64, has_limit_cycle: bool) -> Survey {
        // At most 5″/s, period 5 s (Casteren §3.3).
        let share = if has_limit_cycle { 1.0 } else { 0.0 };
        let limit_cycle = [0; 2]
            .map(|_| (share * random.uniform(3.5, 4.5), TAU / random.uniform(4.9, 5.1), random.uniform(0.0, TAU)));
        let mut motion = Survey { legs: Vec::new(), limit_cycle };
        motion.rest(90.0, random.uniform(0.0, 360.0), 0.0);
        motion.turn_psi(ORBITAL_ARCSEC_S, random.uniform(60.0, 110.0));
        motion.wait(600.0);
        for to_deg in [60.0, 120.0, 60.0] {
            motion.turn_theta(SLEW_ARCSEC_S, to_deg);
            motion.wait(random.uniform(60.0, 180.0));
        }
        motion.turn_psi(ORBITAL_ARCSEC_S, random.uniform(60.0, 110.0));
        motion.turn(SLEW_ARCSEC_S / 2.0, [30.0, -30.0]);
        while motion.end_s() < duration_s {
            let way = random.one_of(&[-1.0, 1.0]);
            motion.wait(random.uniform(120.0, 600.0));
            let speed = SLEW_ARCSEC_S * random.one_of(&[0.25, 0.5, 1.0]);
            let to_deg = random.uniform(60.0, 120.0);
            // Some slews turn about the sun vector too.
            let psi_deg = random.one_of(&[0.0, 0.0, 30.0]);
            motion.turn(speed, [to_deg - motion.end_deg().0, way * psi_deg]);
            motion.wait(random.uniform(20.0, 120.0));
            let rate = SURVEY_ARCSEC_S / libm::sin(to_deg.to_radians());
            motion.turn_psi(rate, way * random.uniform(10.0, 40.0));
        }
        motion.wait(f64::INFINITY);
        motion
    }

    pub fn at(&self, t: f64) -> State {
        let leg = &self.legs[self.legs.partition_point(|leg| leg.start_s <= t).saturating_sub(1)];
        let (rate, turned_s) = leg.profile(t - leg.start_s);
        let [theta_rate, psi_rate] = leg.rates_arcsec_s.map(|full| full * rate);
        let [theta_deg, psi_deg] = [(leg.theta_deg, leg.rates_arcsec_s[0]), (leg.psi_deg, leg.rates_arcsec_s[1])]
            .map(|(start, full)| start + full * turned_s / ARCSEC_PER_DEG);
        let (sin_theta, cos_theta) = libm::sincos(theta_deg.to_radians());
        let (sin_psi, cos_psi) = libm::sincos(psi_deg.to_radians());
        let [cycle_x, cycle_y] =
            self.limit_cycle.map(|(rate, frequency, phase)| rate * libm::sin(frequency * t + phase));
        // Casteren eqs 5, 6
        let rates = [
            psi_rate * cos_theta + SUN_ARCSEC_S * cos_psi * sin_theta + cycle_x,
            theta_rate - SUN_ARCSEC_S * sin_psi + cycle_y,
            psi_rate * sin_theta - SUN_ARCSEC_S * cos_psi * cos_theta,
        ];
        State { rates, sun_deg: Some((theta_deg, psi_deg.rem_euclid(360.0))) }
    }

    fn end_s(&self) -> f64 {
        self.legs.last().map_or(0.0, |leg| leg.start_s + leg.duration_s)
    }

    /// θ and ψ where the last leg ends.
    fn end_deg(&self) -> (f64, f64) {
        let leg = &self.legs[self.legs.len() - 1];
        let turned = |rate: f64| rate * leg.profile(leg.duration_s).1 / ARCSEC_PER_DEG;
        (leg.theta_deg + turned(leg.rates_arcsec_s[0]), leg.psi_deg + turned(leg.rates_arcsec_s[1]))
    }

    fn rest(&mut self, theta_deg: f64, psi_deg: f64, duration_s: f64) {
        let start_s = self.end_s();
        self.legs.push(Leg { start_s, duration_s, ramp_s: 0.0, theta_deg, psi_deg, rates_arcsec_s: [0.0; 2] });
    }

    fn wait(&mut self, duration_s: f64) {
        let (theta_deg, psi_deg) = self.end_deg();
        self.rest(theta_deg, psi_deg, duration_s);
    }

    /// About the sun vector.
    fn turn_psi(&mut self, rate_arcsec_s: f64, by_deg: f64) {
        self.turn(rate_arcsec_s, [0.0, by_deg]);
    }

    /// About Y.
    fn turn_theta(&mut self, rate_arcsec_s: f64, to_deg: f64) {
        self.turn(rate_arcsec_s, [to_deg - self.end_deg().0, 0.0]);
    }

    /// Turns θ and ψ at once, the larger turn at this rate.
    fn turn(&mut self, rate_arcsec_s: f64, by_deg: [f64; 2]) {
        let farther_deg = by_deg[0].abs().max(by_deg[1].abs());
        // A short turn does not reach its rate.
        let reached = rate_arcsec_s.min((farther_deg * ARCSEC_PER_DEG * ACCELERATION_ARCSEC_S2).sqrt());
        let ramp_s = reached / ACCELERATION_ARCSEC_S2;
        let (start_s, (theta_deg, psi_deg)) = (self.end_s(), self.end_deg());
        let duration_s = farther_deg * ARCSEC_PER_DEG / reached + ramp_s;
        let rates_arcsec_s = by_deg.map(|by_deg| reached * by_deg / farther_deg);
        self.legs.push(Leg { start_s, duration_s, ramp_s, theta_deg, psi_deg, rates_arcsec_s });
    }
}
