//! Chaos from a seed: the unit with simulated clients, disk and clock, checked after each step.
//!
//! Cadence, links, commands, recorder thread and control service are the code that runs live. Only
//! [`crate::host`] and the ports are simulated. One thread or task runs at a time. The seed decides their order,
//! the delay of each wake-up, and the actions of clients and disk, so that a seed repeats a run exactly. Why not a library: madsim and turmoil
//! replace the runtime and its sockets, but the cadence is a thread of its own, and a pty is no socket.
//!
//! Dependencies run one way: `tests` use `chaos` (a run and its invariants), which uses `client`, `disk` and `port`; all use
//! `world` (scheduler, clock, random numbers) with `threads`.

pub(crate) mod chaos;
mod client;
mod disk;
pub(crate) mod port;
mod tests;
mod threads;
mod world;

pub(crate) use threads::ThreadId;
pub(crate) use world::host;
