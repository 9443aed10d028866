//! The control interface over HTTP: state of the unit, faults and commands, for the bench page and for programs.
//!
//! It has its own thread and runtime at lowered priority and knows the unit only as a [`ControlBackend`]: clients, of any
//! number and speed, delay neither the cadence nor a reply on a link.
//!
//! Dependencies run one way: `server` (connections) uses `routes` (table and handlers), which uses `guard`, `openapi`, `page`,
//! `protocol_json`, `request`, `watch` and `backend`; `answer` and `route` are types of all of these. Nothing else of the daemon.

mod answer;
mod backend;
mod guard;
mod openapi;
mod page;
mod protocol_json;
mod request;
mod route;
mod routes;
mod server;
#[cfg(test)]
mod tests;
mod unique;
mod watch;

pub use backend::{ControlBackend, SseEvent};
pub use protocol_json::{commands, layout, layout_of, reply, sample};
pub use server::{ControlError, ControlListener, Server};

/// Default address of the control interface.
pub const DEFAULT_ADDRESS: &str = "127.0.0.1:8470";

/// The routes, at the default address.
#[cfg(fuzzing)]
pub(crate) fn fuzzed(backend: std::sync::Arc<dyn ControlBackend>, token: Option<String>) -> axum::Router {
    routes::router(backend, guard::Guard { address: DEFAULT_ADDRESS.parse().expect("an address"), token })
}
