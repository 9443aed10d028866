//! The effect whose terms are data: a diagnosis writes a found formula with a coefficient, and the model
//! runs it.
//!
//! ```toml
//! [gyro.GYRX]
//! discovered = [{ formula = "rate_y^2", coefficient = 4.0e-7 }]
//! ```
//!
//! The rate that the gyro senses is greater by coefficient · formula, arcsec/s. A [`Formula`] is a product of
//! [`Regressor`]s, one table.

mod formula;
mod regressor;

pub use formula::{Formula, MAX_FACTORS, MAX_POWER, NotAFormula};
pub use regressor::Regressor;

use super::{EffectInputs, GyroSubStep};
use crate::parameter_spec::{ParameterSpec, REAL, REQUIRED, number};

/// Key in the configuration, and column of a trace.
pub const CODE: &str = "discovered";
/// A few words.
pub const TITLE: &str = "terms that a diagnosis found: sensed rate + coefficient * formula, arcsec/s";
/// Description of a term's formula.
pub const FORMULA_MEANING: &str =
    "product of at most three different factors joined by *, each alone or with ^2 or ^3 behind it";
/// Terms that a gyro can have.
pub const MAX_TERMS: usize = 16;
/// Specification of a term's coefficient.
pub const COEFFICIENT: ParameterSpec =
    number("coefficient", "", REAL, REQUIRED, -1e6, 1e6, "arcsec/s of sensed rate per unit of the formula");

/// A term of the sensed rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Term {
    /// The formula.
    pub formula: Formula,
    /// Rate in arcsec/s per unit of the formula; see [`Formula::unit`].
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
        let value = term.formula.value(|regressor| regressor.value(surroundings));
        head.added_arcsec += term.coefficient * value * length_s;
    }
}

/// True if a coefficient is not 0.
pub fn is_present(terms: &[Term]) -> bool {
    terms.iter().any(|term| term.coefficient != 0.0)
}
