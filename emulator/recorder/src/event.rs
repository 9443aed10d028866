//! The events of a unit, as they are recorded and observed.

use std::mem::{size_of, size_of_val};
use std::sync::Arc;

use geu_model::fault::Fault;
use geu_model::fault::engine::{ActiveFault, FaultEvent};
use geu_model::{CompletedSample, InjectionRecord, Trace};
use geu_protocol::Reply;

/// Approximate size of a fault in memory, with its conditions and texts.
const FAULT_BYTES: usize = 2048;

/// An event in the unit, in on-board order.
#[derive(Clone)]
pub enum UnitEvent {
    /// A sample ended, with the faults that acted on it.
    Sample(CompletedSample, Vec<Trace>, Option<Arc<InjectionRecord>>),
    /// A command came over a link within the running sample interval. `reply` is an error with the suppressed reply if a
    /// fault silences the unit.
    Command {
        link: String,
        payload: Vec<u8>,
        running_end_ns: i64,
        reply: Result<Reply, Reply>,
        acting: Arc<Vec<ActiveFault>>,
    },
    /// The last sample was polled over a link.
    Polled(PolledSample),
    /// A sample was too late to be sent live: the process was stalled.
    Missed { frame: u64 },
    /// A fault started or ended, or an expectation was decided, at the end of the last sample interval.
    Happened(FaultEvent),
    /// The operator injected a fault.
    Injected(Fault),
    /// The operator started a fault, at this on-board time.
    StartedByHand { id: String, at_s: f64 },
    /// The operator removed a fault, from this on-board time on.
    Cleared { id: String, until_s: f64 },
}

/// A sample that was polled over a link.
#[derive(Clone)]
pub struct PolledSample {
    pub link: String,
    pub sample: CompletedSample,
    pub reply: Reply,
    /// Scheduled end, its time stamp.
    pub end_ns: i64,
    /// The faults that acted on it.
    pub injected: Option<Arc<InjectionRecord>>,
    /// The faults that act at its transmission.
    pub acting: Arc<Vec<ActiveFault>>,
}

impl UnitEvent {
    /// Approximate size in memory. The commands and polls of a sample share its list of active faults, which is counted with
    /// the sample.
    pub fn bytes(&self) -> usize {
        let of_injected = |injected: &Option<Arc<InjectionRecord>>| {
            injected.as_ref().map_or(0, |injected| size_of::<InjectionRecord>() + size_of_val(&injected.acting[..]))
        };
        let more = match self {
            UnitEvent::Sample(_, traces, injected) => size_of_val(&traces[..]) + of_injected(injected),
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
    fn active_faults_count_with_the_sample_and_not_with_each_command() {
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
        let sample = UnitEvent::Sample(ended, traces, injected);
        assert!(sample.bytes() > 1000 * size_of::<ActiveFault>(), "{}", sample.bytes());
        let (link, payload, reply) = ("tcp".to_owned(), vec![1], unit.command(&[1]).map(|answer| answer.reply));
        let command = UnitEvent::Command { link, payload, running_end_ns: 0, reply, acting };
        assert!(command.bytes() < 1000, "64 MB must hold some hundred thousand of them: {}", command.bytes());
    }
}
