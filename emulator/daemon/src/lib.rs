//! The unit as a process: cadence, links, commands, recording.
//!
//! [`run()`] is the emulator. One ordinary thread keeps time ([`cadence`]) and writes every sample to all links
//! ([`link`]) itself; a runtime on the calling thread does whatever waits for somebody else: clients, commands,
//! signals, devices that come back. They share the unit behind one lock (`shared_unit`).
//!
//! Dependencies run one way: `run` uses `control_service` and `link`; both use `shared_unit`, which uses `recorder_thread`
//! and `event_source`; these and [`simulate`](mod@simulate) use `recorder`; that uses [`link_model`] and [`truth`].

pub mod cadence;
mod catalogue;
mod console;
pub mod control;
mod control_service;
pub mod descriptors;
mod event_source;
mod fault_json;
pub mod lateness;
pub mod link;
pub mod link_model;
mod patience;
pub mod recorder;
mod recorder_thread;
mod run;
pub mod running;
mod shared_unit;
pub mod simulate;
pub mod truth;

pub use catalogue::catalogue;
pub use recorder_thread::RecordingError;
pub use run::{Recording, RunError, RunOptions, RunSummary, asked_to_end, replay, run};
