//! The commands: one table of opcodes, arguments and their ranges; parsing, replies, help texts and documents read it.

mod argument;

pub use argument::written;

use crate::field::WireType;
pub use crate::hex::hex;
use crate::hex::read_hex;
use crate::message::MessageId;
use crate::suggestion::did_you_mean;

/// CAN identifier, relative to the base, of a COMMAND to the unit.
pub const COMMAND_CAN: MessageId = MessageId::Can(8);
/// CAN identifier, relative to the base, of a REPLY from the unit.
pub const REPLY_CAN: MessageId = MessageId::Can(9);
/// Serial frame type of a COMMAND.
pub const COMMAND_SERIAL: MessageId = MessageId::Serial(0x10);
/// Serial frame type of a REPLY.
pub const REPLY_SERIAL: MessageId = MessageId::Serial(0x11);
pub const COMMAND_LENGTHS: std::ops::RangeInclusive<usize> = 1..=8;
pub const REPLY_LENGTHS: std::ops::RangeInclusive<usize> = 2..=8;

/// Result of a command in its REPLY.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum CommandResult {
    /// 0: done.
    Done,
    /// 1: unknown opcode.
    UnknownOpcode,
    /// 2: bad argument: too few, too many, or out of range.
    BadArgument,
    /// 3: not possible now.
    NotPossibleNow,
}

impl CommandResult {
    /// All four; the index is the code on the wire.
    pub const ALL: [CommandResult; 4] =
        [CommandResult::Done, CommandResult::UnknownOpcode, CommandResult::BadArgument, CommandResult::NotPossibleNow];

    /// The words of the interface control document.
    pub const fn text(self) -> &'static str {
        ["done", "unknown opcode", "bad argument", "not possible now"][self as usize]
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ArgumentSpec {
    pub name: &'static str,
    pub wire: WireType,
    pub range: (i64, i64),
    /// Meaning, a phrase; for a choice the values and their names: `0 off, 1 on`.
    pub meaning: &'static str,
}

#[derive(Debug, Clone, Copy)]
pub struct CommandSpec {
    pub opcode: u8,
    /// Name, upper case.
    pub name: &'static str,
    /// Arguments after the opcode, without gaps.
    pub arguments: &'static [ArgumentSpec],
    /// Values after opcode and result in a REPLY with result done.
    pub values: &'static [ArgumentSpec],
    pub meaning: &'static str,
    /// The command with values in range.
    command: fn([i64; 3]) -> Command,
}

const fn argument(name: &'static str, wire: WireType, range: (i64, i64), meaning: &'static str) -> ArgumentSpec {
    ArgumentSpec { name, wire, range, meaning }
}

pub const COMMANDS: &[CommandSpec] = &[
    CommandSpec {
        opcode: 0x01,
        name: "PING",
        arguments: &[],
        values: &[
            argument("major", WireType::U8, (0, 255), "link version, major"),
            argument("minor", WireType::U8, (0, 255), "link version, minor"),
        ],
        meaning: "asks for the link version",
        command: |_| Command::Ping,
    },
    CommandSpec {
        opcode: 0x02,
        name: "SET_MODE",
        arguments: &[argument("mode", WireType::U8, (0, 1), "0 cyclic, 1 polled")],
        values: &[],
        meaning: "chooses whether data are sent each sample or when polled",
        command: |[mode, ..]| Command::SetMode { polled: mode == 1 },
    },
    CommandSpec {
        opcode: 0x03,
        name: "POLL",
        arguments: &[],
        values: &[],
        meaning: "polled mode only: the last completed sample's messages follow the REPLY",
        command: |_| Command::Poll,
    },
    CommandSpec {
        opcode: 0x04,
        name: "SELF_TEST",
        arguments: &[
            argument("gyros", WireType::U8, (1, 15), "mask of gyros under test, bit 0 GYRX"),
            argument("counts", WireType::I16, (-32768, 32767), "counts added each sample"),
            argument("half_seconds", WireType::U8, (1, 255), "duration"),
        ],
        values: &[],
        meaning: "torquers add that many counts, unit flag 3 set meanwhile",
        command: |[gyros, counts, samples]| Command::SelfTest {
            gyros: gyros as u8,
            counts: counts as i16,
            samples: samples as u8,
        },
    },
    CommandSpec {
        opcode: 0x05,
        name: "RESET_SEQUENCE",
        arguments: &[],
        values: &[],
        meaning: "sequence and clock count restart at 0 at the end of the running sample interval",
        command: |_| Command::ResetSequence,
    },
    CommandSpec {
        opcode: 0x06,
        name: "GYRO_POWER",
        arguments: &[argument("gyros", WireType::U8, (0, 15), "mask of gyros that run, bit 0 GYRX")],
        values: &[],
        meaning: "a stopped gyro reads 0 and not valid; spin-up takes 60 s",
        command: |[gyros, ..]| Command::GyroPower { gyros: gyros as u8 },
    },
    CommandSpec {
        opcode: 0x07,
        name: "HEATER",
        arguments: &[argument("on", WireType::U8, (0, 1), "0 off, 1 on")],
        values: &[],
        meaning: "off, the sensor cools towards the electronics temperature with a time constant of 20 min",
        command: |[on, ..]| Command::Heater { on: on == 1 },
    },
];

/// A valid command: every value is in the range of its [`ArgumentSpec`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Command {
    Ping,
    SetMode {
        polled: bool,
    },
    /// Send the last completed sample again.
    Poll,
    SelfTest {
        /// Mask, bit 0 GYRX.
        gyros: u8,
        counts: i16,
        samples: u8,
    },
    ResetSequence,
    GyroPower {
        /// Mask, bit 0 GYRX.
        gyros: u8,
    },
    Heater {
        on: bool,
    },
}

