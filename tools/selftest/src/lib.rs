//! Every number that the paper or the model's page prints, simulated and measured again.
//!
//! An [`Experiment`] is a unit with one effect at the paper's value, and a way to measure it from what a receiver has:
//! increments, flags, temperatures, the instants of reception, and the reference attitude that sensors and ground know.
//! A [`PublishedValue`] is one printed number with its source. It is off when the measurement lies more than [`LIMIT_SIGMA`] away.
//!
//! ```
//! use geu_selftest::{experiments, measure};
//! let timing = experiments().find(|experiment| experiment.name == "timing").expect("in the list");
//! for result in measure(timing, 1, &[]).expect("a valid configuration") {
//!     assert!(result.holds(), "{}", result.claim.what);
//! }
//! ```

mod alignment;
mod drift;
mod estimate;
mod motion;
mod pivot;
mod receiver;
mod scale_factor;
mod unit;

pub use estimate::Estimate;
pub use receiver::{Receiver, Row};
pub use scale_factor::{BestLine, transfer_function};

use geu_model::Configuration;
use geu_model::configuration::ConfigurationError;

/// A measurement further off than this is wrong.
pub const LIMIT_SIGMA: f64 = 5.0;

/// What a claim says of its number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Expected {
    /// It is this, printed to this half of its last digit.
    Value(f64, f64),
    /// It is no more than this.
    AtMost(f64),
    Between(f64, f64),
}

impl Expected {
    pub fn excess(self, value: f64) -> f64 {
        let (least, greatest) = match self {
            Expected::Value(expected, rounding) => (expected - rounding, expected + rounding),
            Expected::AtMost(limit) => (f64::NEG_INFINITY, limit),
            Expected::Between(least, greatest) => (least, greatest),
        };
        // What is not a number is as far off as can be.
        if value.is_nan() { f64::INFINITY } else { (least - value).max(value - greatest).max(0.0) }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PublishedValue {
    pub what: &'static str,
    /// Section, table, figure or equation of the paper; `model` where the model's page decides.
    pub source: &'static str,
    pub expected: Expected,
    pub unit: &'static str,
}

/// A unit, and what is to be measured of it.
pub struct Experiment {
    pub name: &'static str,
    /// Whether its output depends on the seed.
    pub noise: bool,
    /// The unit: one effect at the paper's value, all others absent.
    pub configuration: &'static str,
    /// What is claimed of it, in the order of measurement.
    pub claims: &'static [PublishedValue],
    /// Measures it, one estimate for each claim.
    pub measure: fn(&mut Receiver) -> Vec<Estimate>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClaimCheck {
    pub claim: &'static PublishedValue,
    pub measured: Estimate,
}

impl ClaimCheck {
    /// How far the measurement is off, in its own sigma.
    pub fn off_sigma(&self) -> f64 {
        // Sigma of a number that has none is the rounding of the arithmetic.
        let excess = self.claim.expected.excess(self.measured.value);
        excess / self.measured.sigma.max(1e-12 * self.measured.value.abs()).max(f64::MIN_POSITIVE)
    }

    /// Whether the measurement bears the claim out.
    pub fn holds(&self) -> bool {
        self.off_sigma() <= LIMIT_SIGMA
    }
}

pub fn experiments() -> impl Iterator<Item = &'static Experiment> {
    [
        unit::EXPERIMENTS,
        drift::EXPERIMENTS,
        scale_factor::EXPERIMENTS,
        pivot::EXPERIMENTS,
        alignment::EXPERIMENTS,
        motion::EXPERIMENTS,
    ]
    .into_iter()
    .flatten()
}

/// Carries an experiment out; overrides, each `PATH=VALUE`, make another unit of it.
///
/// # Errors
/// Overrides that make no valid configuration.
pub fn measure(
    experiment: &'static Experiment,
    seed: u64,
    overrides: &[String],
) -> std::result::Result<Vec<ClaimCheck>, ConfigurationError> {
    let mut configuration = Configuration::parse(experiment.name, experiment.configuration, overrides)?;
    configuration.seed = seed;
    let measured = (experiment.measure)(&mut Receiver::new(&configuration));
    assert_eq!(measured.len(), experiment.claims.len(), "{}: an estimate for each claim", experiment.name);
    Ok(experiment.claims.iter().zip(measured).map(|(claim, measured)| ClaimCheck { claim, measured }).collect())
}
