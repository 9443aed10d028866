//! Runs: one thread keeps the cadence and sends, the calling thread runs all tasks that wait for clients or devices.
//!
//! Dependencies run one way: `unit` (the emulator) uses `cadence_loop` (its thread), `replay` (a recording in its place) has a
//! thread of its own; all of these use `output` (links with their queues), `session` (runtime, links and end of every run) and `error`.
//! No physics, no bytes of messages, no argument parsing.

mod cadence_loop;
mod error;
mod output;
pub mod replay;
mod session;
mod unit;

pub use error::RunError;
#[cfg(test)]
pub(crate) use session::Session;
pub use session::asked_to_end;
#[cfg(test)]
pub(crate) use unit::run_unit;
pub use unit::{Recording, RunOptions, RunSummary, run};
