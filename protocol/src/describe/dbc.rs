//! The CAN database (`geu.dbc`), as cantools, SavvyCAN and Vector's tools read it.

use std::fmt::Write;

use super::{CYCLE_MS, can_messages};
use crate::can::CanIdMap;
use crate::command::{ArgumentSpec, COMMAND_LENGTHS, COMMANDS, CommandResult, CommandSpec, REPLY_LENGTHS};
use crate::field::{FieldSpec, WireType};
use crate::message::{MESSAGES, MessageId};

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
    values: Vec<(i64, String)>,
    comment: String,
}

impl Signal {
    /// A number at byte `at`; big-endian signals start at their most significant bit.
    fn number(at: usize, name: String, wire: WireType) -> Signal {
        Signal {
            name,
            multiplex: None,
            opcodes: None,
            start_bit: 8 * at + 7,
            bits: 8 * wire.length(),
            signed: wire.signed(),
            scale: 1.0,
            limits: wire.limits(),
            unit: "",
            values: Vec::new(),
            comment: String::new(),
        }
    }
}

struct Message {
    id: u16,
    name: &'static str,
    length: usize,
    signals: Vec<Signal>,
    comment: String,
}

/// The CAN database for identifiers at `plan`.
pub fn dbc(plan: CanIdMap) -> String {
    write(&messages(plan)).expect("writing to a String does not fail")
}

fn messages(plan: CanIdMap) -> Vec<Message> {
    can_messages()
        .map(|(offset, name)| {
            let id = plan.base() + offset;
            match name {
                "COMMAND" => command(id),
                "REPLY" => reply(id),
                _ => cyclic(id, offset),
            }
        })
        .collect()
}

fn cyclic(id: u16, offset: u16) -> Message {
    let spec = MESSAGES.iter().find(|message| message.id == MessageId::Can(offset)).expect("a cyclic message");
    Message {
        id,
        name: spec.name,
        length: spec.length(),
        signals: spec.placed_fields().flat_map(|(at, field)| field_signals(at, field)).collect(),
        comment: spec.meaning.to_string(),
    }
}

/// A field of flags is a signal for each of its bits, any other field one signal.
fn field_signals(at: usize, field: &FieldSpec) -> Vec<Signal> {
    if field.bits.is_empty() {
        let comment = match field.name {
            "crc" => format!("{}, over the 8 bytes of INCREMENTS then the first 6 of STATUS", field.meaning),
            _ => field.meaning.to_string(),
        };
        let number = Signal::number(at, field.name.to_string(), field.wire);
        return vec![Signal { scale: field.scale, unit: field.unit, comment, ..number }];
    }
    let bit_signal = |bit: &crate::field::Bit| Signal {
        start_bit: 8 * at + usize::from(bit.bit),
        bits: 1,
        limits: (0, 1),
        comment: bit.meaning.to_string(),
        ..Signal::number(at, bit.name.to_string(), field.wire)
    };
    field.bits.iter().map(bit_signal).collect()
}

fn opcode_signal() -> Signal {
    Signal {
        multiplex: Some("M".to_string()),
        values: COMMANDS.iter().map(|command| (i64::from(command.opcode), command.name.to_string())).collect(),
        comment: "which command; chooses the signals after it".to_string(),
        ..Signal::number(0, "opcode".to_string(), WireType::U8)
    }
}

/// The arguments or reply values of one command, from byte `at` on.
fn argument_signals(command: &CommandSpec, arguments: &[ArgumentSpec], mut at: usize) -> Vec<Signal> {
    let mut signals = Vec::new();
    for argument in arguments {
        let name = format!("{}_{}", command.name.to_lowercase(), argument.name);
        signals.push(Signal {
            multiplex: Some(format!("m{}", command.opcode)),
            opcodes: Some(format!("{0}-{0}", command.opcode)),
            limits: argument.range,
            values: argument.choices().into_iter().map(|(value, name)| (value, name.to_string())).collect(),
            comment: argument.meaning.to_string(),
            ..Signal::number(at, name, argument.wire)
        });
        at += argument.wire.length();
    }
    signals
}

/// Runs of the opcodes 0 to 255 that `wanted` holds for: `0-1, 3-3`.
fn opcode_runs(wanted: impl Fn(u8) -> bool) -> String {
    let mut runs: Vec<(u8, u8)> = Vec::new();
    for opcode in (0..=u8::MAX).filter(|&opcode| wanted(opcode)) {
        match runs.last_mut() {
            Some((_, last)) if *last + 1 == opcode => *last = opcode,
            _ => runs.push((opcode, opcode)),
        }
    }
    runs.iter().map(|(first, last)| format!("{first}-{last}")).collect::<Vec<_>>().join(", ")
}

