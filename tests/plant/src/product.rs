//! A sensed rate outside the catalogue: a coefficient times a product of rates, their magnitudes, accelerations, temperature, θ and time.

use crate::motion::State;

/// Prefix of the code of a product: `product rate_x*abs(rate_z)^2`.
pub const PREFIX: &str = "product ";

/// State of motion and unit that factors are made of.
pub struct Surroundings<'a> {
    pub state: &'a State,
    /// Change of the rates, arcsec/s².
    pub accelerations: [f64; 3],
    /// Electronics above their reference temperature.
    pub electronics_k: f64,
    pub t: f64,
}

type Factor = fn(&Surroundings) -> f64;

const FACTORS: [(&str, Factor); 12] = [
    ("rate_x", |s| s.state.rates[0]),
    ("rate_y", |s| s.state.rates[1]),
    ("rate_z", |s| s.state.rates[2]),
    ("abs(rate_x)", |s| s.state.rates[0].abs()),
    ("abs(rate_y)", |s| s.state.rates[1].abs()),
    ("abs(rate_z)", |s| s.state.rates[2].abs()),
    ("acceleration_x", |s| s.accelerations[0]),
    ("acceleration_y", |s| s.accelerations[1]),
    ("acceleration_z", |s| s.accelerations[2]),
    ("temperature", |s| s.electronics_k),
    ("theta", |s| s.state.sun_deg.map_or(0.0, |(theta_deg, _)| theta_deg - 90.0)),
    ("time", |s| s.t / 86_400.0),
];

#[derive(Clone)]
pub struct Product {
    coefficient: f64,
    factors: Vec<(Factor, i32)>,
}

impl Product {
    /// Reads `rate_x*abs(rate_z)^2`.
    ///
    /// # Panics
    /// On an unknown factor.
    pub fn new(formula: &str, coefficient: f64) -> Product {
        let factor = |text: &str| {
            let (name, power) = text.split_once('^').unwrap_or((text, "1"));
            let found = FACTORS.iter().find(|(known, _)| *known == name.trim());
            let (_, factor) = found.unwrap_or_else(|| panic!("{formula}: no factor {name}"));
            (*factor, power.parse().unwrap_or_else(|_| panic!("{formula}: no power {power}")))
        };
        Product { coefficient, factors: formula.split('*').map(factor).collect() }
    }

    /// Rate that the gyro senses in addition, arcsec/s.
    pub fn rate(&self, surroundings: &Surroundings) -> f64 {
        self.factors.iter().fold(self.coefficient, |rate, (factor, power)| rate * factor(surroundings).powi(*power))
    }
}
