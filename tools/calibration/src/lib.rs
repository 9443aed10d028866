//! From counts to the sixteen in-orbit parameters, and from parameters to attitude (Casteren §3–6).

pub mod absolute;
pub mod believed;
pub mod calibrate;
pub mod checkout;
pub mod compare;
pub mod counts;
pub mod effects;
pub mod filter;
pub mod hand;
pub mod noise;
pub mod observe;
pub mod redundancy;
pub mod refine;
pub mod report;
pub mod solve;
pub mod sun;
pub mod track;
pub mod transfer;
pub mod upkeep;
pub mod window;

pub use believed::{BelievedError, PriorCalibration};
pub use calibrate::{AttitudeSource, CalibrateError, Calibrated, calibrate};
pub use compare::{Comparison, PreviousCalibration, combine, compare};
pub use counts::{AccumulatedCounts, BreakKind, CountsReader, Discontinuity, Interpolation};
pub use track::{GyroSelection, Track, Tracker, TrackerEvent};
pub use transfer::{GyroSet, Transfer};
pub use upkeep::{CalibrationUpdate, PriorAccuracy, UpkeepError, update};
