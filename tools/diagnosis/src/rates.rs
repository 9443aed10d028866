//! Rates of any gyros against an independent rate: which biases and scale errors explain where the two part, and how far
//! the data can tell these apart.
//!
//! The data are windows, each with the mean rate of every gyro and the reference: the magnitude of the rate, or its
//! vector. A gyro reads (1 + scale)(1 + own scale) × rate + bias. Windows belong to groups (days, recordings). Noise is
//! what neither the mean of a group nor any of the errors explains ([`Noise`]); what is left between groups is therefore
//! for the errors to explain, and an error is accepted only if, fitted without a group, it foretells that group
//! ([`diagnose`]).
//!
//! ```
//! use geu_diagnosis::rates::{Gyro, Parameter, Reference, Windows, diagnose};
//! let gyros = ["X", "Y", "Z"].iter().enumerate().map(|(axis, name)| Gyro { name: name.to_string(), axis });
//! let mut windows = Windows::new(gyros.collect(), ["spin", "turn", "reverse"].map(String::from).to_vec());
//! for index in 0..60 {
//!     let spin = [[40.0, 3.0, -9.0], [5.0, 40.0, 30.0], [-4.0, 9.0, -40.0]][index / 20];
//!     let noise = [0.3, -0.1, -0.4, 0.2, 0.1, -0.2, 0.1][index % 7];
//!     let measured = [spin[0] + 5.0, spin[1], spin[2]];
//!     let magnitude = spin.iter().map(|rate| rate * rate).sum::<f64>().sqrt();
//!     windows.push(index / 20, &measured, Reference::Magnitude(magnitude + noise)).unwrap();
//! }
//! let found = diagnose(&windows, 1).unwrap();
//! assert_eq!(found.errors[0].parameter, Parameter::Bias(0));
//! assert!((found.errors[0].value - 5.0).abs() < 4.0 * found.errors[0].sigma);
//! ```

// From the data up: `windows`, `model`, `noise`, `fit`, `estimator`, `null`, `apart`, `diagnosis`; each uses those before it alone.
mod apart;
mod diagnosis;
mod estimator;
mod fit;
mod model;
mod noise;
mod null;
mod windows;

pub use crate::outcome::Verdict;
pub use apart::{CandidateSpin, Observability};
pub use diagnosis::{Diagnosis, Found, Gap, GroupGap, Rival, diagnose};
pub use model::Parameter;
pub use noise::{ChannelNoise, Noise};
pub use windows::{Gyro, RatesError, Reference, Window, Windows};
