//! Model against measurement: where the two part, which effect is missing, on which gyro, how large it is.

pub mod bank;
pub mod blind;
pub mod change;
pub mod checks;
mod climb;
pub mod diagnosis;
pub mod explain;
mod finding;
pub mod gap;
mod later;
pub mod measured;
pub mod noise;
pub mod normal;
pub mod null;
pub mod rates;
pub mod remedy;
pub mod report;
pub mod rivals;
pub mod search;
pub mod state;
pub mod stretches;
pub mod whereabouts;
pub mod whitening;

pub use bank::Bank;
pub use diagnosis::{Diagnosis, Settings, Verdict, diagnose_rows};
pub use finding::Finding;
pub use measured::{Measured, MeasuredError};
pub use null::Thresholds;
pub use state::Case;
