//! Every number that the paper or the model's page prints, simulated and measured.
//!
//! An [`Experiment`] is a unit with one effect at the paper's value, and a way to measure it from what a receiver has:
//! increments, flags, temperatures, the instants of reception, and the reference attitude that sensors and ground know.
//! A [`PublishedValue`] is one printed number with its source. A measurement more than [`LIMIT_SIGMA`] from it is a failure.
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
mod further;
mod motion;
mod pivot;
mod receiver;
mod scale_factor;
mod unit;

pub use estimate::Estimate;
pub use receiver::{Receiver, Row};
pub use scale_factor::{BestLine, transfer_function};

use std::sync::LazyLock;

use geu_model::Configuration;
use geu_model::configuration::{ConfigText, ConfigurationError, Node};
use geu_model::parameter_spec::ValueFormat;

/// Largest accepted distance of a measurement from the expected range.
pub const LIMIT_SIGMA: f64 = 5.0;

/// Range in which a published value must lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Expected {
    /// The value, and half of its last printed digit.
    Value(f64, f64),
    /// An upper limit.
    AtMost(f64),
    Between(f64, f64),
}

impl Expected {
    /// Distance of `value` from the range; infinite for NaN.
    pub fn excess(self, value: f64) -> f64 {
        let (min, max) = match self {
            Expected::Value(expected, rounding) => (expected - rounding, expected + rounding),
            Expected::AtMost(limit) => (f64::NEG_INFINITY, limit),
            Expected::Between(min, max) => (min, max),
        };
        if value.is_nan() { f64::INFINITY } else { (min - value).max(value - max).max(0.0) }
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

type Measure = fn(&mut Receiver) -> Vec<Estimate>;

/// The name of an experiment of `experiments.toml`, and how it is measured.
type Measurement = (&'static str, Measure);

/// A unit, and the measurements of it.
pub struct Experiment {
    pub name: &'static str,
    /// True if its output depends on the seed.
    pub noise: bool,
    /// The unit: one effect at the paper's value, all others absent.
    pub configuration: &'static str,
    /// Published values, in the order of measurement.
    pub claims: Vec<PublishedValue>,
    /// Measures it, one estimate for each claim.
    pub measure: Measure,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClaimCheck {
    pub claim: &'static PublishedValue,
    pub measured: Estimate,
}

impl ClaimCheck {
    /// Distance of the measurement from the expected range, in its own sigma.
    pub fn off_sigma(&self) -> f64 {
        // A measurement without sigma has the rounding error of the arithmetic.
        let excess = self.claim.expected.excess(self.measured.value);
        excess / self.measured.sigma.max(1e-12 * self.measured.value.abs()).max(f64::MIN_POSITIVE)
    }

    /// True if the measurement agrees with the published value.
    pub fn holds(&self) -> bool {
        self.off_sigma() <= LIMIT_SIGMA
    }
}

pub fn experiments() -> impl Iterator<Item = &'static Experiment> {
    static TEXT: LazyLock<ConfigText> = LazyLock::new(|| {
        ConfigText::parse("experiments.toml", include_str!("experiments.toml"))
            .unwrap_or_else(|error| panic!("{error}"))
    });
    static EXPERIMENTS: LazyLock<Vec<Experiment>> = LazyLock::new(|| {
        let nodes = TEXT.root().tables("experiment");
        let read = nodes.and_then(|nodes| nodes.iter().map(Experiment::read).collect());
        read.unwrap_or_else(|error| panic!("{error}"))
    });
    EXPERIMENTS.iter()
}

const MEASUREMENTS: [&[Measurement]; 7] = [
    unit::MEASUREMENTS,
    drift::MEASUREMENTS,
    scale_factor::MEASUREMENTS,
    pivot::MEASUREMENTS,
    alignment::MEASUREMENTS,
    motion::MEASUREMENTS,
    further::MEASUREMENTS,
];

impl Experiment {
    fn read(node: &Node<'static>) -> Result<Experiment, ConfigurationError> {
        node.only(&["name", "noise", "reference", "configuration", "claims"])?;
        let is_set = |key: &str| Ok(node.value(key, ValueFormat::Flag, 0.0, 1.0)? == Some(1.0));
        let name = node.text("name")?;
        let measurement = MEASUREMENTS.into_iter().flatten().find(|(own, _)| *own == name);
        let (_, measure) = measurement.ok_or_else(|| node.unexpected("name", "the name of a measurement"))?;
        Ok(Experiment {
            name,
            noise: is_set("noise")?,
            configuration: match node.keys().contains(&"configuration") {
                true => node.text("configuration")?,
                false if is_set("reference")? => Configuration::reference_text(),
                false => "",
            },
            claims: node.tables("claims")?.iter().map(PublishedValue::read).collect::<Result<_, _>>()?,
            measure: *measure,
        })
    }
}

impl PublishedValue {
    fn read(node: &Node<'static>) -> Result<PublishedValue, ConfigurationError> {
        node.only(&["what", "source", "value", "rounding", "min", "max", "unit"])?;
        let number = |key: &str| node.value(key, ValueFormat::Real, f64::MIN, f64::MAX);
        let expected = match (number("value")?, number("min")?, number("max")?) {
            (Some(value), None, None) => Expected::Value(value, number("rounding")?.unwrap_or(0.0)),
            (None, None, Some(max)) => Expected::AtMost(max),
            (None, Some(min), Some(max)) => Expected::Between(min, max),
            _ => return Err(node.unexpected("value", "a value, a max, or min and max")),
        };
        Ok(PublishedValue {
            what: node.text("what")?,
            source: node.text("source")?,
            expected,
            unit: node.text("unit")?,
        })
    }
}

/// Runs an experiment; `overrides`, each `PATH=VALUE`, change its unit.
///
/// # Errors
/// Overrides that do not give a valid configuration.
pub fn measure(
    experiment: &'static Experiment,
    seed: u64,
    overrides: &[String],
) -> Result<Vec<ClaimCheck>, ConfigurationError> {
    let mut configuration = Configuration::parse(experiment.name, experiment.configuration, overrides)?;
    configuration.seed = seed;
    let measured = (experiment.measure)(&mut Receiver::new(&configuration));
    assert_eq!(measured.len(), experiment.claims.len(), "{}: an estimate for each claim", experiment.name);
    Ok(experiment.claims.iter().zip(measured).map(|(claim, measured)| ClaimCheck { claim, measured }).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_measurement_is_of_an_experiment() {
        let names: Vec<&str> = experiments().map(|experiment| experiment.name).collect();
        assert!(MEASUREMENTS.into_iter().flatten().all(|(name, _)| names.contains(name)));
    }
}
