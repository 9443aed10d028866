//! Model against measurement: where the two part, which effect is missing, on which gyro, how large it is.

pub mod bank;
pub mod blind;
pub mod change;
mod climb;
pub mod checks;
pub mod explain;
pub mod diagnosis;
mod finding;
pub mod gap;
mod later;
pub mod measured;
pub mod noise;
pub mod normal;
pub mod null;
pub mod remedy;
pub mod report;
pub mod rivals;
pub mod rates;
pub mod search;
pub mod state;
pub mod stretches;
pub mod whereabouts;
pub mod whitening;

pub use bank::Bank;
pub use diagnosis::{Diagnosis, Settings, Verdict, diagnose_rows};
pub use null::Thresholds;
pub use finding::Finding;
pub use measured::{Measured, MeasuredError};
pub use state::Case;
