//! What a replay is given: the items of a recording, and how to play them.

use std::sync::mpsc::Receiver;

use geu_model::Configuration;
use geu_protocol::{CanIdMap, Sample};

use crate::cadence::Speed;
use crate::link::LinkAddress;
use crate::link_model::WireData;

/// Something of a recording, and when.
#[derive(Debug, Clone, PartialEq)]
pub struct ReplayItem {
    /// Since the start of the recording, as it was recorded, ns: what faults go by.
    pub recorded_ns: i64,
    /// Since the start of the replay at speed 1, ns; never less than in the item before.
    pub played_ns: i64,
    /// What.
    pub what: ReplayItemKind,
}

/// What an item is.
#[derive(Debug, Clone, PartialEq)]
pub enum ReplayItemKind {
    /// A sample begins: what its contents, which follow, say.
    Sample {
        /// All of it.
        sample: Sample,
        /// Whether it was recorded on CAN.
        is_can: bool,
    },
    /// Bytes or a frame, as they were recorded.
    Content(WireData, TrafficOrigin),
    /// Something to be told when its time comes.
    Note(String),
}

/// Whose a content is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrafficOrigin {
    /// Of the sample told last.
    Sample,
    /// Of the unit, but of no whole sample.
    Unit,
    /// A command to it.
    Command,
    /// Other traffic.
    Other,
}

/// How to play a recording back.
#[derive(Debug, Clone)]
pub struct ReplayOptions {
    /// Links to open; all carry the same.
    pub links: Vec<LinkAddress>,
    /// Recorded time against the wall clock.
    pub speed: Speed,
    /// Begin only when a client is attached to a pty or over TCP.
    pub wait_for_client: bool,
    /// Identifiers of the unit in the recording.
    pub recorded_plan: CanIdMap,
    /// Faults of links, and what is expected; see [`refused`](super::refused).
    pub plan: Configuration,
}

/// Where steps come from: so many samples each. When nobody can send any more, the replay ends.
pub type Steps = Receiver<u64>;
