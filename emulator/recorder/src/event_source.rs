//! A unit that reports its events, and repeats the commands of a recorded run.

use std::iter::Peekable;
use std::sync::Arc;
use std::vec;

use geu_model::configuration::RecordedCommand;
use geu_model::fault::engine::ActiveFault;
use geu_model::{CompletedSample, Configuration, GyroUnit, Truth};
use geu_protocol::Reply;

use crate::event::{PolledSample, UnitEvent};

/// A unit that reports its events, and repeats the commands of a recorded run.
pub struct EventSource {
    pub unit: GyroUnit,
    /// Commands of a recorded run that are still to be repeated.
    recorded: Peekable<vec::IntoIter<RecordedCommand>>,
    /// Scheduled end of the last sample, ns.
    last_end_ns: i64,
}

/// The response of the unit to a command.
pub struct CommandResponse {
    /// `None` if a fault silences the unit.
    pub reply: Option<Reply>,
    /// The sample that follows the reply.
    pub polled: Option<CompletedSample>,
    /// The faults of the running sample interval.
    pub acting: Arc<Vec<ActiveFault>>,
}

impl EventSource {
    pub fn new(configuration: &Configuration, truth: &Truth) -> EventSource {
        let recorded = configuration.run.commands.clone().into_iter().peekable();
        EventSource { unit: GyroUnit::on(configuration, truth), recorded, last_end_ns: 0 }
    }

    /// Executes the payload of a COMMAND from `link`; adds its events to `events`.
    pub fn command(&mut self, link: &str, payload: &[u8], events: &mut Vec<UnitEvent>) -> CommandResponse {
        let running_end_ns = self.unit.running_end_ns();
        let answer = self.unit.command(payload);
        let acting = self.unit.faults().acting().clone();
        events.push(UnitEvent::Command {
            link: link.to_owned(),
            payload: payload.to_vec(),
            running_end_ns,
            reply: answer.map(|answer| answer.reply),
            acting: acting.clone(),
        });
        let Ok(answer) = answer else { return CommandResponse { reply: None, polled: None, acting } };
        let (reply, polled) = (answer.reply, answer.polled);
        events.extend(polled.map(|sample| {
            UnitEvent::Polled(PolledSample {
                link: link.to_owned(),
                sample,
                reply,
                end_ns: self.last_end_ns,
                injected: self.unit.injected().cloned(),
                acting: acting.clone(),
            })
        }));
        CommandResponse { reply: Some(reply), polled, acting }
    }

    /// Repeats the commands that the recorded run had received by now; adds their events to `events`.
    pub fn repeat_recorded(&mut self, events: &mut Vec<UnitEvent>) {
        while let Some(command) = self.recorded.next_if(|command| command.sample <= self.unit.ended()) {
            self.command(&command.link, &command.payload, events);
        }
    }

    /// Ends the running sample; adds it and the events of faults to `events`.
    pub fn end_sample(&mut self, events: &mut Vec<UnitEvent>) -> CompletedSample {
        let (ended, traces) = self.unit.end_sample_traced();
        events.push(UnitEvent::Sample(ended, traces, self.unit.injected().cloned()));
        self.ended(ended, events)
    }

    /// Ends the running sample for a run that neither records nor shows it; adds the events of faults to `events`.
    pub fn end_sample_untraced(&mut self, events: &mut Vec<UnitEvent>) -> CompletedSample {
        let ended = self.unit.end_sample();
        self.ended(ended, events)
    }

    fn ended(&mut self, ended: CompletedSample, events: &mut Vec<UnitEvent>) -> CompletedSample {
        self.last_end_ns = ended.end_ns;
        self.take_happened(events);
        ended
    }

    /// Adds the events of faults and expectations since the last call to `events`.
    pub fn take_happened(&mut self, events: &mut Vec<UnitEvent>) {
        events.extend(self.unit.take_happened().into_iter().map(UnitEvent::Happened));
    }
}
