//! The interface control document (`ICD.md`): prose, and between `<!-- generated: … -->` and `<!-- end -->` generated tables
//! and test vectors.

use std::fmt::Write;

use super::{can_messages, serial_messages};
use crate::can::{CanIdMap, DEFAULT_BASE};
use crate::command::{ArgumentSpec, COMMAND_LENGTHS, COMMANDS, CommandResult, REPLY_LENGTHS, Reply, payload};
use crate::field::{CRC, FIELDS, FieldSpec, GYRO_FLAGS, Sample, UNIT_FLAGS};
use crate::hex::{hex, spaced_hex};
use crate::message::{MESSAGES, MessageId, MessageSpec};
use crate::serial::{BITS_PER_BYTE, DEFAULT_BAUD, FrameType, SYNC, data_frame, frame};

const BEGIN: &str = "<!-- generated: ";
const END: &str = "<!-- end -->";

/// The document with its generated sections from the tables of this crate.
///
/// # Panics
/// For a section that is not closed or has an unknown name: the document is part of this crate.
pub fn icd() -> String {
    refreshed(include_str!("../../ICD.md"))
}

fn refreshed(document: &str) -> String {
    let mut parts = document.split(BEGIN);
    let mut text = parts.next().unwrap_or_default().to_string();
    for part in parts {
        let (name, rest) = part.split_once(" -->").expect("the marker of a generated section ends with -->");
        let (_, prose) = rest.split_once(END).unwrap_or_else(|| panic!("section {name} lacks its {END}"));
        let section = section(name).expect("writing to a String does not fail");
        write!(text, "{BEGIN}{name} -->\n{section}{END}{prose}").expect("writing to a String does not fail");
    }
    text
}

type Text = Result<String, std::fmt::Error>;

fn section(name: &str) -> Text {
    match name {
        "version" => {
            let (major, minor) = crate::LINK_VERSION;
            Ok(format!("Link version {major}.{minor}.\n"))
        }
        "fields" => fields(),
        "flags" => flags(),
        "can" => can(),
        "serial" => serial(),
        "outcomes" => outcomes(),
        "commands" => commands(),
        "vectors" => vectors(),
        other => panic!("no generated section is called {other}"),
    }
}

fn fields() -> Text {
    let mut text = String::from("| field | type | unit | meaning |\n|---|---|---|---|\n");
    for field in FIELDS.iter().chain([&CRC]) {
        let unit = match (field.scale, field.unit) {
            (1.0, "") => "–".to_string(),
            (1.0, unit) => unit.to_string(),
            (scale, unit) => format!("{scale} {unit}"),
        };
        writeln!(text, "| {} | {} | {unit} | {} |", field.name, field.wire.name(), field.meaning)?;
    }
    Ok(text)
}

fn flags() -> Text {
    let mut text = String::from("| field | bit | name | set when |\n|---|---|---|---|\n");
    for (field, bits) in [("gyro_flags", GYRO_FLAGS), ("unit_flags", UNIT_FLAGS)] {
        for bit in bits {
            writeln!(text, "| {field} | {} | {} | {} |", bit.bit, bit.name, bit.meaning)?;
        }
    }
    Ok(text)
}

fn cyclic(id: MessageId) -> Option<&'static MessageSpec> {
    MESSAGES.iter().find(|message| message.id == id)
}

/// Length, content and meaning of a message, as table cells.
fn cells(id: MessageId, name: &str) -> String {
    let Some(message) = cyclic(id) else {
        let (lengths, content, meaning) = match name {
            "COMMAND" => (COMMAND_LENGTHS, "opcode, arguments", "to the unit"),
            _ => (REPLY_LENGTHS, "opcode, result, values", "from the unit, to the link that asked"),
        };
        return format!("{}–{} | {content} | {meaning}", lengths.start(), lengths.end());
    };
    let content: Vec<String> =
        message.placed_fields().map(|(at, field): (usize, &FieldSpec)| format!("{at}: {}", field.name)).collect();
    format!("{} | {} | {}", message.length(), content.join(", "), message.meaning)
}

fn can() -> Text {
    let mut text = format!(
        "Default base B = {DEFAULT_BASE:X}.\n\n| id | name | length | bytes | meaning |\n|---|---|---|---|---|\n"
    );
    for (offset, name) in can_messages() {
        writeln!(text, "| B+{offset} | {name} | {} |", cells(MessageId::Can(offset), name))?;
    }
    Ok(text)
}

