//! Model against measurement: where the two part, which effect is missing, on which gyro, how large it is.
//!
//! A module uses those named before it alone:
//! - what a hypothesis is: `gyros`, `amplitude` (which number of the model), `hypothesis` (with its value);
//! - the data: `later`, `measured`, `gap`, `stretches`, and the exact checks, `checks`, which yield each `finding`;
//! - signatures: `courses`, `bank`, `climb`;
//! - statistics: `whitening`, `normal`, `sweep`, `signature`, `spots`, `state` (a fit), `noise`, `whiteness`, `search`, `null`, `late`;
//! - the loop that selects hypotheses: `explain`;
//! - what is reported: `whereabouts`, `outcome` (types alone), `rivals`, `remedy`, `entries`, `held_out`, `remainder`;
//! - the whole: `diagnosis`, its `report`, the trial of it, `blind`. `rates` stands beside and shares the verdict alone.

pub mod amplitude;
pub mod bank;
pub mod blind;
pub mod checks;
mod climb;
mod courses;
mod diagnosis;
mod entries;
pub mod explain;
mod finding;
pub mod gap;
pub mod gyros;
mod held_out;
pub mod hypothesis;
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
pub mod signature;
mod spots;
pub mod state;
pub mod stretches;
mod sweep;
pub mod whereabouts;
mod whiteness;
pub mod whitening;

pub use bank::SignatureBank;
pub use diagnosis::{DiagnosisOptions, diagnose_rows};
pub use finding::Finding;
pub use measured::{MeasuredData, MeasuredError};
pub use null::Thresholds;
pub use outcome::{Diagnosis, Verdict};
pub use state::DiagnosisCase;
