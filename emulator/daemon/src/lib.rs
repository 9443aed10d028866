//! The unit as a process: cadence, links, commands, recording.
//!
//! [`run()`] is the emulator. One ordinary thread keeps time ([`cadence`]) and writes every sample to all links
//! ([`link`]) itself; a runtime on the calling thread waits for clients, commands, signals and devices. They share the unit
//! behind one lock (`shared_unit`).
//!
//! Dependencies run one way: `run` uses `control_service` and `link`; both use `shared_unit`, which uses `recorder_thread`.
//! Data of links and recordings come from the crate `geu_recorder`, which knows neither device nor wall clock.

pub mod cadence;
mod catalogue;
mod console;
pub mod control;
mod control_service;
pub mod descriptors;
#[cfg(fuzzing)]
pub mod fuzzing;
mod host;
pub mod lateness;
pub mod link;
mod patience;
mod recorder_thread;
mod run;
pub mod running;
mod shared_unit;
#[cfg(test)]
mod simulation;
pub mod truth;

pub use catalogue::catalogue;
pub use recorder_thread::RecordingError;
pub use run::{Recording, RunError, RunOptions, RunSummary, asked_to_end, replay, run};
