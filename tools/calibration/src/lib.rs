//! From counts to the sixteen in-orbit parameters, and from parameters to attitude (Casteren §3–6).

pub mod absolute;
pub mod calibrate;
pub mod checkout;
pub mod counts;
pub mod effects;
pub mod hand;
pub mod noise;
pub mod observe;
pub mod report;
pub mod solve;
pub mod sun;
pub mod transfer;
pub mod window;

pub use calibrate::{Attitude, CalibrateError, Calibrated, Comparison, calibrate, combine};
pub use counts::{Break, BreakKind, Counts, CountsReader, Reading};
pub use transfer::{InUse, Transfer};
