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

pub use believed::{Believed, BelievedError};
pub use calibrate::{Attitude, CalibrateError, Calibrated, calibrate};
pub use compare::{Comparison, Earlier, combine, compare};
pub use counts::{Break, BreakKind, Counts, CountsReader, Reading};
pub use track::{Choice, Event, Track, Tracker};
pub use transfer::{InUse, Transfer};
pub use upkeep::{Known, Upkeep, UpkeepError, update};
