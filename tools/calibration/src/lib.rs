//! In-orbit calibration of the gyros from counts, and attitude from the calibration (Casteren §3–6).

pub mod absolute;
pub mod calibrate;
pub mod checkout;
pub mod compare;
mod coning;
pub mod counts;
pub mod effects;
mod evaluation;
pub mod filter;
pub mod first_order;
pub mod noise;
pub mod observe;
pub mod parity;
pub mod prior;
pub mod refine;
pub mod report;
pub mod solve;
pub mod sun;
pub mod track;
pub mod transfer;
pub mod update;
pub mod window;

pub use calibrate::{AttitudeSource, CalibrateError, Calibrated, CalibrationParts, calibrate, calibrate_described};
pub use compare::{Comparison, PreviousCalibration, combine, compare};
pub use coning::without_coning;
pub use counts::{
    AccumulatedCounts, BreakKind, CountsReader, DeviceCountsReader, DeviceRecording, Discontinuity, Interpolation,
};
pub use prior::{PriorCalibration, PriorError};
pub use track::{DeviceTracker, GyroSelection, Track, Tracker, TrackerEvent};
pub use transfer::{GyroSet, Transfer};
pub use update::{CalibrationUpdate, PriorAccuracy, UpdateError, update};
