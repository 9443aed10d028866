//! One head: it senses the motion with its errors and noises, and gives a number for each sample.

use std::f64::consts::PI;

use super::effect::{DeviceEffect, value};
use super::motion::DeviceMotion;
use super::unit::{DeviceUnit, Output};
use crate::noise::Noise;

const PPM: f64 = 1e-6;
const HOUR_S: f64 = 3600.0;
const RAD_PER_ARCSEC: f64 = PI / 648_000.0;
/// Steps of a lag and of rates that change their sign.
const SUB_STEP_S: f64 = 1e-3;
/// Steps of the slow noises.
const SLOW_STEP_S: f64 = 1.0;
/// Processes of the flicker: two a decade from 1 s to 10⁵ s.
const FLICKER_PROCESSES: usize = 11;

/// True calibration of a head: output = (angle − drift) / scale factor.
#[derive(Debug, Clone, PartialEq)]
pub struct HeadTruth {
    /// Relative to 1.
    pub scale_factor_ppm: f64,
    /// Lowers the output.
    pub drift_arcsec_h: f64,
    /// Input axis, a unit vector.
    pub input: [f64; 3],
}

/// Interval of motion that a sample reports.
pub struct Interval<'a> {
    pub motion: &'a DeviceMotion,
    pub from_s: f64,
    pub to_s: f64,
    /// Integral of the rates over it.
    pub angles_arcsec: [f64; 3],
    /// End of the sample in the time of the bench; the unit's clock is fast by `fast`.
    pub end_s: f64,
    pub fast: f64,
}

/// Constants of the injected effects of a head.
struct Errors {
    drift_step: [f64; 2],
    drift_per_k: f64,
    scale_step: [f64; 2],
    asymmetry: f64,
    lag_s: f64,
    stuck: [f64; 2],
    dead: [f64; 2],
    is_inverted: bool,
    factor: f64,
    clip_arcsec_s: f64,
}

impl Errors {
    fn new(effects: &[DeviceEffect], head: usize) -> Errors {
        let of = |code: &str, parameter: &str| value(effects, head, code, parameter);
        let span = |code: &str| [of(code, "time_s"), of(code, "time_s") + of(code, "duration_s")];
        let unless_0 = |number: f64, default: f64| if number == 0.0 { default } else { number };
        Errors {
            drift_step: [of("drift-step", "arcsec_per_h"), of("drift-step", "time_s")],
            drift_per_k: of("drift-temperature", "arcsec_per_h_per_k"),
            scale_step: [of("scale-factor-step", "ppm"), of("scale-factor-step", "time_s")],
            asymmetry: of("scale-factor-asymmetry", "ppm") * PPM,
            lag_s: of("sensor-lag", "time_constant_s"),
            stuck: span("stuck-output"),
            dead: span("dead-output"),
            is_inverted: of("sign-inversion", "on") != 0.0,
            factor: unless_0(of("unit-factor", "factor"), 1.0),
            clip_arcsec_s: unless_0(of("clipping", "arcsec_s"), f64::INFINITY),
        }
    }
}

pub struct Channel {
    pub truth: HeadTruth,
    errors: Errors,
    noise: Noise,
    slow_noise: Noise,
    slow_until_s: f64,
    flicker: [f64; FLICKER_PROCESSES],
    walk_arcsec_s: f64,
    lagging_arcsec_s: Option<f64>,
    /// Counts, with the fraction.
    accumulated: f64,
    rounded: f64,
    last: f64,
}

impl Channel {
    /// A head with errors drawn from the seed.
    pub fn new(unit: &DeviceUnit, head: usize, seed: u64, effects: &[DeviceEffect]) -> Channel {
        // Streams for each head after the plant's.
        let mut random = Noise::new(seed, 20 + head as u64);
        let truth_ppm = unit.scale_factor_ppm * random.normal();
        let drift_arcsec_h = unit.bias_arcsec_h * random.normal();
        let errors = [0; 2].map(|_| unit.misalignment_arcsec * random.normal() * RAD_PER_ARCSEC);
        let injected = value(effects, head, "misalignment", "arcsec") * RAD_PER_ARCSEC;
        let azimuth = value(effects, head, "misalignment", "azimuth_deg").to_radians();
        let nominal = normalised(unit.heads[head].1);
        let input = turned(turned(nominal, errors), [injected * libm::cos(azimuth), injected * libm::sin(azimuth)]);
        let scale_factor_ppm = truth_ppm + value(effects, head, "scale-factor", "ppm");
        Channel {
            truth: HeadTruth { scale_factor_ppm, drift_arcsec_h, input },
            errors: Errors::new(effects, head),
            noise: Noise::new(seed, 40 + head as u64),
            slow_noise: Noise::new(seed, 60 + head as u64),
            slow_until_s: f64::NEG_INFINITY,
            flicker: [0.0; FLICKER_PROCESSES],
            walk_arcsec_s: 0.0,
            lagging_arcsec_s: None,
            accumulated: 0.0,
            rounded: 0.0,
            last: 0.0,
        }
    }