fn serial() -> Text {
    let mut text = format!(
        "Default {DEFAULT_BAUD} baud, {BITS_PER_BYTE} bits on the line for each byte.\n\n    \
         {:02X} {:02X} | type u8 | length u8 | payload | CRC u16 over type, length, payload\n\n\
         | type | name | length | payload | meaning |\n|---|---|---|---|---|\n",
        SYNC[0], SYNC[1]
    );
    for (code, name) in serial_messages() {
        writeln!(text, "| {code:02X} | {name} | {} |", cells(MessageId::Serial(code), name))?;
    }
    Ok(text)
}

fn outcomes() -> Text {
    let mut text = String::from("| result | meaning |\n|---|---|\n");
    for outcome in CommandResult::ALL {
        writeln!(text, "| {} | {} |", outcome as u8, outcome.text())?;
    }
    Ok(text)
}

fn argument_list(arguments: &[ArgumentSpec]) -> String {
    let one = |argument: &ArgumentSpec| {
        let (low, high) = argument.range;
        format!("{} {} ({low} … {high}): {}", argument.wire.name(), argument.name, argument.meaning)
    };
    if arguments.is_empty() { "–".to_string() } else { arguments.iter().map(one).collect::<Vec<_>>().join("; ") }
}

fn commands() -> Text {
    let mut text = String::from("| opcode | name | arguments | reply values | meaning |\n|---|---|---|---|---|\n");
    for command in COMMANDS {
        writeln!(
            text,
            "| {:02X} | {} | {} | {} | {} |",
            command.opcode,
            command.name,
            argument_list(command.arguments),
            argument_list(command.values),
            command.meaning
        )?;
    }
    Ok(text)
}

/// The sample of the test vectors.
const VECTOR: Sample = Sample {
    sequence: 0,
    increments: [-2, -2, 5, 5],
    gyro_flags: 0x0F,
    unit_flags: 0x07,
    electronics_centi_c: 2064,
    clock_count: 500_000,
    sensor_centi_c: 7000,
};

/// Arguments of the test vector of a command.
fn vector_arguments(name: &str) -> &'static [i64] {
    match name {
        "SET_MODE" => &[1],
        "SELF_TEST" => &[3, -100, 20],
        "GYRO_POWER" => &[15],
        "HEATER" => &[1],
        _ => &[],
    }
}

fn vectors() -> Text {
    let h = VECTOR;
    let [x, y, za, zb] = h.increments;
    let mut text = format!(
        "Increments {x}, {y}, {za}, {zb}; sequence {}; gyro flags {:02X}; unit flags {:02X}; electronics {:.2} degC; \
         clock count {}; sensor {:.2} degC:\n\n",
        h.sequence,
        h.gyro_flags,
        h.unit_flags,
        f64::from(h.electronics_centi_c) / 100.0,
        h.clock_count,
        f64::from(h.sensor_centi_c) / 100.0
    );
    let plan = CanIdMap::default();
    let frames: Vec<String> =
        plan.frames(&h).iter().map(|frame| format!("{:03X}#{}", frame.id(), hex(frame.data()))).collect();
    writeln!(text, "    CAN     {}\n    serial  {}\n", frames.join("   "), spaced_hex(&data_frame(&h)))?;
    text.push_str("Commands, and the unit's answers when all is well:\n\n");
    text.push_str("| command | CAN | serial | CAN reply | serial reply |\n|---|---|---|---|---|\n");
    let (major, minor) = crate::LINK_VERSION;
    for command in COMMANDS {
        let arguments = vector_arguments(command.name);
        let sent = payload(command, arguments);
        let values = if command.name == "PING" { vec![major, minor] } else { Vec::new() };
        let reply = Reply::new(command.opcode, CommandResult::Done, &values);
        let words: Vec<String> = arguments.iter().map(i64::to_string).collect();
        writeln!(
            text,
            "| {} | `{:03X}#{}` | `{}` | `{:03X}#{}` | `{}` |",
            [command.name.to_string(), words.join(" ")].join(" ").trim_end(),
            plan.command_id(),
            hex(&sent),
            spaced_hex(&frame(FrameType::Command, &sent)),
            plan.reply_id(),
            hex(reply.bytes()),
            spaced_hex(&frame(FrameType::Reply, reply.bytes()))
        )?;
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::parse;

    #[test]
    fn each_command_of_the_vectors_is_understood() {
        for command in COMMANDS {
            assert!(parse(&payload(command, vector_arguments(command.name))).is_ok(), "{}", command.name);
        }
    }

    #[test]
    fn a_section_is_replaced_and_prose_is_not() {
        let (major, minor) = crate::LINK_VERSION;
        let text = refreshed("# A\n<!-- generated: version -->\nstale\n<!-- end -->\nprose\n");
        assert_eq!(
            text,
            format!("# A\n<!-- generated: version -->\nLink version {major}.{minor}.\n<!-- end -->\nprose\n")
        );
    }
}
