//! What a unit tells whoever records it.

use std::mem::{size_of, size_of_val};
use std::sync::Arc;

use geu_model::fault::Fault;
use geu_model::fault::acting::{Acting, Happening};
use geu_model::{Ended, Injected, Trace};
use geu_protocol::{HalfSecond, Reply};

/// A fault in memory takes about so many bytes: it has conditions and texts.
const FAULT_BYTES: usize = 2048;

/// What happened in the unit, told in the order in which it happened on board.
#[derive(Clone)]
pub(crate) enum Event {
    /// A half second ended, and what faults did to it.
    HalfSecond(Ended, Box<[Trace; 4]>, Option<Arc<Injected>>),
    /// A command came over a link within the half second that runs; its scheduled end, what the unit answers (an
    /// error: what it would, did a fault not keep it from hearing), and the faults that act.
    Command {
        link: String,
        payload: Vec<u8>,
        running_end_ns: i64,
        reply: Result<Reply, Reply>,
        acting: Arc<Vec<Acting>>,
    },
    /// The half second that ended last was sent because it was polled over a link, stamped with its scheduled end: what
    /// faults did to it, and those that act as it is sent.
    Polled {
        link: String,
        half_second: HalfSecond,
        reply: Reply,
        end_ns: i64,
        injected: Option<Arc<Injected>>,
        acting: Arc<Vec<Acting>>,
    },
    /// A half second came too late to be sent live: the process was held up.
    Missed { frame: u64 },
    /// Something became of a fault or an expectation, with the end of the last half second.
    Happened(Happening),
    /// A fault was injected while the unit ran.
    Injected(Fault),
    /// A fault that waited for a hand was started, with this on-board time.
    StartedByHand { id: String, at_s: f64 },
    /// A fault was taken away, from this on-board time on.
    Cleared { id: String, until_s: f64 },
}

impl Event {
    /// Memory that it takes while it waits, about.
    pub fn bytes(&self) -> usize {
        let of_acting = |acting: &Arc<Vec<Acting>>| size_of_val(&acting[..]);
        let of_injected = |injected: &Option<Arc<Injected>>| {
            injected.as_ref().map_or(0, |injected| size_of::<Injected>() + of_acting(&injected.acting))
        };
        let more = match self {
            Event::HalfSecond(_, traces, injected) => size_of_val(&**traces) + of_injected(injected),
            Event::Command { link, payload, acting, .. } => link.len() + payload.len() + of_acting(acting),
            Event::Polled { link, injected, acting, .. } => link.len() + of_injected(injected) + of_acting(acting),
            Event::Happened(_) | Event::Injected(_) => FAULT_BYTES,
            Event::StartedByHand { id, .. } | Event::Cleared { id, .. } => id.len(),
            Event::Missed { .. } => 0,
        };
        size_of::<Event>() + more
    }
}
