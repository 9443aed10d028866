//! The input of a replay: the items of a recording, and options.

use std::sync::mpsc::Receiver;

use geu_model::Configuration;
use geu_protocol::{CanIdMap, Sample};

use crate::cadence::Speed;
use crate::link::LinkAddress;
use geu_recorder::link_model::WireData;

/// An item of a recording with its time.
#[derive(Debug, Clone, PartialEq)]
pub struct ReplayItem {
    /// Time since the start of the recording, ns: the time base of faults.
    pub recorded_ns: i64,
    /// Time since the start of the replay at speed 1, ns; not less than that of the previous item.
    pub played_ns: i64,
    /// Content.
    pub what: ReplayItemKind,
}

/// Content of an item.
#[derive(Debug, Clone, PartialEq)]
pub enum ReplayItemKind {
    /// A sample begins; its contents follow.
    Sample {
        /// The decoded sample.
        sample: Sample,
        /// True if it was recorded on CAN.
        is_can: bool,
    },
    /// Recorded bytes or frame.
    Content(WireData, TrafficOrigin),
    /// A message to log at its time.
    Note(String),
}

/// Origin of a content.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrafficOrigin {
    /// Part of the last sample.
    Sample,
    /// From the unit, but not part of a complete sample.
    Unit,
    /// A command to the unit.
    Command,
    /// Other traffic.
    Other,
}

/// Options of a replay.
#[derive(Debug, Clone)]
pub struct ReplayOptions {
    /// Links to open; all send the same samples.
    pub links: Vec<LinkAddress>,
    /// Ratio of recorded time to the wall clock.
    pub speed: Speed,
    /// Start when a client is attached to a pty or over TCP.
    pub wait_for_client: bool,
    /// CAN identifiers of the unit in the recording.
    pub recorded_plan: CanIdMap,
    /// The unit; faults of links, and expectations; see [`refused`](super::refused). A described unit has none.
    pub plan: Configuration,
}

/// Source of steps, each a number of samples. The replay ends when all senders are dropped.
pub type Steps = Receiver<u64>;
