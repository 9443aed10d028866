//! Injected effects, by the codes of the model's page, each with its time course; and some that the page does not have.

use std::f64::consts::TAU;

use crate::product::{self, Product};
use crate::{GYROS, Gyro};

/// Suffixes of time courses; a longer one before its own end.
const COURSES: [&str; 7] = ["-temperature-rate", "-temperature", "-step", "-ramp", "-periodic", "-settling", "-pulse"];

/// An effect: a code, with a suffix of `COURSES` for a time course, and its numbers by their configuration names.
#[derive(Debug, Clone)]
pub struct PlantedEffect {
    /// `drift-ramp`, or `product rate_x*abs(rate_z)`.
    pub code: String,
    /// Affected gyros; empty for an effect of the unit; two for an `axis-swap`.
    pub gyros: Vec<Gyro>,
    /// `("arcsec_per_h_per_day", 420.0)`; a switch is `("on", 1.0)`.
    pub parameters: Vec<(String, f64)>,
}

impl PlantedEffect {
    pub fn new(code: &str, gyros: &[Gyro], parameters: &[(&str, f64)]) -> PlantedEffect {
        let parameters = parameters.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
        PlantedEffect { code: code.to_owned(), gyros: gyros.to_vec(), parameters }
    }

    /// The product that the effect adds to the sensed rate of a gyro, if it is one.
    pub(crate) fn product(&self, gyro: Gyro) -> Option<Product> {
        let formula = self.code.strip_prefix(product::PREFIX)?;
        self.gyros.contains(&gyro).then(|| Product::new(formula, self.parameters[0].1))
    }

    /// True if the independent model has the effect, with this time course and these parameters.
    pub fn is_known(&self) -> bool {
        self.code.starts_with(product::PREFIX) || self.contributions().is_ok()
    }

    /// The contribution of each parameter to each of the gyros.
    pub(crate) fn terms(&self) -> Vec<Term> {
        if self.code.starts_with(product::PREFIX) {
            return Vec::new();
        }
        self.contributions().unwrap_or_else(|unknown| panic!("{unknown}"))
    }

    fn contributions(&self) -> Result<Vec<Term>, String> {
        let has = |code: &str| QUANTITIES.iter().any(|(known, ..)| *known == code);
        let of_course = |suffix: &&'static str| Some((self.code.strip_suffix(*suffix)?, *suffix));
        let found = COURSES.iter().filter_map(of_course).find(|(base, _)| has(base));
        let (base, course) = found.filter(|_| !has(&self.code)).unwrap_or((self.code.as_str(), ""));
        let shape = |name: &str| self.parameters.iter().find(|(own, _)| own == name).map_or(0.0, |(_, value)| *value);
        let (prefix, suffix, shapes, course): (_, _, &[&str], _) = match course {
            "" => ("", "", &[], Course::Constant),
            "-step" => ("", "", &["time_s"], Course::Step { time_s: shape("time_s") }),
            "-ramp" => ("", "_per_day", &[], Course::Ramp),
            "-temperature-rate" => ("", "_per_k_per_h", &[], Course::TemperatureRate),
            "-temperature" => ("", "_per_k", &[], Course::Temperature),
            "-periodic" => {
                let course = Course::Periodic { period_s: shape("period_s"), phase_rad: shape("phase_rad") };
                ("amplitude_", "", &["period_s", "phase_rad"], course)
            }
            "-settling" => {
                let course = Course::Settling { time_s: shape("time_s"), time_constant_s: shape("time_constant_s") };
                ("", "", &["time_s", "time_constant_s"], course)
            }
            "-pulse" => {
                let course = Course::Pulse { time_s: shape("time_s"), duration_s: shape("duration_s") };
                ("", "", &["time_s", "duration_s"], course)
            }
            _ => return Err(format!("{}: no such course", self.code)),
        };
        let gyros = if self.gyros.is_empty() { &GYROS[..] } else { &self.gyros };
        let mut all = Vec::new();
        for (name, value) in &self.parameters {
            let amplitude = name.strip_prefix(prefix).and_then(|name| name.strip_suffix(suffix));
            let found = QUANTITIES.iter().find_map(|(code, own, quantity)| match quantity {
                _ if *code != base => None,
                quantity if quantity.is_shape() => (own == name).then_some((*quantity, Course::Constant)),
                quantity => (Some(*own) == amplitude).then_some((*quantity, course)),
            });
            if found.is_none() && !shapes.contains(&name.as_str()) {
                return Err(format!("{}: no parameter {name}", self.code));
            }
            if let Some((quantity, course)) = found {
                all.extend(gyros.iter().map(|gyro| Term { gyro: *gyro, quantity, value: *value, course }));
            }
        }
        Ok(all)
    }
}

/// Every code with each of its parameters.
#[cfg(test)]
pub(crate) fn catalogue() -> impl Iterator<Item = (&'static str, &'static str)> {
    QUANTITIES.iter().map(|(code, parameter, _)| (*code, *parameter))
}

/// A part of a quantity of one gyro.
pub(crate) struct Term {
    pub gyro: Gyro,
    pub quantity: Quantity,
    pub value: f64,
    pub course: Course,
}

