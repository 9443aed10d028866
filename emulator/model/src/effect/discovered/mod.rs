//! The one effect whose terms are data: a diagnosis writes what it found as a formula with a coefficient, and the model
//! runs it.
//!
//! ```toml
//! [gyro.GYRX]
//! discovered = [{ formula = "rate_y^2", coefficient = 4.0e-7 }]
//! ```
//!
//! The rate that the gyro senses is greater by coefficient · formula, arcsec/s. A [`Formula`] is a product of
//! [`Regressor`]s, which are told once, in a table.

mod formula;
mod regressor;

pub use formula::{Formula, MOST_FACTORS, MOST_POWER, NotAFormula};
pub use regressor::Regressor;

use super::{EffectInputs, GyroSubStep};
use crate::number::{DefaultValue, ParameterSpec, ValueFormat, number};

/// Key in the configuration, and column of a trace.
pub const CODE: &str = "discovered";
/// A few words.
pub const TITLE: &str = "terms that a diagnosis found: sensed rate + coefficient * formula, arcsec/s";
/// What a term's formula is.
pub const FORMULA_MEANING: &str =
    "product of at most three different factors joined by *, each alone or with ^2 or ^3 behind it";
/// Terms that a gyro can have.
pub const MOST_TERMS: usize = 16;
/// What is said of a term's coefficient.
pub const COEFFICIENT: ParameterSpec = number(
    "coefficient",
    ValueFormat::Real,
    DefaultValue::Required,
    -1e6,
    1e6,
    "arcsec/s of sensed rate per unit of the formula",
);

/// A term of the sensed rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Term {
    /// What it follows.
    pub formula: Formula,
    /// How much of it, arcsec/s per unit of the formula; see [`Formula::unit`].
    pub coefficient: f64,
}

/// Adds what the terms of a gyro make it sense over one sub-step.
#[inline]
pub fn apply(terms: &[Term], head: &mut GyroSubStep, surroundings: &EffectInputs) {
    let length_s = surroundings.step.length_s;
    // Over no time there is no mean rate.
    if length_s == 0.0 {
        return;
    }
    for term in terms {
        head.added_arcsec += term.coefficient * term.formula.value(surroundings) * length_s;
    }
}

/// Whether there is a term that changes anything.
pub fn is_present(terms: &[Term]) -> bool {
    terms.iter().any(|term| term.coefficient != 0.0)
}
