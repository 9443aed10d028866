//! A run on disk: what the link carried, the truth behind it, and what makes the same bytes again (cli.md, `simulate`).
//!
//! `geu simulate` writes it as fast as the model runs; `geu run --record` writes the same files beside the live links.
//! Times are scheduled ends, never the wall clock.
//!
//! Dependencies run one way: `writer` uses a file for each part (`fault_log`, `reference`, `truth_csv`, `run_toml`, `links`),
//! these use `output`; `destination` is the directory, `event` what a unit reports. No thread, no live link, no wall clock.

mod destination;
mod event;
mod fault_log;
mod links;
mod output;
mod reference;
mod run_toml;
mod truth_csv;
mod writer;

pub use destination::{Destination, FILES};
pub(crate) use event::{PolledSample, UnitEvent};
pub use links::misses;
pub(crate) use links::{form_beside, recorded};
pub use output::RecordError;
pub use run_toml::{UnfinishedError, complete};
pub(crate) use writer::End;
pub use writer::Recorder;
