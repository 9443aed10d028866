//! Hypotheses of a diagnosis: changes of the model.
//!
//! A module uses only those named before it: `gyros` (sets of them as text), `amplitude` (a parameter of the model), `calibration_parameter`,
//! `hypothesis` (an amplitude with its time course, gyros and value).

pub mod amplitude;
mod calibration_parameter;
pub mod gyros;
mod hypothesis;

pub use calibration_parameter::{CalibrationParameter, ParameterKind};
pub use hypothesis::{Hypothesis, HypothesisParameter};
