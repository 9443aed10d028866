//! Interface between the control interface and the running unit.

use std::pin::Pin;
use std::sync::Arc;

use geu_protocol::Gyros;
use serde_json::{Map, Value};
use tokio::sync::broadcast;

use super::protocol_json;

/// An event of `/api/events`.
#[derive(Debug, Clone)]
pub struct SseEvent {
    /// `half-second`, `timeline` or `watch`.
    pub name: &'static str,
    /// One line of JSON.
    pub data: Arc<str>,
}

/// A unit that can be watched and commanded. No method blocks for longer than a lock is held.
pub trait ControlBackend: Send + Sync + 'static {
    /// State of the run, with at least `lateness` and `truth`.
    fn status(&self) -> Value;
    /// Parameters, faults and commands, with at least `parameters`. Constant during a run.
    fn catalogue(&self) -> Value;
    /// All gyros of the unit.
    fn gyros(&self) -> Gyros;
    /// Fields of the frames of a sample. Constant during a run.
    fn layout(&self) -> Value {
        protocol_json::layout()
    }
    /// All faults: armed, active and over.
    fn faults(&self) -> Value;
    /// Adds a fault, written as in a configuration's `[[fault]]`, or all faults of a `plan`; or starts an
    /// operator-triggered fault.
    ///
    /// # Errors
    /// Invalid fault or plan; no fault is added then.
    fn inject(&self, injection: &Map<String, Value>) -> Result<Value, String>;
    /// Ends or disarms a fault.
    ///
    /// # Errors
    /// No fault with this identifier.
    fn clear(&self, id: &str) -> Result<Value, String>;
    /// Ends all faults.
    fn clear_all(&self) -> Value;
    /// Executes the payload of a COMMAND; returns the reply as written by [`reply`](super::reply).
    fn command(&self, payload: Vec<u8>) -> Pin<Box<dyn Future<Output = Value> + Send + '_>>;
    /// Events of the run until now, one line of JSON each; bounded.
    fn timeline(&self) -> Vec<Arc<str>>;
    /// The samples of the last ten minutes, oldest first.
    fn history(&self) -> Value;
    /// The last events of `geu watch`, oldest first; bounded.
    fn watch_events(&self) -> Value;
    /// Adds and publishes a checked event of `geu watch`; returns it with its number.
    fn add_watch_event(&self, event: Map<String, Value>) -> Value;
    /// Future events. A client that falls behind the channel is disconnected.
    fn subscribe(&self) -> broadcast::Receiver<SseEvent>;
}
