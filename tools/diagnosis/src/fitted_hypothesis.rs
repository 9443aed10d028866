//! A hypothesis with its fit.

use std::sync::Arc;

use geu_model::parameter_spec::Role;

use crate::normal_equations::{Nuisance, THIRDS};
use geu_hypothesis::{Hypothesis, HypothesisParameter};

/// A hypothesis and the state of its parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct FittedHypothesis {
    /// The hypothesis.
    pub hypothesis: Hypothesis,
    /// True for each parameter that is fitted; the others keep their values.
    pub is_free: Vec<bool>,
    /// 1 sigma of each from the last fit; NaN if it is not fitted.
    pub sigmas: Vec<f64>,
    /// χ² reduction that was required.
    pub penalty: f64,
    /// Cross-validation ([`crate::normal_equations::NormalEquations::cross_validate`]).
    pub held_out: [Option<f64>; THIRDS],
    /// Signatures of the free parameters, if they have been run: nearly constant as long as the parameters are.
    pub(crate) columns: Option<Arc<Vec<Nuisance>>>,
}

impl FittedHypothesis {
    /// Frees the amplitude and those shape parameters that have no default. An onset at the start of the recording stays there: the
    /// amplitude of what settled before is that at the start.
    pub fn new(hypothesis: Hypothesis) -> FittedHypothesis {
        let own = hypothesis.own_shapes.len();
        let is_free = |(index, parameter): (usize, &HypothesisParameter)| {
            index == 0 || if parameter.role == Role::Onset { parameter.value != 0.0 } else { index > own }
        };
        let is_free = hypothesis.parameters().iter().enumerate().map(is_free).collect();
        FittedHypothesis { is_free, ..FittedHypothesis::fixed(hypothesis) }
    }

    /// Frees no parameter.
    pub fn fixed(hypothesis: Hypothesis) -> FittedHypothesis {
        let count = hypothesis.parameters().len();
        FittedHypothesis {
            hypothesis,
            is_free: vec![false; count],
            sigmas: vec![f64::NAN; count],
            penalty: 0.0,
            held_out: [None; THIRDS],
            columns: None,
        }
    }

    /// Sets its penalty.
    #[must_use]
    pub fn with_penalty(self, penalty: f64) -> FittedHypothesis {
        FittedHypothesis { penalty, ..self }
    }

    /// True if it is proportional to the temperature.
    pub fn follows_temperature(&self) -> bool {
        self.hypothesis.follows_temperature()
    }

    /// Frees a parameter.
    pub fn free(&mut self, index: usize) {
        self.is_free[index] = true;
        self.columns = None;
    }

    /// Fixes a parameter at a value.
    pub fn fix(&mut self, index: usize, value: f64) {
        self.hypothesis.set(index, value);
        self.is_free[index] = false;
        self.columns = None;
    }

    /// Discards its signatures.
    pub fn invalidate(&mut self) {
        self.columns = None;
    }
}
