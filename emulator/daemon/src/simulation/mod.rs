//! Chaos from a seed: the unit with simulated clients, disk and clock, checked after each step.
//!
//! The code of the unit is the one that runs live: cadence, links, commands, recorder thread, control service. Only what
//! [`crate::host`] and the ports reach is simulated. One thread or task runs at a time; the seed decides which, how long a
//! wake-up takes and what clients and disk do, so that a seed repeats a run exactly. Why not a library: madsim and turmoil
//! replace the runtime and its sockets, but the cadence is a thread of its own, and a pty is no socket.
//!
//! Dependencies run one way: `tests` use `chaos` (a run and its invariants), which uses `client`, `disk` and `port`; all use
//! `world` (scheduler, clock, chance).

pub(crate) mod chaos;
mod client;
mod disk;
pub(crate) mod port;
mod tests;
mod world;

pub(crate) use world::{ThreadId, host};
