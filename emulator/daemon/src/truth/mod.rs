//! Truth from outside: a simulator tells over a socket where the unit points, while the unit runs.
//!
//! [`Live`] stands between the runtime's tasks, which read the source (`source`), and the thread that keeps time: that asks
//! for the truth just before it ends a half second. What is used when samples are late, missing or jump is decided in
//! `follow`, on on-board time alone; what was used is a [`Stepped`] truth, which a recording keeps ([`received`]).
//!
//! Dependencies run one way: `source` (sockets) uses `live`, `json`, `forty_two` and `lines`; `live` uses `follow` and
//! `reports`. No model of the unit, no recorder.

mod address;
mod follow;
mod forty_two;
mod json;
mod lines;
mod live;
pub mod received;
mod reports;
mod source;

use std::sync::Arc;

pub use address::{LiveAddress, TruthError};
pub use follow::Counts;
pub use live::Live;
pub(crate) use reports::{Handed, SampleReport};

/// Begins to listen, or to look for the server; within the runtime. `is_held_back`: the run is held back for its clients.
pub(crate) fn open(live: &Arc<Live>, is_held_back: bool) -> Result<(), TruthError> {
    if is_held_back {
        live.hold_back();
    }
    source::open(live).map_err(|source| TruthError { address: live.address().clone(), source })
}
