//! Commands to the unit and its replies.

use geu_protocol::{Command, CommandResult, LINK_VERSION, Reply, command};

use super::{CompletedSample, GyroUnit, Power, SelfTest};

#[derive(Debug, Clone, Copy)]
pub struct CommandResponse {
    /// Goes to the link (TCP: the client) that asked.
    pub reply: Reply,
    /// For a POLL that was granted: the messages that follow the reply, to the same client.
    pub polled: Option<CompletedSample>,
}

impl GyroUnit {
    /// Carries out the payload of a COMMAND within the running sample interval.
    ///
    /// # Errors
    /// The reply that would have come, where a fault keeps the unit from hearing the command.
    pub fn command(&mut self, payload: &[u8]) -> Result<CommandResponse, Reply> {
        let unfaulted = self.clean.as_mut().map(|clean| clean.answer(payload));
        // Each once: a client may send as many as it likes.
        let opcode = payload.first().copied().filter(|opcode| !self.heard.contains(opcode));
        self.heard.extend(opcode);
        match unfaulted {
            Some(answer) if self.faults.is_silent() => Err(answer.reply),
            _ => Ok(self.answer(payload)),
        }
    }

    fn answer(&mut self, payload: &[u8]) -> CommandResponse {
        let opcode = payload.first().copied().unwrap_or(0);
        let answer = |outcome| CommandResponse { reply: Reply::new(opcode, outcome, &[]), polled: None };
        let command = match command::parse(payload) {
            Ok(command) => command,
            Err(outcome) => return answer(outcome),
        };
        match command {
            Command::Ping => {
                let values = [LINK_VERSION.0, LINK_VERSION.1];
                return CommandResponse { reply: Reply::new(opcode, CommandResult::Done, &values), polled: None };
            }
            Command::SetMode { polled } => self.polled = polled,
            Command::Poll => match self.last {
                Some(last) if self.polled => {
                    return CommandResponse { polled: Some(last), ..answer(CommandResult::Done) };
                }
                _ => return answer(CommandResult::NotPossibleNow),
            },
            Command::SelfTest { gyros, counts, samples } => {
                if self.self_test.is_some() {
                    return answer(CommandResult::NotPossibleNow);
                }
                self.self_test = Some(SelfTest { gyros, counts, samples_left: samples });
            }
            Command::ResetSequence => (self.sequence, self.clock_count) = (u64::MAX, 0),
            Command::GyroPower { gyros } => {
                let spin_up = self.spin_up_samples();
                for (gyro, channel) in self.configuration.device.gyros().zip(&mut self.channels) {
                    channel.power = match (gyros & gyro.bit() != 0, &channel.power) {
                        (true, Power::Off) => Power::On(spin_up),
                        (true, Power::On(left)) => Power::On(*left),
                        (false, _) => Power::Off,
                    };
                }
            }
            Command::Heater { on } => self.sensor.heater_on = on,
        }
        answer(CommandResult::Done)
    }
}