fn command(id: u16) -> Message {
    let takes_arguments = |opcode| COMMANDS.iter().any(|c| c.opcode == opcode && !c.arguments.is_empty());
    let mut signals = vec![opcode_signal()];
    // Readers reject a multiplexer value without a signal, so opcodes without arguments get one too.
    signals.push(Signal {
        multiplex: Some("m0".to_string()),
        opcodes: Some(opcode_runs(|opcode| !takes_arguments(opcode))),
        comment: "a byte after an opcode that takes none; the unit answers bad argument".to_string(),
        ..Signal::number(1, "unexpected_argument".to_string(), WireType::U8)
    });
    signals.extend(COMMANDS.iter().flat_map(|command| argument_signals(command, command.arguments, 1)));
    Message {
        id,
        name: "COMMAND",
        length: *COMMAND_LENGTHS.end(),
        signals,
        comment: "to the unit: opcode and exactly its arguments, 1 to 8 bytes, so cut what an encoder pads; \
                  cantools decodes it with allow_truncated=True"
            .to_string(),
    }
}

fn reply(id: u16) -> Message {
    let result = Signal {
        multiplex: Some("m0".to_string()),
        opcodes: Some(opcode_runs(|_| true)),
        limits: (0, CommandResult::ALL.len() as i64 - 1),
        values: CommandResult::ALL.iter().map(|&outcome| (outcome as i64, outcome.text().to_string())).collect(),
        comment: "how the command ended; present for every opcode".to_string(),
        ..Signal::number(1, "result".to_string(), WireType::U8)
    };
    let mut signals = vec![opcode_signal(), result];
    signals.extend(COMMANDS.iter().flat_map(|command| argument_signals(command, command.values, 2)));
    Message {
        id,
        name: "REPLY",
        length: *REPLY_LENGTHS.end(),
        signals,
        comment: "from the unit, within 20 ms of the COMMAND: opcode, result, values; 2 to 8 bytes; cantools decodes \
                  it with allow_truncated=True"
            .to_string(),
    }
}

fn write(messages: &[Message]) -> Result<String, std::fmt::Error> {
    let (major, minor) = crate::LINK_VERSION;
    let mut text = format!("VERSION \"{major}.{minor}\"\n\nNS_ :\n\tCM_\n\tBA_DEF_\n\tBA_\n\tVAL_\n\tBA_DEF_DEF_\n");
    text.push_str("\tSG_MUL_VAL_\n\nBS_:\n\nBU_: GEU OBC\n");
    for message in messages {
        let (sender, receiver) = if message.name == "COMMAND" { ("OBC", "GEU") } else { ("GEU", "OBC") };
        writeln!(text, "\nBO_ {} {}: {} {sender}", message.id, message.name, message.length)?;
        for signal in &message.signals {
            let multiplex = signal.multiplex.as_ref().map(|multiplex| format!(" {multiplex}")).unwrap_or_default();
            let sign = if signal.signed { '-' } else { '+' };
            let [low, high] = [signal.limits.0, signal.limits.1].map(|limit| scaled(limit, signal.scale));
            writeln!(
                text,
                " SG_ {}{multiplex} : {}|{}@0{sign} ({},0) [{low}|{high}] \"{}\" {receiver}",
                signal.name, signal.start_bit, signal.bits, signal.scale, signal.unit
            )?;
        }
    }
    text.push_str("\nCM_ \"Link of the gyro electronics unit. Generated: geu describe dbc.\";\n");
    text.push_str("CM_ BU_ GEU \"gyro electronics unit\";\nCM_ BU_ OBC \"on-board computer\";\n");
    for message in messages {
        writeln!(text, "CM_ BO_ {} \"{}\";", message.id, message.comment)?;
        for signal in &message.signals {
            writeln!(text, "CM_ SG_ {} {} \"{}\";", message.id, signal.name, signal.comment)?;
        }
    }
    text.push_str("\nBA_DEF_ BO_ \"GenMsgCycleTime\" INT 0 65535;\nBA_DEF_DEF_ \"GenMsgCycleTime\" 0;\n");
    for message in messages.iter().filter(|message| MESSAGES.iter().any(|cyclic| cyclic.name == message.name)) {
        writeln!(text, "BA_ \"GenMsgCycleTime\" BO_ {} {CYCLE_MS};", message.id)?;
    }
    text.push('\n');
    for message in messages {
        for signal in message.signals.iter().filter(|signal| !signal.values.is_empty()) {
            write!(text, "VAL_ {} {}", message.id, signal.name)?;
            for (value, name) in &signal.values {
                write!(text, " {value} \"{name}\"")?;
            }
            text.push_str(" ;\n");
        }
    }
    text.push('\n');
    for message in messages {
        for signal in &message.signals {
            if let Some(opcodes) = &signal.opcodes {
                writeln!(text, "SG_MUL_VAL_ {} {} opcode {opcodes};", message.id, signal.name)?;
            }
        }
    }
    Ok(text)
}

/// A limit in the signal's unit, without the digits that binary fractions add.
fn scaled(limit: i64, scale: f64) -> String {
    if scale == 1.0 { limit.to_string() } else { format!("{:.2}", limit as f64 * scale) }
}
