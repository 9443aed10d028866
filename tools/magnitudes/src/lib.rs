//! Rates of three perpendicular gyros against an independent magnitude of the rate: the biases and scale errors that explain the
//! difference, and their observability.
//!
//! The data are windows, each with the mean rate of every gyro and the magnitude. A gyro measures (1 + scale)(1 + own scale) × rate + bias. Windows belong to groups (days, recordings). Noise is
//! the residual after the group means and all errors are projected out ([`Noise`]); the errors have to explain differences
//! between groups, and an error is accepted only if, fitted without a group, it predicts that group ([`diagnose`]).
//!
//! ```
//! use geu_magnitudes::{Gyro, Parameter, Windows, diagnose};
//! let gyros = ["X", "Y", "Z"].into_iter().zip([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
//! let gyros = gyros.map(|(name, input)| Gyro { name: name.to_owned(), input });
//! let mut windows = Windows::new(gyros.collect()).unwrap();
//! for index in 0..60 {
//!     let spin = [[40.0, 3.0, -9.0], [5.0, 40.0, 30.0], [-4.0, 9.0, -40.0]][index / 20];
//!     let noise = [0.3, -0.1, -0.4, 0.2, 0.1, -0.2, 0.1][index % 7];
//!     let measured = [spin[0] + 5.0, spin[1], spin[2]];
//!     let magnitude = spin.iter().map(|rate| rate * rate).sum::<f64>().sqrt();
//!     windows.push(["spin", "turn", "reverse"][index / 20], &measured, magnitude + noise);
//! }
//! let found = diagnose(&windows, 1).unwrap();
//! assert_eq!(found.errors[0].parameter, Parameter::Bias(0));
//! assert!((found.errors[0].value - 5.0).abs() < 4.0 * found.errors[0].sigma);
//! ```

// Each of these modules uses only modules before it: `windows`, `model`, `noise`, `fit`, `estimator`, `null`, `observability`,
// `diagnosis`.
mod diagnosis;
mod estimator;
mod fit;
mod model;
mod noise;
mod null;
mod observability;
mod windows;

pub use diagnosis::{Diagnosis, GroupResidual, RateAlternative, RateError, RateResidual, diagnose};
pub use geu_diagnosis::Verdict;
pub use model::Parameter;
pub use noise::Noise;
pub use observability::{CandidateSpin, Observability};
pub use windows::{Gyro, MagnitudeError, Window, Windows};
