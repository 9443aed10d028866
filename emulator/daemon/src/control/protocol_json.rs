//! The protocol's tables as JSON: commands, replies, and the fields of frames.

use geu_protocol::command::{self, COMMANDS, CommandSpec};
use geu_protocol::field::{CRC, FieldSpec, WireType};
use geu_protocol::message::{Data, MESSAGES, Message, MessageId};
use geu_protocol::{Reply, Sample};
use serde_json::{Map, Value, json};

fn array<T>(items: impl IntoIterator<Item = T>, json: impl FnMut(T) -> Value) -> Value {
    items.into_iter().map(json).collect()
}

/// All commands with their arguments and ranges.
pub fn commands() -> Value {
    array(COMMANDS, |spec| {
        let arguments = array(spec.arguments, |argument| {
            let choices = array(argument.choices(), |(value, name)| json!({ "value": value, "name": name }));
            json!({ "name": argument.name, "least": argument.range.0, "greatest": argument.range.1,
                "choices": choices, "meaning": argument.meaning })
        });
        json!({ "name": spec.name, "opcode": spec.opcode, "arguments": arguments, "meaning": spec.meaning })
    })
}

/// A reply to a command and, after POLL, the polled sample.
pub fn reply(reply: &Reply, polled: Option<&Sample>) -> Value {
    let spec = COMMANDS.iter().find(|spec| spec.opcode == reply.opcode());
    let mut rest = reply.values();
    let mut values = Map::new();
    for value in spec.map_or(&[][..], |spec: &CommandSpec| spec.values) {
        let length = value.wire.length();
        if rest.len() >= length {
            values.insert(value.name.to_owned(), value.wire.read(rest).into());
            rest = &rest[length..];
        }
    }
    json!({ "name": spec.map(|spec| spec.name), "opcode": reply.opcode(), "result": reply.outcome() as u8,
        "outcome": reply.outcome().text(), "values": values, "bytes": command::hex(reply.bytes()),
        "polled": polled.map(sample) })
}

/// The fields of a sample.
pub fn sample(sample: &Sample) -> Value {
    json!({ "sequence": sample.sequence, "increments": sample.increments,
        "gyro_flags": sample.gyro_flags, "unit_flags": sample.unit_flags,
        "electronics_c": f64::from(sample.electronics_centi_c) / 100.0,
        "sensor_c": f64::from(sample.sensor_centi_c) / 100.0, "clock_count": sample.clock_count })
}

/// Fields before the payload of a serial frame.
const HEADER: [FieldSpec; 3] = [
    header("sync", WireType::U16, "start of every frame"),
    header("type", WireType::U8, "type of the payload"),
    header("length", WireType::U8, "bytes of the payload"),
];
/// Fields that are shown as hexadecimal digits.
const DIGITS: [&str; 3] = [HEADER[0].name, HEADER[1].name, CRC.name];

const fn header(name: &'static str, wire: WireType, meaning: &'static str) -> FieldSpec {
    FieldSpec { name, wire, unit: "", scale: 1.0, bits: &[], meaning }
}

/// Fields of the frames of a sample.
pub(super) fn layout() -> Value {
    let can = MESSAGES.iter().filter_map(|message| match message.id {
        MessageId::Can(offset) => Some(json!({ "name": message.name, "offset": offset, "meaning": message.meaning,
            "fields": fields(message.fields) })),
        MessageId::Serial(_) => None,
    });
    let serial = fields(HEADER.iter().chain(Data::SPEC.fields).chain([&CRC]));
    json!({ "serial": serial, "can": can.collect::<Value>() })
}

fn fields<'a>(specs: impl IntoIterator<Item = &'a FieldSpec>) -> Value {
    let mut at = 0;
    array(specs, |spec| {
        let bits = array(spec.bits, |bit| json!({ "bit": bit.bit, "name": bit.name, "meaning": bit.meaning }));
        let form = match spec.bits {
            _ if DIGITS.contains(&spec.name) => "digits",
            [] => "number",
            _ => "flags",
        };
        let length = spec.wire.length();
        at += length;
        json!({ "name": spec.name, "at": at - length, "length": length, "form": form, "signed": spec.wire.signed(),
            "unit": spec.unit, "scale": spec.scale, "bits": bits, "meaning": spec.meaning })
    })
}
