//! The control interface: what the unit does, and a way to interfere, over HTTP; for the bench page and for programs.
//!
//! It has a thread and a runtime of its own at lowered priority, and knows of the unit nothing but a [`ControlBackend`]: no
//! client, however many and however slow, delays the cadence or a reply on a link.
//!
//! Dependencies run one way: `server` (connections) uses `routes` (the table and what answers), which uses `guard`, `openapi`,
//! `page`, `protocol_json`, `unique` and `backend`; `answer` and `route` are types of all of these. Nothing of the daemon.

mod answer;
mod backend;
mod guard;
mod openapi;
mod page;
mod protocol_json;
mod route;
mod routes;
mod server;
#[cfg(test)]
mod tests;
mod unique;

pub use backend::{ControlBackend, SseEvent};
pub use protocol_json::{commands, reply, told};
pub use server::{ControlError, ControlListener, Server};

/// Where the control interface listens unless told otherwise.
pub const DEFAULT_ADDRESS: &str = "127.0.0.1:8470";