impl Term {
    /// Value at time `t` since the start, with the electronics above their reference temperature and changing it.
    pub fn at(&self, t: f64, electronics_k: f64, electronics_k_per_h: f64) -> f64 {
        self.value
            * match self.course {
                Course::Constant => 1.0,
                Course::Step { time_s } => f64::from(u8::from(t >= time_s)),
                Course::Ramp => t / 86_400.0,
                Course::Temperature => electronics_k,
                Course::TemperatureRate => electronics_k_per_h,
                Course::Settling { time_s, .. } if t < time_s => 0.0,
                Course::Settling { time_s, time_constant_s } => libm::exp((time_s - t) / time_constant_s),
                Course::Pulse { time_s, duration_s } => f64::from(u8::from(t >= time_s && t < time_s + duration_s)),
                Course::Periodic { period_s, phase_rad } => libm::sin(TAU * t / period_s + phase_rad),
            }
    }
}

#[derive(Clone, Copy)]
pub(crate) enum Course {
    Constant,
    Step { time_s: f64 },
    Ramp,
    Temperature,
    TemperatureRate,
    Settling { time_s: f64, time_constant_s: f64 },
    Pulse { time_s: f64, duration_s: f64 },
    Periodic { period_s: f64, phase_rad: f64 },
}

/// The quantities of one gyro at an instant; an effect of the unit is the same for all.
#[derive(Clone, Copy)]
pub(crate) struct Quantities([f64; QUANTITIES.len()]);

impl Quantities {
    /// All absent.
    pub const ABSENT: Quantities = Quantities([0.0; QUANTITIES.len()]);

    pub fn add(&mut self, quantity: Quantity, value: f64) {
        self.0[quantity as usize] += value;
    }

    pub fn get(&self, quantity: Quantity) -> f64 {
        self.0[quantity as usize]
    }
}

/// Declares the quantities with their code and parameter.
macro_rules! quantities {
    ($($quantity:ident: $code:literal $parameter:literal,)*) => {
        #[derive(Clone, Copy, PartialEq)]
        pub(crate) enum Quantity { $($quantity),* }

        const QUANTITIES: &[(&str, &str, Quantity)] = &[$(($code, $parameter, Quantity::$quantity)),*];
    };
}

quantities! {
    Drift: "drift" "arcsec_per_h",
    DriftSensorTemperature: "drift-sensor-temperature" "arcsec_per_h_per_k",
    DriftRandomWalk: "drift-random-walk" "arcsec_per_s_per_sqrt_s",
    CorrelationTime: "drift-random-walk" "correlation_time_s",
    AngleRandomWalk: "angle-random-walk" "arcsec_per_sqrt_s",
    ScaleFactor: "scale-factor" "ppm",
    Nonlinearity: "scale-factor-nonlinearity" "cubic_ppm",
    Asymmetry: "scale-factor-asymmetry" "ppm",
    Quadratic: "scale-factor-quadratic" "ppm",
    ScaleFactorNoise: "scale-factor-noise" "ppm_sqrt_s",
    DeadZone: "dead-zone" "arcsec_per_s",
    SensorLag: "sensor-lag" "time_constant_s",
    BiasInstability: "bias-instability" "arcsec_per_h",
    Hysteresis: "drift-temperature-hysteresis" "arcsec_per_h",
    HysteresisWidth: "drift-temperature-hysteresis" "width_k",
    ClockFrequency: "clock-frequency" "ppm",
    PivotClearance: "pivot-clearance" "clearance_arcsec",
    PivotPreferred: "pivot-clearance" "preferred_arcsec",
    MisalignmentX: "misalignment" "x_arcsec",
    MisalignmentY: "misalignment" "y_arcsec",
    MisalignmentZ: "misalignment" "z_arcsec",
    MisalignmentThermal: "misalignment-thermal" "arcsec_per_deg",
    ThermalTime: "misalignment-thermal" "time_constant_s",
    OutputAxisAcceleration: "output-axis-acceleration" "seconds",
    Anisoinertia: "anisoinertia" "seconds",
    TimeOffset: "time-offset" "seconds",
    LostCounts: "lost-counts" "counts",
    LostCountsTime: "lost-counts" "time_s",
    SignInversion: "sign-inversion" "on",
    AxisSwap: "axis-swap" "on",
    StuckOutput: "stuck-output" "on",
    // Outside the catalogue. Sensed rate + per_arcsec_s · ω_y²:
    RateSquared: "rate-squared-coupling" "per_arcsec_s",
    // Sensed rate + per_arcsec_s · ω_x · ω_z:
    RateProduct: "rate-product-coupling" "per_arcsec_s",
    // Added to the drift: ppm of |ω_z|.
    RateDrift: "rate-drift" "ppm",
    // The count follows the angle with this play.
    Backlash: "count-backlash" "play_arcsec",
}

impl Quantity {
    /// True for a parameter with a default and without a time course.
    fn is_shape(self) -> bool {
        use Quantity::*;
        [CorrelationTime, HysteresisWidth, PivotPreferred, ThermalTime, LostCountsTime].contains(&self)
    }
}
