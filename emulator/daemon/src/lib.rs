//! The unit as a process: cadence, links, commands, recording.
//!
//! [`run()`] is the emulator. One ordinary thread keeps time ([`cadence`]) and writes every half second to all links
//! ([`link`]) itself; a runtime on the calling thread does whatever waits for somebody else: clients, commands,
//! signals, devices that come back. Both meet at the desk, where the unit stands behind one lock.

mod bench;
pub mod cadence;
pub mod carriage;
mod catalogue;
mod console;
pub mod control;
pub mod descriptors;
mod desk;
mod fault_log;
pub mod lateness;
pub mod link;
mod patience;
pub mod record;
mod recording;
mod run;
pub mod running;
pub mod simulate;
pub mod truth;

pub use catalogue::catalogue;
pub use run::{RunError, Settings, Summary, asked_to_end, replay, run};
