//! The tables of the link as values of a template.

use crate::can::{CanIdMap, DEFAULT_BASE};
use crate::command::{
    ArgumentSpec, COMMAND_CAN, COMMAND_LENGTHS, COMMAND_SERIAL, COMMANDS, CommandResult, CommandSpec, REPLY_CAN,
    REPLY_LENGTHS, REPLY_SERIAL, Reply, payload,
};
use crate::field::{Bit, CLOCK_PER_SAMPLE, CRC, FIELDS, FieldSpec, GYRO_FLAGS, Gyro, Sample, UNIT_FLAGS, WireType};
use crate::hex::{hex, spaced_hex};
use crate::map;
use crate::message::{MESSAGES, MessageId, MessageSpec};
use crate::serial::{BITS_PER_BYTE, DATA_LENGTH, DEFAULT_BAUD, FrameType, MAX_FRAME, SYNC, data_frame, frame};
use crate::template::Value;

/// All tables.
pub(super) fn tables() -> Value {
    let command = (COMMAND_CAN, COMMAND_SERIAL, COMMAND_LENGTHS, "opcode, arguments", "to the unit");
    let reply =
        (REPLY_CAN, REPLY_SERIAL, REPLY_LENGTHS, "opcode, result, values", "from the unit, to the link that asked");
    let exchanged = [("COMMAND", command), ("REPLY", reply)].map(|(name, (can, serial, lengths, content, meaning))| {
        map! { name: name, can: id(can), serial: id(serial), min: *lengths.start() as u32, max: *lengths.end() as u32,
        content: content, meaning: meaning }
    });
    map! {
        major: crate::LINK_VERSION.0,
        minor: crate::LINK_VERSION.1,
        clock_per_sample: CLOCK_PER_SAMPLE as u32,
        base: format!("{DEFAULT_BASE:X}"),
        sync: SYNC,
        max_payload: DATA_LENGTH as u32,
        max_frame: MAX_FRAME as u32,
        baud: DEFAULT_BAUD,
        bits_per_byte: BITS_PER_BYTE,
        gyros: Gyro::ALL.map(|gyro| map! { name: gyro.name(), mask: gyro.bit() }),
        flags: [("gyro_flags", GYRO_FLAGS), ("unit_flags", UNIT_FLAGS)].map(|(name, of)| map! { name: name, bits: bits(of) }),
        fields: FIELDS.iter().chain([&CRC]).map(|spec| field(0, spec)).collect::<Value>(),
        messages: MESSAGES.iter().map(message).collect::<Value>(),
        exchanged: exchanged,
        results: CommandResult::ALL.map(|result| map! { code: result as u8, text: result.text() }),
        commands: COMMANDS.iter().map(command_of).collect::<Value>(),
        vector: vector(),
    }
}

fn id(id: MessageId) -> u16 {
    match id {
        MessageId::Can(offset) => offset,
        MessageId::Serial(code) => code.into(),
    }
}

fn bits(bits: &[Bit]) -> Value {
    bits.iter().map(|bit| map! { bit: bit.bit, mask: 1u8 << bit.bit, name: bit.name, meaning: bit.meaning }).collect()
}

/// The type of the width in which a program holds the number.
fn native(wire: WireType) -> &'static str {
    match wire {
        WireType::U8 => "uint8",
        WireType::U16 => "uint16",
        WireType::I16 => "int16",
        WireType::U48 => "uint64",
    }
}

fn field(at: usize, spec: &FieldSpec) -> Value {
    let FieldSpec { name, wire, unit, scale, meaning, .. } = *spec;
    let is_scaled = scale != 1.0;
    let in_c = name.strip_suffix("_c").map_or_else(|| name.to_string(), |stem| format!("{stem}_centi_c"));
    map! { name: name, in_c: in_c, wire: wire.name(), native: native(wire), size: wire.length() as u32, at: at as u32,
    unit: if is_scaled { format!("{scale} {unit}") } else { unit.to_string() }, scale: scale, is_scaled: is_scaled,
    bits: bits(spec.bits), is_crc: name == CRC.name, meaning: meaning }
}

fn message(spec: &MessageSpec) -> Value {
    let fields: Vec<Value> = spec.placed_fields().map(|(at, spec)| field(at, spec)).collect();
    map! { name: spec.name, is_can: matches!(spec.id, MessageId::Can(_)), id: id(spec.id), fields: fields,
    length: spec.length() as u32, meaning: spec.meaning, has_crc: spec.fields.contains(&CRC) }
}

