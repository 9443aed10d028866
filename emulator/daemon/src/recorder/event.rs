//! What a unit tells whoever records it.

use std::mem::{size_of, size_of_val};
use std::sync::Arc;

use geu_model::fault::Fault;
use geu_model::fault::acting::{ActiveFault, FaultEvent};
use geu_model::{CompletedSample, InjectionRecord, Trace};
use geu_protocol::{Reply, Sample};

/// A fault in memory takes about so many bytes: it has conditions and texts.
const FAULT_BYTES: usize = 2048;

/// What happened in the unit, told in the order in which it happened on board.
#[derive(Clone)]
pub(crate) enum UnitEvent {
    /// A sample ended, and what faults did to it.
    Sample(CompletedSample, Box<[Trace; 4]>, Option<Arc<InjectionRecord>>),
    /// A command came over a link within the sample interval that runs; its scheduled end, what the unit answers (an
    /// error: what it would, did a fault not keep it from hearing), and the faults that act.
    Command {
        link: String,
        payload: Vec<u8>,
        running_end_ns: i64,
        reply: Result<Reply, Reply>,
        acting: Arc<Vec<ActiveFault>>,
    },
    /// The sample that ended last was sent because it was polled over a link, stamped with its scheduled end: what
    /// faults did to it, and those that act as it is sent.
    Polled(PolledSample),
    /// A sample came too late to be sent live: the process was held up.
    Missed { frame: u64 },
    /// Something became of a fault or an expectation, with the end of the last sample interval.
    Happened(FaultEvent),
    /// A fault was injected while the unit ran.
    Injected(Fault),
    /// A fault that waited for a hand was started, with this on-board time.
    StartedByHand { id: String, at_s: f64 },
    /// A fault was taken away, from this on-board time on.
    Cleared { id: String, until_s: f64 },
}

/// A sample that was polled over a link, stamped with its scheduled end: what faults did to it, and those that act as it is
/// sent.
#[derive(Clone)]
pub(crate) struct PolledSample {
    pub link: String,
    pub sample: Sample,
    pub reply: Reply,
    pub end_ns: i64,
    pub injected: Option<Arc<InjectionRecord>>,
    pub acting: Arc<Vec<ActiveFault>>,
}

impl UnitEvent {
    /// Memory that it takes while it waits, about. What acts in a sample interval is one list, which its commands and polls
    /// share: it counts once, with the sample.
    pub fn bytes(&self) -> usize {
        let of_injected = |injected: &Option<Arc<InjectionRecord>>| {
            injected.as_ref().map_or(0, |injected| size_of::<InjectionRecord>() + size_of_val(&injected.acting[..]))
        };
        let more = match self {
            UnitEvent::Sample(_, traces, injected) => size_of_val(&**traces) + of_injected(injected),
            UnitEvent::Command { link, payload, .. } => link.len() + payload.len(),
            UnitEvent::Polled(polled) => polled.link.len(),
            UnitEvent::Happened(_) | UnitEvent::Injected(_) => FAULT_BYTES,
            UnitEvent::StartedByHand { id, .. } | UnitEvent::Cleared { id, .. } => id.len(),
            UnitEvent::Missed { .. } => 0,
        };
        size_of::<UnitEvent>() + more
    }
}

#[cfg(test)]
mod tests {
    use geu_model::{Configuration, GyroUnit};

    use super::*;

    #[test]
    fn a_thousand_faults_that_act_count_with_the_sample_and_not_with_each_command() {
        let fault = |index| {
            format!("[[fault]]\nid = \"f{index}\"\nfault = \"stuck-count\"\ngyro = \"GYRX\"\ncounts = 1\nat_s = 0.0\n")
        };
        let mut configuration = Configuration::reference();
        let plan: String = (0..1000).map(fault).collect();
        configuration.add_plan("plan", &plan).expect("a plan");
        let mut unit = GyroUnit::new(&configuration);
        let (ended, traces) = unit.end_sample_traced();
        let acting = unit.faults().acting().clone();
        let injected = unit.injected().cloned();
        assert_eq!(acting.len(), 1000);
        let sample = UnitEvent::Sample(ended, Box::new(traces), injected);
        assert!(sample.bytes() > 1000 * size_of::<ActiveFault>(), "{}", sample.bytes());
        let (link, payload, reply) = ("tcp".to_owned(), vec![1], unit.command(&[1]).map(|answer| answer.reply));
        let command = UnitEvent::Command { link, payload, running_end_ns: 0, reply, acting };
        assert!(command.bytes() < 1000, "64 MB must hold some hundred thousand of them: {}", command.bytes());
    }
}
