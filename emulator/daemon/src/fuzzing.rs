//! Entries for the targets of `tests/fuzz`, compiled with `--cfg fuzzing` alone: the parsers behind the sockets.

use std::sync::Arc;

use axum::Router;
use geu_model::attitude::{Knot, StreamedAttitude, TruthNumbers};
use serde_json::{Map, Value};

use crate::control::{self, ControlBackend};
use crate::control_service;
use crate::truth::{self, TruthStatistics};

/// Statistics and knots of the truth in the bytes of a simulator, JSON lines or the text of 42, that arrive in these parts.
pub fn truth(is_forty_two: bool, parts: &[&[u8]]) -> (TruthStatistics, Vec<Knot>) {
    let streamed = Arc::new(StreamedAttitude::default());
    let statistics = truth::fuzzed(is_forty_two, parts, &streamed, TruthNumbers::default());
    (statistics, streamed.knots_from(0))
}

/// The routes of the control interface at its default address.
pub fn router(backend: Arc<dyn ControlBackend>, token: Option<String>) -> Router {
    control::fuzzed(backend, token)
}

/// The text of a fault in a request.
pub fn toml(object: &Map<String, Value>) -> String {
    control_service::fuzzed(object)
}
