//! The C header (`geu.h`) for on-board software: a template with the parts that come from the tables filled in.

use std::fmt::Write;

use super::{can_messages, filled, serial_messages};
use crate::can::DEFAULT_BASE;
use crate::command::{
    ArgumentSpec, COMMAND_LENGTHS, COMMAND_SERIAL, COMMANDS, CommandResult, CommandSpec, REPLY_LENGTHS, REPLY_SERIAL,
};
use crate::field::{CLOCK_PER_SAMPLE, FIELDS, GYRO_FLAGS, Gyro, UNIT_FLAGS, WireType};
use crate::message::{MESSAGES, MessageId};
use crate::serial::{DATA_LENGTH, DEFAULT_BAUD, MAX_FRAME, SYNC};

pub fn header() -> String {
    filled(include_str!("header.template.h"), "//@", |part| {
        let text = match part {
            "constants" => constants(),
            "flags" => flags(),
            "commands" => opcodes_and_results(),
            "sample" => sample(),
            "messages" => messages(),
            "packers" => {
                COMMANDS.iter().map(command_functions).collect::<Result<Vec<_>, _>>().map(|all| all.join("\n"))
            }
            "reply_values" => COMMANDS.iter().map(reply_values).collect(),
            "serial_lengths" => serial_lengths(),
            _ => return None,
        };
        Some(text.expect("writing to a String does not fail"))
    })
}

type Text = Result<String, std::fmt::Error>;

/// The C type that holds a number of that wire type.
fn c_type(wire: WireType) -> &'static str {
    match wire {
        WireType::U8 => "uint8_t",
        WireType::U16 => "uint16_t",
        WireType::I16 => "int16_t",
        WireType::U48 => "uint64_t",
    }
}

fn constants() -> Text {
    let mut text = String::new();
    let (major, minor) = crate::LINK_VERSION;
    writeln!(text, "#define GEU_LINK_VERSION_MAJOR {major}u\n#define GEU_LINK_VERSION_MINOR {minor}u\n")?;
    writeln!(text, "#define GEU_CLOCK_PER_SAMPLE {CLOCK_PER_SAMPLE}u\n")?;
    writeln!(text, "#define GEU_CAN_BASE_DEFAULT 0x{DEFAULT_BASE:03X}u")?;
    for (offset, name) in can_messages() {
        writeln!(text, "#define GEU_CAN_{name} {offset}u")?;
    }
    text.push('\n');
    for message in MESSAGES {
        writeln!(text, "#define GEU_{}_LENGTH {}u", message.name, message.length())?;
    }
    for (name, lengths) in [("COMMAND", COMMAND_LENGTHS), ("REPLY", REPLY_LENGTHS)] {
        writeln!(text, "#define GEU_{name}_MIN_LENGTH {}u", lengths.start())?;
        writeln!(text, "#define GEU_{name}_MAX_LENGTH {}u", lengths.end())?;
    }
    writeln!(text, "\n#define GEU_SERIAL_SYNC_0 0x{:02X}u\n#define GEU_SERIAL_SYNC_1 0x{:02X}u", SYNC[0], SYNC[1])?;
    for (code, name) in serial_messages() {
        writeln!(text, "#define GEU_SERIAL_{name} 0x{code:02X}u")?;
    }
    writeln!(text, "#define GEU_SERIAL_MAX_PAYLOAD {DATA_LENGTH}u\n#define GEU_SERIAL_MAX_FRAME {MAX_FRAME}u")?;
    writeln!(text, "#define GEU_SERIAL_DEFAULT_BAUD {DEFAULT_BAUD}u")?;
    Ok(text)
}

fn flags() -> Text {
    let mut text = String::from("/* Masks of the gyros in commands. */\n");
    for gyro in Gyro::ALL {
        writeln!(text, "#define GEU_{} 0x{:02X}u", gyro.name(), gyro.bit())?;
    }
    for (field, bits) in [("gyro_flags", GYRO_FLAGS), ("unit_flags", UNIT_FLAGS)] {
        writeln!(text, "\n/* Bits of {field}. */")?;
        for bit in bits {
            writeln!(text, "#define GEU_{} 0x{:02X}u /* {} */", bit.name.to_uppercase(), 1 << bit.bit, bit.meaning)?;
        }
    }
    Ok(text)
}

fn opcodes_and_results() -> Text {
    let mut text = String::from("typedef enum {\n");
    for command in COMMANDS {
        writeln!(text, "    GEU_OPCODE_{} = 0x{:02X}, /* {} */", command.name, command.opcode, command.meaning)?;
    }
    text.push_str("    GEU_OPCODE_MAX = 0xFF\n} geu_opcode;\n\ntypedef enum {\n");
    for outcome in CommandResult::ALL {
        writeln!(text, "    {} = {},", result_name(outcome), outcome as u8)?;
    }
    text.push_str("    GEU_RESULT_MAX = 0xFF\n} geu_result;\n");
    Ok(text)
}

fn result_name(outcome: CommandResult) -> String {
    format!("GEU_RESULT_{}", outcome.text().replace(' ', "_").to_uppercase())
}

fn sample() -> Text {
    let mut text = String::from("/* One sample of the unit. */\ntypedef struct {\n");
    for field in FIELDS {
        let unit = match (field.scale, field.unit) {
            (1.0, "") => String::new(),
            (1.0, unit) => format!(", {unit}"),
            (scale, unit) => format!(", {scale} {unit}"),
        };
        writeln!(text, "    {} {}; /* {}{unit} */", c_type(field.wire), field_name(field.name), field.meaning)?;
    }
    text.push_str("} geu_sample;\n");
    Ok(text)
}

