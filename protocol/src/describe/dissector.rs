//! The Wireshark dissector (`geu.lua`): a template with the tables filled in.

use std::fmt::Write;

use super::{can_messages, filled, serial_messages};
use crate::can::DEFAULT_BASE;
use crate::command::{ArgumentSpec, COMMAND_LENGTHS, COMMANDS, CommandResult, CommandSpec, REPLY_LENGTHS};
use crate::field::{CRC, FIELDS, FieldSpec, WireType};
use crate::message::MESSAGES;
use crate::serial::{DATA_LENGTH, SYNC};

/// The Wireshark dissector, for version 3 and later.
pub fn dissector() -> String {
    filled(include_str!("dissector.template.lua"), "--@", |part| {
        (part == "tables").then(|| tables().expect("writing to a String does not fail"))
    })
}

type Text = Result<String, std::fmt::Error>;

/// The constructor of a field that shows the number as it is.
fn constructor(wire: WireType) -> &'static str {
    match wire {
        WireType::U8 => "uint8",
        WireType::U16 => "uint16",
        WireType::I16 => "int16",
        WireType::U48 => "uint64",
    }
}

fn tables() -> Text {
    let mut text = format!("local sync = {{ 0x{:02X}, 0x{:02X} }}\n", SYNC[0], SYNC[1]);
    writeln!(text, "local can_base_default = \"{DEFAULT_BASE:X}\"\n")?;
    names(&mut text, "can_names", can_messages())?;
    names(&mut text, "type_names", serial_messages())?;
    names(&mut text, "opcode_names", COMMANDS.iter().map(|command| (command.opcode, command.name)))?;
    names(&mut text, "result_names", CommandResult::ALL.iter().map(|&outcome| (outcome as u8, outcome.text())))?;
    text.push_str("-- Shortest and longest payload of each type of serial frame.\nlocal lengths = {");
    for (code, name) in serial_messages() {
        let (low, high) = match name {
            "COMMAND" => COMMAND_LENGTHS.into_inner(),
            "REPLY" => REPLY_LENGTHS.into_inner(),
            _ => (DATA_LENGTH, DATA_LENGTH),
        };
        write!(text, " [{code}] = {{ {low}, {high} }},")?;
    }
    text.push_str(" }\n\nlocal fields = {\n");
    for field in FIELDS.iter().chain([&CRC]) {
        proto_field(&mut text, field)?;
    }
    for command in COMMANDS {
        for argument in command.arguments.iter().chain(command.values) {
            argument_field(&mut text, command, argument)?;
        }
    }
    text.push_str("}\n\n-- The fields of each message, in the order of the wire.\nlocal messages = {\n");
    for message in MESSAGES {
        writeln!(text, "    {} = {{", message.name)?;
        for field in message.fields.iter().filter(|field| field.name != CRC.name) {
            write!(text, "        {{ name = \"{}\", size = {}", field.name, field.wire.length())?;
            if field.scale != 1.0 {
                write!(text, ", scale = {}", field.scale)?;
            }
            if !field.bits.is_empty() {
                let bits: Vec<String> = field.bits.iter().map(|bit| format!("\"{}\"", bit.name)).collect();
                write!(text, ", bits = {{ {} }}", bits.join(", "))?;
            }
            text.push_str(" },\n");
        }
        text.push_str("    },\n");
    }
    text.push_str("}\n\n");
    layouts(&mut text, "arguments", |command| command.arguments)?;
    layouts(&mut text, "values", |command| command.values)?;
    Ok(text)
}

fn names<N: Into<u16>>(
    text: &mut String,
    table: &str,
    names: impl IntoIterator<Item = (N, &'static str)>,
) -> std::fmt::Result {
    write!(text, "local {table} = {{")?;
    for (number, name) in names {
        write!(text, " [{}] = \"{name}\",", number.into())?;
    }
    text.push_str(" }\n");
    Ok(())
}

fn proto_field(text: &mut String, field: &FieldSpec) -> std::fmt::Result {
    let (name, meaning) = (field.name, field.meaning);
    if field.scale != 1.0 {
        return writeln!(text, "    {name} = ProtoField.double(\"geu.{name}\", \"{name}\", \"{meaning}\"),");
    }
    let base = if field.bits.is_empty() && name != CRC.name { "DEC" } else { "HEX" };
    let constructor = constructor(field.wire);
    writeln!(
        text,
        "    {name} = ProtoField.{constructor}(\"geu.{name}\", \"{name}\", base.{base}, nil, nil, \"{meaning}\"),"
    )?;
    for bit in field.bits {
        let (name, mask) = (bit.name, 1 << bit.bit);
        writeln!(
            text,
            "    {name} = ProtoField.bool(\"geu.{name}\", \"{name}\", 8, nil, 0x{mask:02X}, \"{}\"),",
            bit.meaning
        )?;
    }
    Ok(())
}

fn argument_name(command: &CommandSpec, argument: &ArgumentSpec) -> String {
    format!("{}_{}", command.name.to_lowercase(), argument.name)
}

fn argument_field(text: &mut String, command: &CommandSpec, argument: &ArgumentSpec) -> std::fmt::Result {
    let (name, constructor) = (argument_name(command, argument), constructor(argument.wire));
    let choices: Vec<String> =
        argument.choices().iter().map(|(value, choice)| format!("[{value}] = \"{choice}\"")).collect();
    let choices = if choices.is_empty() { "nil".to_string() } else { format!("{{ {} }}", choices.join(", ")) };
    writeln!(
        text,
        "    {name} = ProtoField.{constructor}(\"geu.{name}\", \"{name}\", base.DEC, {choices}, nil, \"{}\"),",
        argument.meaning
    )
}

fn layouts(text: &mut String, table: &str, of: impl Fn(&CommandSpec) -> &'static [ArgumentSpec]) -> std::fmt::Result {
    writeln!(text, "-- The {table} of each opcode, in the order of the wire.\nlocal {table} = {{")?;
    for command in COMMANDS.iter().filter(|command| !of(command).is_empty()) {
        write!(text, "    [{}] = {{", command.opcode)?;
        for argument in of(command) {
            write!(text, " {{ name = \"{}\", size = {} }},", argument_name(command, argument), argument.wire.length())?;
        }
        text.push_str(" },\n");
    }
    text.push_str("}\n");
    Ok(())
}
