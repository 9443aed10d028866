//! The protocol's tables as JSON: commands, replies, and what stands where in a frame.

use geu_protocol::command::{self, COMMANDS, CommandSpec};
use geu_protocol::field::{CRC, FieldSpec, WireType};
use geu_protocol::message::{Data, MESSAGES, Message, MessageId};
use geu_protocol::{Reply, Sample};
use serde_json::{Map, Value, json};

/// Every command, with its arguments and their ranges.
pub fn commands() -> Value {
    COMMANDS
        .iter()
        .map(|spec| {
            let arguments: Vec<Value> = spec
                .arguments
                .iter()
                .map(|argument| {
                    let (least, greatest) = argument.range;
                    let choices: Vec<Value> = argument
                        .choices()
                        .into_iter()
                        .map(|(value, name)| json!({ "value": value, "name": name }))
                        .collect();
                    json!({ "name": argument.name, "least": least, "greatest": greatest,
                        "choices": choices, "meaning": argument.meaning })
                })
                .collect();
            json!({ "name": spec.name, "opcode": spec.opcode, "arguments": arguments, "meaning": spec.meaning })
        })
        .collect()
}

/// A reply to a command, and the sample that it polled.
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
        "polled": polled.map(told) })
}

/// What the unit tells in a sample interval.
pub fn told(sample: &Sample) -> Value {
    json!({ "sequence": sample.sequence, "increments": sample.increments,
        "gyro_flags": sample.gyro_flags, "unit_flags": sample.unit_flags,
        "electronics_c": f64::from(sample.electronics_centi_c) / 100.0,
        "sensor_c": f64::from(sample.sensor_centi_c) / 100.0, "clock_count": sample.clock_count })
}

/// What stands before the payload of a serial frame.
const HEADER: [FieldSpec; 3] = [
    header("sync", WireType::U16, "start of every frame"),
    header("type", WireType::U8, "what the payload is"),
    header("length", WireType::U8, "bytes of the payload"),
];
/// Fields whose digits say more than their number.
const DIGITS: [&str; 3] = [HEADER[0].name, HEADER[1].name, CRC.name];

const fn header(name: &'static str, wire: WireType, meaning: &'static str) -> FieldSpec {
    FieldSpec { name, wire, unit: "", scale: 1.0, bits: &[], meaning }
}

/// What stands where in the frames of a sample.
pub(super) fn layout() -> Value {
    let can = MESSAGES.iter().filter_map(|message| match message.place {
        MessageId::Can(offset) => Some(json!({ "name": message.name, "offset": offset, "meaning": message.meaning,
            "fields": fields(message.fields.iter()) })),
        MessageId::Serial(_) => None,
    });
    let serial = fields(HEADER.iter().chain(Data::SPEC.fields).chain([&CRC]));
    json!({ "serial": serial, "can": can.collect::<Vec<_>>() })
}

fn fields<'a>(specs: impl Iterator<Item = &'a FieldSpec>) -> Vec<Value> {
    let mut at = 0;
    specs
        .map(|spec| {
            let bits: Vec<Value> = spec
                .bits
                .iter()
                .map(|bit| json!({ "bit": bit.bit, "name": bit.name, "meaning": bit.meaning }))
                .collect();
            let form = match bits.is_empty() {
                _ if DIGITS.contains(&spec.name) => "digits",
                true => "number",
                false => "flags",
            };
            let length = spec.wire.length();
            at += length;
            json!({ "name": spec.name, "at": at - length, "length": length, "form": form, "signed": spec.wire.signed(),
                "unit": spec.unit, "scale": spec.scale, "bits": bits, "meaning": spec.meaning })
        })
        .collect()
}
