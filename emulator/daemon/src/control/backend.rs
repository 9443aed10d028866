//! What the control interface shows and drives.

use std::future::Future;
use std::sync::Arc;

use serde_json::{Map, Value};
use tokio::sync::broadcast;

/// Something that happened, as clients of `/api/events` get it.
#[derive(Debug, Clone)]
pub struct SseEvent {
    /// `sample` or `timeline`.
    pub name: &'static str,
    /// One line of JSON.
    pub data: Arc<str>,
}

/// What the control interface shows and drives. No method may block longer than a lock is held.
pub trait ControlBackend: Send + Sync + 'static {
    /// The state of the run; has `lateness` and `truth` at least.
    fn status(&self) -> Value;
    /// What can be set, injected and commanded; has `parameters` at least, and never changes in a run.
    fn catalogue(&self) -> Value;
    /// Every fault that is known: armed, active, over.
    fn faults(&self) -> Value;
    /// Takes a fault in, written as in a configuration's `[[fault]]`, or all of a `plan`, or starts one by hand.
    ///
    /// # Errors
    /// What is wrong with it; nothing is taken in then.
    fn inject(&self, injection: &Map<String, Value>) -> Result<Value, String>;
    /// Ends a fault now, or disarms it.
    ///
    /// # Errors
    /// No fault of that name.
    fn clear(&self, id: &str) -> Result<Value, String>;
    /// Ends all of them.
    fn clear_all(&self) -> Value;
    /// Carries out the payload of a COMMAND; the reply, as [`reply`](super::reply) writes it.
    fn command(&self, payload: Vec<u8>) -> impl Future<Output = Value> + Send;
    /// What happened so far, one line of JSON each; bounded.
    fn timeline(&self) -> Vec<Arc<str>>;
    /// The last ten minutes, a sample each, the oldest first.
    fn history(&self) -> Value;
    /// What happens from now on. A client that falls behind the channel is dropped.
    fn subscribe(&self) -> broadcast::Receiver<SseEvent>;
}
