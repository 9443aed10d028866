//! Temperatures: the electronics follow a configured course; the heater holds the sensor (Casteren §2).

use crate::effect::Temperatures;
use crate::parameter_spec::numbers;
use crate::time_profile::Interval;
use crate::units::{S_PER_DAY, S_PER_H};

/// Sensor temperature with the heater on.
pub const SENSOR_NOMINAL_C: f64 = 70.0;
/// Half width of the band in which the heater is said to hold.
pub const SENSOR_BAND_K: f64 = 1.0;
/// Time constant of warm-up and cool-down, first-order.
const SENSOR_TIME_CONSTANT_S: f64 = 20.0 * 60.0;
/// Length over which the slope of a table is taken.
pub const RATE_SPAN_S: f64 = 300.0;

numbers! {
    /// Course of the electronics temperature: mean, plus a sine, plus a trend.
    pub struct Electronics {
        /// Mean; a table replaces it.
        mean_c: 20.0, -60.0..=100.0, "°C";
        /// Amplitude of the sine.
        amplitude_k: 0.0, 0.0..=100.0, "K";
        /// Period of the sine; an orbit.
        period_s: 6180.0, 1.0..=1e10, "s";
        /// Phase of the sine at the start.
        phase_rad: 0.0, -100.0..=100.0, "rad";
        /// Trend.
        trend_k_per_day: 0.0, -1000.0..=1000.0, "K/d";
        /// Temperature at which the calibration holds; effects per K count from here.
        reference_c: 20.0, -60.0..=100.0, "°C";
    }
}

/// The electronics' course with its table.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ElectronicsCourse {
    pub numbers: Electronics,
    /// Points (time since the start in s, °C) in order of time, joined by straight lines and held beyond the ends;
    /// if not empty, they replace the mean.
    pub table: Vec<(f64, f64)>,
}

impl ElectronicsCourse {
    /// Takes measured temperatures, (time since the start in s, °C), in place of what is configured; the reference stays.
    pub fn follow(&mut self, measured: Vec<(f64, f64)>) {
        (self.numbers.amplitude_k, self.numbers.trend_k_per_day) = (0.0, 0.0);
        self.table = measured;
    }

    #[inline]
    pub fn at_c(&self, t_s: f64) -> f64 {
        let Electronics { mean_c, amplitude_k, period_s, phase_rad, trend_k_per_day, .. } = self.numbers;
        let mut temperature_c = if self.table.is_empty() { mean_c } else { interpolate(&self.table, t_s) };
        if amplitude_k != 0.0 {
            temperature_c += amplitude_k * libm::sin(std::f64::consts::TAU * t_s / period_s + phase_rad);
        }
        temperature_c + trend_k_per_day * t_s / S_PER_DAY
    }

    /// An interval of this true time, as time courses use it.
    pub fn interval(&self, start_s: f64, end_s: f64) -> Interval {
        Temperatures::from_course(self, 0.5 * (start_s + end_s), SENSOR_NOMINAL_C).interval(start_s, end_s)
    }

    /// Rate of change, K/h. That of a table is the slope over [`RATE_SPAN_S`], in which the steps of a recorded temperature average out.
    #[inline]
    pub fn rate_k_per_h(&self, t_s: f64) -> f64 {
        let Electronics { amplitude_k, period_s, phase_rad, trend_k_per_day, .. } = self.numbers;
        let mut rate_k_per_s = trend_k_per_day / S_PER_DAY;
        if let (Some(first), Some(last)) = (self.table.first(), self.table.last()) {
            // Times of a recording may run back.
            let at = |t_s: f64| t_s.max(first.0).min(last.0);
            let (from_s, to_s) = (at(t_s - 0.5 * RATE_SPAN_S), at(t_s + 0.5 * RATE_SPAN_S));
            if to_s > from_s {
                rate_k_per_s += (interpolate(&self.table, to_s) - interpolate(&self.table, from_s)) / (to_s - from_s);
            }
        }
        if amplitude_k != 0.0 {
            let turn_rad_s = std::f64::consts::TAU / period_s;
            rate_k_per_s += amplitude_k * turn_rad_s * libm::cos(turn_rad_s * t_s + phase_rad);
        }
        rate_k_per_s * S_PER_H
    }
}

