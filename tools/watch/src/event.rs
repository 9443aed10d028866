//! Monitors and their events.

use geu_protocol::Gyros;
use serde_json::{Value, json};

/// An event of the link or of a gyro.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// Time of the link, s.
    pub t_s: f64,
    /// `alarm`, `named`, `interruption` or `reference-end`.
    pub event: &'static str,
    /// The kind of the change, `unknown`, or the kind of the interruption.
    pub code: &'static str,
    pub gyros: Gyros,
    /// Chi-square of the best match, or missing samples.
    pub statistic: f64,
    pub threshold: f64,
}

impl Event {
    /// The event as one line of JSON.
    pub fn json(&self) -> Value {
        let round = |value: f64| (value * 1e3).round() * 1e-3;
        json!({
            "t_s": self.t_s,
            "event": self.event,
            "code": self.code,
            "gyros": self.gyros.names(),
            "statistic": round(self.statistic),
            "threshold": self.threshold,
        })
    }
}

/// A monitor of samples of a kind.
pub trait Watch<R> {
    /// Adds a sample; returns what it changed.
    fn push(&mut self, row: &R) -> Vec<Event>;
    /// Length of the compared samples, s.
    fn compared_s(&self) -> f64;
}
