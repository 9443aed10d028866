//! Model against measurement: where the two part, which effect is missing, on which gyro, how large it is.

pub mod bank;
pub mod blind;
pub mod change;
pub mod checks;
mod climb;
mod diagnosis;
mod entries;
pub mod explain;
mod finding;
pub mod gap;
mod held_out;
mod late;
mod later;
pub mod measured;
pub mod noise;
pub mod normal;
pub mod null;
pub mod outcome;
pub mod rates;
mod remainder;
pub mod remedy;
pub mod report;
pub mod rivals;
pub mod search;
pub mod state;
pub mod stretches;
mod sweep;
pub mod whereabouts;
pub mod whitening;

pub use bank::Bank;
pub use diagnosis::{Settings, diagnose_rows};
pub use finding::Finding;
pub use measured::{Measured, MeasuredError};
pub use null::Thresholds;
pub use outcome::{Diagnosis, Verdict};
pub use state::Case;