/// Index of the first point after a time. Tables are mostly evenly spaced: where they are, the place is known at once.
fn after(table: &[(f64, f64)], t_s: f64) -> usize {
    if let (Some(first), Some(last)) = (table.first(), table.last()) {
        let spacing_s = (last.0 - first.0) / (table.len() - 1).max(1) as f64;
        let guess = (((t_s - first.0) / spacing_s) as usize).saturating_add(1);
        let is_after = |index: usize| table.get(index).is_none_or(|point| point.0 > t_s);
        if (1..=table.len()).contains(&guess) && is_after(guess) && !is_after(guess - 1) {
            return guess;
        }
    }
    table.partition_point(|point| point.0 <= t_s)
}

/// Straight lines between points in order of time, held beyond the ends; NaN where there are none.
pub(crate) fn interpolate(table: &[(f64, f64)], t_s: f64) -> f64 {
    let after = after(table, t_s);
    match (after.checked_sub(1).map(|before| table[before]), table.get(after)) {
        (Some(before), Some(after)) => before.1 + (after.1 - before.1) * (t_s - before.0) / (after.0 - before.0),
        (Some(point), None) => point.1,
        (None, Some(point)) => point.1,
        (None, None) => f64::NAN,
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensor {
    pub temperature_c: f64,
    pub heater_on: bool,
}

impl Sensor {
    pub const WARM: Sensor = Sensor { temperature_c: SENSOR_NOMINAL_C, heater_on: true };

    /// After `length_s` beside electronics at `electronics_c`: first-order towards 70 °C, or towards the electronics
    /// with the heater off.
    #[inline]
    pub fn advance(&mut self, length_s: f64, electronics_c: f64) {
        let target_c = if self.heater_on { SENSOR_NOMINAL_C } else { electronics_c };
        if self.temperature_c != target_c {
            self.temperature_c =
                target_c + (self.temperature_c - target_c) * libm::exp(-length_s / SENSOR_TIME_CONSTANT_S);
        }
    }

    /// True within 70 ± 1 °C.
    pub fn in_band(&self) -> bool {
        (self.temperature_c - SENSOR_NOMINAL_C).abs() <= SENSOR_BAND_K
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_joined_by_straight_lines_and_held_beyond_its_ends() {
        let course = ElectronicsCourse { table: vec![(10.0, 20.0), (20.0, 22.0)], ..ElectronicsCourse::default() };
        assert_eq!([0.0, 10.0, 15.0, 20.0, 99.0].map(|t_s| course.at_c(t_s)), [20.0, 20.0, 21.0, 22.0, 22.0]);
    }

    #[test]
    fn the_rate_is_the_derivative_of_the_course_and_the_slope_of_a_table() {
        let mut course = ElectronicsCourse::default();
        (course.numbers.amplitude_k, course.numbers.trend_k_per_day) = (2.0, 24.0);
        for t_s in [0.0, 1000.0, 4000.0] {
            let slope_k_per_h = (course.at_c(t_s + 1.0) - course.at_c(t_s - 1.0)) / 2.0 * 3600.0;
            assert!((course.rate_k_per_h(t_s) - slope_k_per_h).abs() < 1e-5, "{t_s} s");
        }
        // Steps of a hundredth of a degree on a slope of 3.6 K/h.
        let recorded = (0..2000).map(|node| (f64::from(node), (f64::from(node) * 0.1).round() * 0.01)).collect();
        course.follow(recorded);
        for t_s in [0.0, 777.0, 1999.0] {
            assert!((course.rate_k_per_h(t_s) - 3.6).abs() < 0.3, "{t_s} s: {}", course.rate_k_per_h(t_s));
        }
    }

    #[test]
    fn a_table_gives_the_same_values_for_any_spacing() {
        let even: Vec<(f64, f64)> = (0..50).map(|index| (f64::from(index) * 0.5, f64::from(index * index))).collect();
        let uneven: Vec<(f64, f64)> = even.iter().map(|(t_s, celsius)| (t_s * t_s, *celsius)).collect();
        for table in [&even[..], &uneven[..], &even[..1], &[]] {
            for tenth in -10..7000 {
                let t_s = f64::from(tenth) * 0.1;
                assert_eq!(after(table, t_s), table.partition_point(|point| point.0 <= t_s), "{t_s}");
            }
        }
    }

    #[test]
    fn a_sensor_without_heater_cools_by_the_time_constant() {
        let mut sensor = Sensor { heater_on: false, ..Sensor::WARM };
        for _ in 0..2400 {
            sensor.advance(0.5, 20.0);
        }
        // After one time constant of 1200 s a share of 1/e of the 50 K is left.
        assert!((sensor.temperature_c - (20.0 + 50.0 / std::f64::consts::E)).abs() < 1e-9);
    }
}
