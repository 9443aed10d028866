//! From counts to the sixteen in-orbit parameters, and from parameters to attitude (Casteren §3–6).

pub mod believed;
pub mod counts;
pub mod redundancy;
pub mod track;
pub mod transfer;

pub use believed::{Believed, BelievedError};
pub use counts::{Break, BreakKind, Counts, CountsReader, Reading};
pub use track::{Choice, Event, Track, Tracker};
pub use transfer::{InUse, Transfer};
