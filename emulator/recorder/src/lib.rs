//! The unit without devices: the data of its links with their faults, and a run on disk: data of the link, truth, faults, and
//! the configuration that repeats the run.
//!
//! `geu simulate` records as fast as the model runs; `geu run --record` writes the same files beside the live links. Times are
//! scheduled ends, never the wall clock.
//!
//! Dependencies run one way: `simulate` uses `event_source` (a unit and its events) and `writer`; that uses a file for each
//! part (`fault_log`, `reference`, `truth`, `run_toml`, `links`); these use `output` and [`link_model`]; `destination` is
//! the directory, `event` the events of a unit. No live link, no wall clock; the only thread is that of `simulate`.

mod destination;
mod event;
mod event_source;
pub mod fault_json;
mod fault_log;
pub mod link_model;
mod links;
mod output;
pub mod received;
mod reference;
mod run_toml;
mod simulate;
mod truth;
mod truth_csv;
mod writer;

pub use destination::{Destination, FILES};
pub use event::{PolledSample, UnitEvent};
pub use event_source::{CommandResponse, EventSource};
pub use links::{misses, recorded, wire_beside};
pub use output::RecordError;
pub use run_toml::{UnfinishedError, complete};
pub use simulate::{record, simulate};
pub use truth::{TruthRow, TruthTable, number_names};
pub use writer::{End, Recorder};
