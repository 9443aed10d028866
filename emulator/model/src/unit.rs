//! The unit as a state machine: half seconds, commands, modes.

use geu_protocol::{CLOCK_PER_HALF_SECOND, HalfSecond, LINK_VERSION, Outcome, Reply};

/// The answer to one COMMAND.
#[derive(Debug, Clone, Copy)]
pub struct Answer {
    /// Goes to the link (TCP: the client) that asked.
    pub reply: Reply,
    /// For a POLL that was granted: the messages that follow the reply, to the same client.
    pub polled: Option<HalfSecond>,
}

/// A half second that just ended.
#[derive(Debug, Clone, Copy)]
pub struct Ended {
    /// What the unit tells of it.
    pub half_second: HalfSecond,
    /// Whether it is sent on every link now (cyclic mode), or kept to be polled.
    pub cyclic: bool,
    /// Scheduled end, true time since the start of the first half second, ns.
    pub end_ns: i64,
}

/// The unit.
#[derive(Debug, Clone, Default)]
pub struct Unit {
    count: u64,
}

impl Unit {
    /// Scheduled end of the running half second, true time since the start of the first, ns.
    pub fn running_end_ns(&self) -> i64 {
        (self.count as i64 + 1) * 500_000_000
    }

    /// Carries out the payload of a COMMAND within the running half second.
    pub fn command(&mut self, payload: &[u8]) -> Answer {
        let opcode = payload.first().copied().unwrap_or(0);
        Answer { reply: Reply::new(opcode, Outcome::Done, &[LINK_VERSION.0, LINK_VERSION.1]), polled: None }
    }

    /// Ends the running half second and begins the next.
    pub fn end_half_second(&mut self) -> Ended {
        let half_second = HalfSecond {
            sequence: self.count as u16,
            clock_count: (self.count + 1) * CLOCK_PER_HALF_SECOND,
            gyro_flags: 0x0F,
            unit_flags: 7,
            electronics_centi_c: 2000,
            sensor_centi_c: 7000,
            increments: [0; 4],
        };
        let ended = Ended { half_second, cyclic: true, end_ns: self.running_end_ns() };
        self.count += 1;
        ended
    }
}