/// The arguments or reply values of one command, from byte `end` on.
fn arguments(command: &CommandSpec, arguments: &[ArgumentSpec], mut end: usize) -> Value {
    let one = |argument: &ArgumentSpec| {
        let ArgumentSpec { name, wire, range: (low, high), meaning } = *argument;
        let at = end;
        end += wire.length();
        let choices = argument.choices().into_iter().map(|(value, name)| map! { value: value, name: name });
        map! { name: name, full_name: format!("{}_{name}", command.name.to_lowercase()), wire: wire.name(), at: at as u32,
        native: native(wire), size: wire.length() as u32, low: low, high: high, meaning: meaning,
        choices: choices.collect::<Value>() }
    };
    arguments.iter().map(one).collect()
}

fn length(arguments: &[ArgumentSpec]) -> u32 {
    arguments.iter().map(|argument| argument.wire.length() as u32).sum()
}

/// Conditions in C for values of the type outside the range of an argument.
fn range_tests(argument: &ArgumentSpec) -> Vec<String> {
    let ((low, high), (type_low, type_high)) = (argument.range, argument.wire.limits());
    let below = (low > type_low).then(|| format!("*{} < {low}", argument.name));
    below.into_iter().chain((high < type_high).then(|| format!("*{} > {high}", argument.name))).collect()
}

fn command_of(spec: &CommandSpec) -> Value {
    let CommandSpec { opcode, name, meaning, .. } = *spec;
    let example: &[i64] = match name {
        "SET_MODE" => &[1],
        "SELF_TEST" => &[3, -100, 20],
        "GYRO_POWER" => &[15],
        "HEATER" => &[1],
        _ => &[],
    };
    let sent = payload(spec, example);
    let values = if name == "PING" { vec![crate::LINK_VERSION.0, crate::LINK_VERSION.1] } else { Vec::new() };
    let reply = Reply::new(opcode, CommandResult::Done, &values);
    let plan = CanIdMap::default();
    map! { opcode: opcode, name: name, meaning: meaning,
    arguments: arguments(spec, spec.arguments, 1), length: length(spec.arguments) + 1,
    values: arguments(spec, spec.values, 0), value_length: length(spec.values),
    tests: spec.arguments.iter().flat_map(range_tests).collect::<Vec<_>>().join(" || "),
    example: example.to_vec(),
    can: format!("{:03X}#{}", plan.command_id(), hex(&sent)),
    serial: spaced_hex(&frame(FrameType::Command, &sent)),
    can_reply: format!("{:03X}#{}", plan.reply_id(), hex(reply.bytes())),
    serial_reply: spaced_hex(&frame(FrameType::Reply, reply.bytes())) }
}

/// A sample of the test vectors, and its bytes.
fn vector() -> Value {
    let sample = Sample {
        sequence: 0,
        increments: [-2, -2, 5, 5],
        gyro_flags: 0x0F,
        unit_flags: 0x07,
        electronics_centi_c: 2064,
        clock_count: 500_000,
        sensor_centi_c: 7000,
    };
    let frames = CanIdMap::default().frames(&sample).map(|frame| format!("{:03X}#{}", frame.id(), hex(frame.data())));
    map! { increments: sample.increments, sequence: sample.sequence, gyro_flags: sample.gyro_flags,
    unit_flags: sample.unit_flags, clock_count: sample.clock_count as u32,
    electronics_c: format!("{:.2}", f64::from(sample.electronics_centi_c) / 100.0),
    sensor_c: format!("{:.2}", f64::from(sample.sensor_centi_c) / 100.0),
    can: frames.join("   "), serial: spaced_hex(&data_frame(&sample)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::parse;
    use crate::hex::read_hex;

    #[test]
    fn each_command_of_the_vectors_is_understood() {
        for spec in COMMANDS {
            let Value::Map(command) = command_of(spec) else { panic!("a map") };
            let Value::String(can) = &command["can"] else { panic!("a text") };
            let sent = read_hex(can.split_once('#').unwrap().1).unwrap();
            assert!(parse(&sent).is_ok(), "{}", spec.name);
        }
    }
}