    /// The number of a sample in counts; of a unit that does not round, in arcsec or arcsec/s.
    pub fn sample(&mut self, unit: &DeviceUnit, interval: &Interval) -> f64 {
        let t = interval.end_s;
        self.walk(unit, t);
        let errors = &self.errors;
        let since = |[value, time_s]: [f64; 2]| if t >= time_s { value } else { 0.0 };
        let drift_arcsec_h = self.truth.drift_arcsec_h
            + since(errors.drift_step)
            + errors.drift_per_k * (unit.temperature_c(t) - unit.start_c)
            + unit.bias_instability_arcsec_h * self.flicker.iter().sum::<f64>();
        let drift_arcsec_s = drift_arcsec_h / HOUR_S + self.walk_arcsec_s;
        // As of the default unit: the drift of a sample falls by two parts, its scale factor by one.
        let drift_arcsec = drift_arcsec_s * unit.interval_s * (1.0 - 2.0 * interval.fast);
        let scale_ppm = self.truth.scale_factor_ppm + since(errors.scale_step);
        let scale_factor = (1.0 + scale_ppm * PPM) * (1.0 - interval.fast);
        let asymmetry = errors.asymmetry;
        let (negative, positive) = self.sensed(interval);
        let white = unit.angle_random_walk_arcsec_sqrt_s * unit.interval_s.sqrt() * self.noise.normal();
        let angle = (negative + positive / (1.0 + asymmetry) + white - drift_arcsec) / scale_factor;
        let number = self.number(unit, angle * self.errors.factor);
        self.wired(unit, t, number)
    }

    /// Sensed angles with input rates below and above 0; together below if both count the same.
    fn sensed(&mut self, interval: &Interval) -> (f64, f64) {
        if self.errors.lag_s == 0.0 && self.errors.asymmetry == 0.0 {
            return (self.about_input(interval.angles_arcsec), 0.0);
        }
        let (motion, length_s) = (interval.motion, interval.to_s - interval.from_s);
        let steps = (length_s / SUB_STEP_S).ceil().max(1.0);
        let step_s = length_s / steps;
        let at = |step: f64| motion.at(interval.from_s + step * step_s);
        let (mut before, mut sums) = (at(0.0), (0.0, 0.0));
        for step in 1..=steps as u32 {
            let after = at(f64::from(step));
            let rates = [before.0, after.0].map(|rates| self.about_input(rates));
            let angle = self.about_input(std::array::from_fn(|axis| after.1[axis] - before.1[axis]));
            let (rates, angle) = self.lagged(rates, angle, step_s);
            let share = share_above_0(rates);
            sums = (sums.0 + angle * (1.0 - share), sums.1 + angle * share);
            before = after;
        }
        sums
    }

    fn about_input(&self, vector: [f64; 3]) -> f64 {
        self.truth.input.iter().zip(vector).map(|(input, part)| input * part).sum()
    }

    /// Rates at both ends of a step and its angle behind the lag: y' = (ω − y)/T with a rate that changes evenly.
    fn lagged(&mut self, [from, to]: [f64; 2], angle: f64, step_s: f64) -> ([f64; 2], f64) {
        let lag_s = self.errors.lag_s;
        if lag_s == 0.0 {
            return ([from, to], angle);
        }
        let before = self.lagging_arcsec_s.unwrap_or(from);
        let slope = (to - from) / step_s;
        let after = to - slope * lag_s + (before - from + slope * lag_s) * libm::exp(-step_s / lag_s);
        self.lagging_arcsec_s = Some(after);
        ([before, after], angle - lag_s * (after - before))
    }

