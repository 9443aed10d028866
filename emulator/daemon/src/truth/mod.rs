//! Truth from outside: a simulator tells over a socket where the unit points, while the unit runs.
//!
//! [`ExternalTruth`] stands between the runtime's tasks, which read the source (`source`), and the thread that keeps time: that asks
//! for the truth just before it ends a sample. What is used when samples are late, missing or jump is decided in
//! `synchroniser`, on on-board time alone; what was used is a [`StreamedAttitude`](geu_model::attitude::StreamedAttitude) truth, which a recording keeps ([`received`]).
//!
//! Dependencies run one way: `source` (sockets) uses `external_truth`, `json`, `forty_two` and `lines`; `external_truth` uses `synchroniser` and
//! `reports`. No model of the unit, no recorder.

mod address;
mod external_truth;
mod forty_two;
mod json;
mod lines;
pub mod received;
mod reports;
mod source;
mod synchroniser;

use std::sync::Arc;

pub use address::{TruthAddress, TruthError};
pub use external_truth::ExternalTruth;
pub(crate) use reports::{Handed, SampleReport};
pub use synchroniser::TruthStatistics;

/// Begins to listen, or to look for the server; within the runtime. `is_held_back`: the run is held back for its clients.
pub(crate) fn open(live: &Arc<ExternalTruth>, is_held_back: bool) -> Result<(), TruthError> {
    if is_held_back {
        live.hold_back();
    }
    source::open(live).map_err(|source| TruthError { address: live.address().clone(), source })
}