/// The command in the payload of a COMMAND.
///
/// # Errors
/// The outcome to reply with: [`CommandResult::UnknownOpcode`], or [`CommandResult::BadArgument`] for too few or too many bytes
/// and for values out of range.
pub fn parse(payload: &[u8]) -> Result<Command, CommandResult> {
    let (&opcode, mut rest) = payload.split_first().ok_or(CommandResult::BadArgument)?;
    let spec = COMMANDS.iter().find(|spec| spec.opcode == opcode).ok_or(CommandResult::UnknownOpcode)?;
    let mut values = [0; 3];
    for (value, argument) in values.iter_mut().zip(spec.arguments) {
        let length = argument.wire.length();
        *value = argument.wire.read(rest.get(..length).ok_or(CommandResult::BadArgument)?);
        rest = &rest[length..];
        if *value < argument.range.0 || *value > argument.range.1 {
            return Err(CommandResult::BadArgument);
        }
    }
    if !rest.is_empty() {
        return Err(CommandResult::BadArgument);
    }
    Ok((spec.command)(values))
}

/// The payload of a COMMAND with these argument values, whether they are in range or not.
pub fn payload(spec: &CommandSpec, values: &[i64]) -> Vec<u8> {
    let mut bytes = vec![spec.opcode];
    for (argument, &value) in spec.arguments.iter().zip(values) {
        let start = bytes.len();
        bytes.resize(start + argument.wire.length(), 0);
        argument.wire.write(value, &mut bytes[start..]);
    }
    bytes
}

/// The payload of the command of this name, upper or lower case, - or _. Values that the wire cannot hold are rejected;
/// values that only the unit rejects are not.
///
/// # Errors
/// Unknown name, wrong number of arguments, or a value beyond the wire type.
pub fn from_name(name: &str, values: &[i64]) -> Result<Vec<u8>, String> {
    let spec = spec(name)?;
    expect_count(spec, values.len())?;
    payload_of(spec, values)
}

fn spec(name: &str) -> Result<&'static CommandSpec, String> {
    let wanted = name.to_uppercase().replace('-', "_");
    COMMANDS.iter().find(|spec| spec.name == wanted).ok_or_else(|| {
        let names: Vec<_> = COMMANDS.iter().map(|spec| spec.name).collect();
        let (hint, shown) = (did_you_mean(&wanted, &names), name.chars().take(100).collect::<String>());
        format!("{shown:?} is no command; {hint}expected one of {}", names.join(", "))
    })
}

/// True for the name of a command, upper or lower case, - or _.
pub fn is_name(name: &str) -> bool {
    spec(name).is_ok()
}

/// Refuses more or fewer arguments than the command has.
fn expect_count(spec: &CommandSpec, count: usize) -> Result<(), String> {
    if count == spec.arguments.len() {
        return Ok(());
    }
    let usage: Vec<_> =
        spec.arguments.iter().map(|argument| format!("{} ({})", argument.name, argument.meaning)).collect();
    Err(format!(
        "{}: expected {}, got {count} argument{}",
        spec.name,
        if usage.is_empty() { "no arguments".to_owned() } else { usage.join(", ") },
        if count == 1 { "" } else { "s" }
    ))
}

/// The payload with one value for each argument; an error if the wire cannot hold one.
fn payload_of(spec: &CommandSpec, values: &[i64]) -> Result<Vec<u8>, String> {
    for (argument, &value) in spec.arguments.iter().zip(values) {
        let (min, max) = argument.wire.limits();
        if value < min || value > max {
            let (from, to) = argument.range;
            return Err(format!("{} {}: expected a number from {from} to {to}, got {value}", spec.name, argument.name));
        }
    }
    Ok(payload(spec, values))
}

