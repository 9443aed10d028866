//! Hypotheses of a diagnosis: changes of the model.
//!
//! A module uses only those named before it: `gyros` (sets of them), `amplitude` (a parameter of the model), `hypothesis` (an amplitude with its
//! time course, gyros and value).

pub mod amplitude;
pub mod gyros;
mod hypothesis;

pub use hypothesis::{Hypothesis, HypothesisParameter};
