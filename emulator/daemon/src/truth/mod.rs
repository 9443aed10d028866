//! External truth: a simulator sends the attitude of the unit over a socket while the unit runs.
//!
//! [`ExternalTruth`] connects the tasks that read the source (`source`) with the cadence thread, which needs the truth just
//! before it ends a sample. `synchroniser` handles late and missing samples and jumps, by on-board time alone. The used truth
//! is a [`StreamedAttitude`](geu_model::attitude::StreamedAttitude), which a recording contains (`received.csv`).
//!
//! Dependencies run one way: `source` (sockets) uses `external_truth`, `json`, `forty_two` and `lines`; `external_truth` uses
//! `synchroniser` and `reports`. No model of the unit, no recorder.

mod address;
mod external_truth;
mod forty_two;
mod json;
mod lines;
mod reports;
mod source;
mod synchroniser;

use std::sync::Arc;

pub use address::{TruthAddress, TruthError};
pub use external_truth::ExternalTruth;
pub(crate) use reports::{Handed, SampleReport};
pub use synchroniser::TruthStatistics;

/// Opens the listener or the connection to the server, within the runtime. `is_held_back`: the run waits for its clients.
pub(crate) fn open(live: &Arc<ExternalTruth>, is_held_back: bool) -> Result<(), TruthError> {
    live.state().is_early = is_held_back;
    source::open(live).map_err(|source| TruthError { address: live.address().clone(), source })
}