/// The payload of hexadecimal digits, with or without blanks: any bytes that a COMMAND can carry.
pub fn from_hex(hex: &str) -> Option<Vec<u8>> {
    read_hex(hex).filter(|bytes| COMMAND_LENGTHS.contains(&bytes.len()))
}

/// The payload of a REPLY: 2 to 8 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reply {
    bytes: [u8; 8],
    length: u8,
}

impl Reply {
    /// A reply to `opcode` with `values` after the result.
    ///
    /// # Panics
    /// With more than six bytes of values.
    pub fn new(opcode: u8, outcome: CommandResult, values: &[u8]) -> Reply {
        let mut bytes = [0; 8];
        bytes[0] = opcode;
        bytes[1] = outcome as u8;
        bytes[2..2 + values.len()].copy_from_slice(values);
        Reply { bytes, length: 2 + values.len() as u8 }
    }

    /// The reply in a received payload; `None` for a wrong length or an unknown result.
    pub fn read(payload: &[u8]) -> Option<Reply> {
        if !REPLY_LENGTHS.contains(&payload.len()) {
            return None;
        }
        let outcome = *CommandResult::ALL.get(usize::from(payload[1]))?;
        Some(Reply::new(payload[0], outcome, &payload[2..]))
    }

    pub fn opcode(&self) -> u8 {
        self.bytes[0]
    }

    pub fn outcome(&self) -> CommandResult {
        CommandResult::ALL[usize::from(self.bytes[1])]
    }

    /// The values after the result.
    pub fn values(&self) -> &[u8] {
        &self.bytes[2..usize::from(self.length)]
    }

    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_of_the_table_is_understood_at_both_ends_of_its_ranges() {
        for spec in COMMANDS {
            for end in [0, 1] {
                let values: Vec<i64> =
                    spec.arguments.iter().map(|a| if end == 0 { a.range.0 } else { a.range.1 }).collect();
                assert!(parse(&payload(spec, &values)).is_ok(), "{} {values:?}", spec.name);
            }
        }
    }

    #[test]
    fn choices_are_those_the_meaning_lists_and_cover_the_range() {
        let choices = |name| COMMANDS.iter().find(|spec| spec.name == name).unwrap().arguments[0].choices();
        assert_eq!(choices("SET_MODE"), [(0, "cyclic"), (1, "polled")]);
        assert_eq!(choices("HEATER"), [(0, "off"), (1, "on")]);
        assert_eq!(choices("SELF_TEST"), []);
        assert_eq!(choices("GYRO_POWER"), []);
    }

    #[test]
    fn names_and_hexadecimal_digits_are_read_in_all_spellings() {
        assert_eq!(from_name("set-mode", &[1]), Ok(vec![2, 1]));
        assert_eq!(from_name("Self_Test", &[15, -100, 9]), Ok(vec![4, 15, 0xFF, 0x9C, 9]));
        assert_eq!(from_name("SET_MODE", &[7]), Ok(vec![2, 7]), "the unit is to refuse it");
        for (name, values) in [("nonsense", &[][..]), ("PING", &[1]), ("SET_MODE", &[]), ("SET_MODE", &[256])] {
            assert!(from_name(name, values).is_err(), "{name} {values:?}");
        }
        assert_eq!(from_hex("09 0aFF"), Some(vec![9, 10, 255]));
        for hex in ["", "1", "zz", "010203040506070809", "é1"] {
            assert_eq!(from_hex(hex), None, "{hex}");
        }
    }

    #[test]
    fn wrong_opcodes_lengths_and_values_get_the_answer_of_the_icd() {
        for (bytes, outcome) in [
            (&[0x00][..], CommandResult::UnknownOpcode),
            (&[0x08], CommandResult::UnknownOpcode),
            (&[0xFF, 1, 2], CommandResult::UnknownOpcode),
            (&[0x01, 0x00], CommandResult::BadArgument),
            (&[0x02], CommandResult::BadArgument),
            (&[0x02, 2], CommandResult::BadArgument),
            (&[0x04, 0, 0, 1, 1], CommandResult::BadArgument),
            (&[0x04, 16, 0, 1, 1], CommandResult::BadArgument),
            (&[0x04, 1, 0, 1, 0], CommandResult::BadArgument),
            (&[0x04, 1, 0, 1], CommandResult::BadArgument),
            (&[0x06, 16], CommandResult::BadArgument),
            (&[0x07, 2], CommandResult::BadArgument),
        ] {
            assert_eq!(parse(bytes), Err(outcome), "{bytes:02X?}");
        }
        assert_eq!(parse(&[4, 3, 0xFF, 0x9C, 9]), Ok(Command::SelfTest { gyros: 3, counts: -100, samples: 9 }));
    }
}