/// The raw number is in hundredths of a degree, so it must not be called `…_c`.
fn field_name(name: &str) -> String {
    name.strip_suffix("_c").map_or_else(|| name.to_string(), |stem| format!("{stem}_centi_c"))
}

fn messages() -> Text {
    let mut parts = Vec::new();
    for message in MESSAGES {
        let (name, own) =
            (message.name.to_lowercase(), |at| if at == 0 { "data".into() } else { format!("data + {at}") });
        let what = match message.id {
            MessageId::Can(_) => "data",
            MessageId::Serial(_) => "payload",
        };
        let (mut pack, mut unpack) = (String::new(), String::new());
        for (at, field) in message.placed_fields().filter(|(_, field)| field.name != "crc") {
            let (field_name, wire, at) = (field_name(field.name), field.wire.name(), own(at));
            writeln!(pack, "    geu_put_{wire}({at}, sample->{field_name});")?;
            writeln!(unpack, "    sample->{field_name} = geu_get_{wire}({at});")?;
        }
        let crc = if message.fields.iter().any(|field| field.name == "crc") { ", its CRC left out" } else { "" };
        parts.push(format!(
            "/* The {} bytes of {what} of {}{crc}: {}. */\n\
             static inline void geu_pack_{name}(const geu_sample *sample, uint8_t *data)\n{{\n{pack}}}\n\n\
             static inline void geu_unpack_{name}(geu_sample *sample, const uint8_t *data)\n{{\n{unpack}}}\n",
            message.length(),
            message.name,
            message.meaning
        ));
    }
    Ok(parts.join("\n"))
}

/// Range check of an argument in C; `None` if its type implies it.
fn range_test(argument: &ArgumentSpec) -> Option<String> {
    let (low, high) = argument.range;
    let (type_low, type_high) = argument.wire.limits();
    let mut tests = Vec::new();
    if low > type_low {
        tests.push(format!("*{} < {low}", argument.name));
    }
    if high < type_high {
        tests.push(format!("*{} > {high}", argument.name));
    }
    (!tests.is_empty()).then(|| tests.join(" || "))
}

fn command_functions(command: &CommandSpec) -> Text {
    let name = command.name.to_lowercase();
    let length = 1 + command.arguments.iter().map(|argument| argument.wire.length()).sum::<usize>();
    let (mut inputs, mut outputs, mut pack, mut unpack) = (String::new(), String::new(), String::new(), String::new());
    let mut at = 1;
    for argument in command.arguments {
        let (wire, argument_name) = (argument.wire.name(), argument.name);
        write!(inputs, ", {} {argument_name}", c_type(argument.wire))?;
        write!(outputs, ", {} *{argument_name}", c_type(argument.wire))?;
        writeln!(pack, "    geu_put_{wire}(data + {at}, {argument_name});")?;
        writeln!(unpack, "    *{argument_name} = geu_get_{wire}(data + {at});")?;
        at += argument.wire.length();
    }
    let tests: Vec<String> = command.arguments.iter().filter_map(range_test).collect();
    if !tests.is_empty() {
        writeln!(
            unpack,
            "    if ({})\n        return {};",
            tests.join(" || "),
            result_name(CommandResult::BadArgument)
        )?;
    }
    let mut text = format!("/* {}: {}.", command.name, command.meaning);
    for argument in command.arguments {
        let (low, high) = argument.range;
        write!(text, "\n * {}: {}, {low} to {high}.", argument.name, argument.meaning)?;
    }
    write!(
        text,
        " */\n\
         static inline size_t geu_pack_{name}(uint8_t *data{inputs})\n{{\n    \
         geu_put_u8(data, GEU_OPCODE_{});\n{pack}    return {length};\n}}\n\n\
         /* The arguments in the data of such a COMMAND; the result a unit replies with. */\n\
         static inline geu_result geu_unpack_{name}(const uint8_t *data, size_t length{outputs})\n{{\n    \
         if (length < 1 || data[0] != GEU_OPCODE_{})\n        return {};\n    \
         if (length != {length})\n        return {};\n{unpack}    return {};\n}}\n",
        command.name,
        command.name,
        result_name(CommandResult::UnknownOpcode),
        result_name(CommandResult::BadArgument),
        result_name(CommandResult::Done)
    )?;
    Ok(text)
}

fn reply_values(command: &CommandSpec) -> Text {
    if command.values.is_empty() {
        return Ok(String::new());
    }
    let (mut outputs, mut unpack, mut at) = (String::new(), String::new(), 0);
    for value in command.values {
        write!(outputs, ", {} *{}", c_type(value.wire), value.name)?;
        writeln!(unpack, "    *{} = geu_get_{}(reply->values + {at});", value.name, value.wire.name())?;
        at += value.wire.length();
    }
    Ok(format!(
        "/* The values of a REPLY to {0}. 1: read. 0: another command, not done, or another length. */\n\
         static inline int geu_unpack_{1}_values(const geu_reply *reply{outputs})\n{{\n    \
         if (reply->opcode != GEU_OPCODE_{0} || reply->result != {2} || reply->value_length != {at})\n        \
         return 0;\n{unpack}    return 1;\n}}\n",
        command.name,
        command.name.to_lowercase(),
        result_name(CommandResult::Done)
    ))
}

fn serial_lengths() -> Text {
    let mut text = String::new();
    for (code, name) in serial_messages() {
        let test = match (MessageId::Serial(code) == COMMAND_SERIAL, MessageId::Serial(code) == REPLY_SERIAL) {
            (true, _) | (_, true) => format!("length >= GEU_{name}_MIN_LENGTH && length <= GEU_{name}_MAX_LENGTH"),
            _ => format!("length == GEU_{name}_LENGTH"),
        };
        writeln!(text, "    case GEU_SERIAL_{name}:\n        return {test};")?;
    }
    Ok(text)
}
