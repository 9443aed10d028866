//! The messages and signals of the CAN database (`geu.dbc`), as cantools, SavvyCAN and Vector's tools read it.

use crate::can::CanIdMap;
use crate::command::{
    ArgumentSpec, COMMAND_CAN, COMMAND_LENGTHS, COMMANDS, CommandResult, CommandSpec, REPLY_CAN, REPLY_LENGTHS,
};
use crate::field::{Bit, FieldSpec, WireType};
use crate::map;
use crate::message::{MESSAGES, MessageId, MessageSpec};
use crate::template::Value;

/// One `SG_` line and the other attributes of the signal.
struct Signal {
    name: String,
    /// `M` for the multiplexer, `mN` for a signal of opcode N.
    multiplex: Option<String>,
    /// Opcodes of the signal, in the form of `SG_MUL_VAL_`.
    opcodes: Option<String>,
    start_bit: usize,
    bits: usize,
    signed: bool,
    scale: f64,
    limits: (i64, i64),
    unit: &'static str,
    values: Vec<(i64, &'static str)>,
    comment: String,
}

impl Signal {
    /// A number at byte `at`; big-endian signals start at their most significant bit.
    fn number(at: usize, name: impl Into<String>, wire: WireType, comment: impl Into<String>) -> Signal {
        Signal {
            name: name.into(),
            multiplex: None,
            opcodes: None,
            start_bit: 8 * at + 7,
            bits: 8 * wire.length(),
            signed: wire.signed(),
            scale: 1.0,
            limits: wire.limits(),
            unit: "",
            values: Vec::new(),
            comment: comment.into(),
        }
    }

    fn value(self) -> Value {
        // A limit in the signal's unit, without the digits that binary fractions add.
        let scaled = |limit: i64| match self.scale {
            1.0 => limit.to_string(),
            scale => format!("{:.2}", limit as f64 * scale),
        };
        let values = self.values.iter().map(|&(value, name)| map! { value: value, name: name });
        map! { low: scaled(self.limits.0), high: scaled(self.limits.1), values: values.collect::<Value>(),
        name: self.name, multiplex: self.multiplex, opcodes: self.opcodes, start_bit: self.start_bit as u32,
        bits: self.bits as u32, sign: if self.signed { "-" } else { "+" }, scale: self.scale, unit: self.unit,
        comment: self.comment }
    }
}

/// The tables for identifiers at `plan`.
pub(super) fn tables(plan: CanIdMap) -> Value {
    let message = |id, name: &str, length: usize, comment: &str, is_cyclic: bool, signals: Vec<Signal>| {
        let MessageId::Can(offset) = id else { return None };
        let (sender, receiver) = if name == "COMMAND" { ("OBC", "GEU") } else { ("GEU", "OBC") };
        let signals: Vec<Value> = signals.into_iter().map(Signal::value).collect();
        Some(
            map! { id: plan.base() + offset, name: name, length: length as u32, comment: comment, is_cyclic: is_cyclic,
            sender: sender, receiver: receiver, signals: signals },
        )
    };
    let cyclic = |spec: &MessageSpec| {
        let signals = spec.placed_fields().flat_map(|(at, field)| field_signals(at, field)).collect();
        message(spec.id, spec.name, spec.length(), spec.meaning, true, signals)
    };
    let command = "to the unit: opcode and exactly its arguments, 1 to 8 bytes, so cut what an encoder pads; \
                   cantools decodes it with allow_truncated=True";
    let reply = "from the unit, within 20 ms of the COMMAND: opcode, result, values; 2 to 8 bytes; cantools decodes \
                 it with allow_truncated=True";
    let messages = MESSAGES.iter().map(cyclic).chain([
        message(COMMAND_CAN, "COMMAND", *COMMAND_LENGTHS.end(), command, false, command_signals()),
        message(REPLY_CAN, "REPLY", *REPLY_LENGTHS.end(), reply, false, reply_signals()),
    ]);
    map! { major: crate::LINK_VERSION.0, minor: crate::LINK_VERSION.1, messages: messages.flatten().collect::<Value>() }
}

/// A field of flags is a signal for each of its bits, any other field one signal.
fn field_signals(at: usize, field: &FieldSpec) -> Vec<Signal> {
    if field.bits.is_empty() {
        let covered =
            if field.name == "crc" { ", over the 8 bytes of INCREMENTS then the first 6 of STATUS" } else { "" };
        let number = Signal::number(at, field.name, field.wire, format!("{}{covered}", field.meaning));
        return vec![Signal { scale: field.scale, unit: field.unit, ..number }];
    }
    let bit_signal = |bit: &Bit| Signal {
        start_bit: 8 * at + usize::from(bit.bit),
        bits: 1,
        limits: (0, 1),
        ..Signal::number(at, bit.name, field.wire, bit.meaning)
    };
    field.bits.iter().map(bit_signal).collect()
}

fn opcode_signal() -> Signal {
    Signal {
        multiplex: Some("M".to_string()),
        values: COMMANDS.iter().map(|command| (i64::from(command.opcode), command.name)).collect(),
        ..Signal::number(0, "opcode", WireType::U8, "which command; chooses the signals after it")
    }
}

/// The arguments or reply values of one command, from byte `at` on.
fn argument_signals(command: &CommandSpec, arguments: &'static [ArgumentSpec], mut at: usize) -> Vec<Signal> {
    let signal = |argument: &ArgumentSpec| {
        let name = format!("{}_{}", command.name.to_lowercase(), argument.name);
        let number = Signal::number(at, name, argument.wire, argument.meaning);
        at += argument.wire.length();
        Signal {
            multiplex: Some(format!("m{}", command.opcode)),
            opcodes: Some(format!("{0}-{0}", command.opcode)),
            limits: argument.range,
            values: argument.choices(),
            ..number
        }
    };
    arguments.iter().map(signal).collect()
}

/// Runs of the opcodes 0 to 255 that `wanted` holds for: `0-1, 3-3`.
fn opcode_runs(wanted: impl Fn(u8) -> bool) -> String {
    let opcodes: Vec<u8> = (0..=u8::MAX).filter(|&opcode| wanted(opcode)).collect();
    let runs = opcodes.chunk_by(|one, next| one + 1 == *next);
    runs.map(|run| format!("{}-{}", run[0], run[run.len() - 1])).collect::<Vec<_>>().join(", ")
}

fn command_signals() -> Vec<Signal> {
    let takes_arguments = |opcode| COMMANDS.iter().any(|c| c.opcode == opcode && !c.arguments.is_empty());
    let comment = "a byte after an opcode that takes none; the unit answers bad argument";
    let unexpected = Signal {
        multiplex: Some("m0".to_string()),
        opcodes: Some(opcode_runs(|opcode| !takes_arguments(opcode))),
        ..Signal::number(1, "unexpected_argument", WireType::U8, comment)
    };
    let arguments = COMMANDS.iter().flat_map(|command| argument_signals(command, command.arguments, 1));
    [opcode_signal(), unexpected].into_iter().chain(arguments).collect()
}

fn reply_signals() -> Vec<Signal> {
    let result = Signal {
        multiplex: Some("m0".to_string()),
        opcodes: Some(opcode_runs(|_| true)),
        limits: (0, CommandResult::ALL.len() as i64 - 1),
        values: CommandResult::ALL.iter().map(|&outcome| (outcome as i64, outcome.text())).collect(),
        ..Signal::number(1, "result", WireType::U8, "how the command ended; present for every opcode")
    };
    let values = COMMANDS.iter().flat_map(|command| argument_signals(command, command.values, 2));
    [opcode_signal(), result].into_iter().chain(values).collect()
}