    /// Advances the slow noises; the flicker starts in its stationary state.
    fn walk(&mut self, unit: &DeviceUnit, t: f64) {
        while t > self.slow_until_s {
            let is_first = self.slow_until_s == f64::NEG_INFINITY;
            self.slow_until_s = if is_first { SLOW_STEP_S } else { self.slow_until_s + SLOW_STEP_S };
            // Their one-sided spectra add up to 1/(πf).
            let sigma = (libm::log(10.0) / 2.0 / PI).sqrt();
            for (index, process) in self.flicker.iter_mut().enumerate() {
                let time_s = libm::pow(10.0, index as f64 / 2.0);
                let kept = if is_first { 0.0 } else { libm::exp(-SLOW_STEP_S / time_s) };
                *process = kept * *process + sigma * (1.0 - kept * kept).sqrt() * self.slow_noise.normal();
            }
            self.walk_arcsec_s += unit.rate_random_walk_arcsec_s_sqrt_s * SLOW_STEP_S.sqrt() * self.slow_noise.normal();
        }
    }

    /// The number for an angle: of increments no fraction of a count is lost.
    fn number(&mut self, unit: &DeviceUnit, angle_arcsec: f64) -> f64 {
        let own = match unit.output {
            Output::Increment => angle_arcsec,
            Output::Rate => angle_arcsec / unit.interval_s,
        };
        match (unit.count, unit.output) {
            (0.0, _) => own,
            (count, Output::Rate) => (own / count).round(),
            (count, Output::Increment) => {
                self.accumulated += own / count;
                let rounded = self.accumulated.round();
                rounded - std::mem::replace(&mut self.rounded, rounded)
            }
        }
    }

    /// Faults behind the rounding.
    fn wired(&mut self, unit: &DeviceUnit, t: f64, number: f64) -> f64 {
        let errors = &self.errors;
        let within = |[from_s, to_s]: [f64; 2]| t > from_s && t <= to_s;
        let signed = if errors.is_inverted { -number } else { number };
        let limit = unit.limit(errors.clip_arcsec_s.min(unit.range_arcsec_s));
        let clipped = signed.clamp(-limit, limit);
        let sent = match () {
            () if within(errors.dead) => 0.0,
            () if within(errors.stuck) => self.last,
            () => clipped,
        };
        self.last = sent;
        sent
    }
}

/// Share of the angle of a step that is turned with a rate above 0; the rate changes evenly.
fn share_above_0([from, to]: [f64; 2]) -> f64 {
    match (from > 0.0, to > 0.0) {
        (true, true) => 1.0,
        (false, false) => 0.0,
        // Triangles before and after the zero: their angles are as the squares of the rates, with their signs.
        _ => {
            let (above, below) = (from.max(to), from.min(to));
            if above + below == 0.0 { 0.5 } else { above * above / (above * above - below * below) }
        }
    }
}

fn normalised(vector: [f64; 3]) -> [f64; 3] {
    let length = vector.iter().map(|part| part * part).sum::<f64>().sqrt();
    vector.map(|part| part / length)
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// A unit vector turned towards two axes perpendicular to it, rad.
fn turned(axis: [f64; 3], shift: [f64; 2]) -> [f64; 3] {
    let angle = libm::hypot(shift[0], shift[1]);
    if angle == 0.0 {
        return axis;
    }
    let weakest = (0..3).min_by(|one, other| axis[*one].abs().total_cmp(&axis[*other].abs())).unwrap_or(0);
    let first = normalised(cross(axis, std::array::from_fn(|index| f64::from(u8::from(index == weakest)))));
    let second = cross(axis, first);
    let (sin, cos) = libm::sincos(angle);
    std::array::from_fn(|index| cos * axis[index] + sin * (shift[0] * first[index] + shift[1] * second[index]) / angle)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_angle_above_0_is_that_of_the_integrated_rate() {
        // From −1 to 3 in one second: 1/8 below, 9/8 above, 1 in all.
        assert_eq!(share_above_0([-1.0, 3.0]), 9.0 / 8.0);
        assert_eq!(share_above_0([3.0, -1.0]), 9.0 / 8.0);
        assert_eq!([[1.0, 2.0], [-1.0, -2.0]].map(share_above_0), [1.0, 0.0]);
    }

    #[test]
    fn a_turned_axis_has_the_angle_of_its_turn() {
        let nominal = normalised([1.0, 1.0, 1.0]);
        let axis = turned(nominal, [0.3, -0.4]);
        let along: f64 = axis.iter().zip(nominal).map(|(one, other)| one * other).sum();
        assert!((along - 0.5f64.cos()).abs() < 1e-12);
        let length: f64 = axis.iter().map(|part| part * part).sum();
        assert!((length - 1.0).abs() < 1e-12);
    }
}
