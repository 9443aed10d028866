//! The protocol's tables as JSON: commands, replies, and what stands where in a frame.

use geu_protocol::command::{COMMANDS, CommandSpec};
use geu_protocol::field::{CRC, FieldSpec, Wire};
use geu_protocol::message::{Data, MESSAGES, Message, MessageSpec, Place};
use geu_protocol::serial::{OVERHEAD, SYNC};
use geu_protocol::{HalfSecond, Reply};
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

/// A reply to a command, and the half second that it polled.
pub fn reply(reply: &Reply, polled: Option<&HalfSecond>) -> Value {
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
    let polled = polled.map(|half_second| {
        json!({ "sequence": half_second.sequence, "increments": half_second.increments,
            "gyro_flags": half_second.gyro_flags, "unit_flags": half_second.unit_flags,
            "electronics_c": f64::from(half_second.electronics_centi_c) / 100.0,
            "sensor_c": f64::from(half_second.sensor_centi_c) / 100.0, "clock_count": half_second.clock_count })
    });
    json!({ "name": spec.map(|spec| spec.name), "opcode": reply.opcode(), "result": reply.outcome() as u8,
        "outcome": reply.outcome().text(), "values": values, "bytes": hex(reply.bytes()), "polled": polled })
}

/// What stands where in the frames of a half second.
pub(super) fn layout() -> Value {
    let can = MESSAGES.iter().filter_map(|message| match message.place {
        Place::Can(offset) => Some(json!({ "name": message.name, "offset": offset, "meaning": message.meaning,
            "fields": fields(message, 0) })),
        Place::Serial(_) => None,
    });
    let header = |name, at, length, meaning: String| {
        json!({ "name": name, "at": at, "length": length, "signed": false, "unit": "", "scale": 1.0, "bits": [],
            "meaning": meaning })
    };
    let payload_at = OVERHEAD - CRC.wire.length();
    let mut serial = vec![
        header("sync", 0, SYNC.len(), format!("{}, the start of every frame", hex(&SYNC))),
        header("type", SYNC.len(), Wire::U8.length(), format!("what the payload is: {}", Data::SPEC.name)),
        header("length", SYNC.len() + 1, Wire::U8.length(), "bytes of the payload".to_owned()),
    ];
    serial.extend(fields(&Data::SPEC, payload_at));
    serial.push(field(payload_at + Data::SPEC.length(), &CRC));
    json!({ "serial": serial, "can": can.collect::<Vec<_>>() })
}

fn fields(message: &MessageSpec, start: usize) -> Vec<Value> {
    message.placed_fields().map(|(at, spec)| field(start + at, spec)).collect()
}

fn field(at: usize, spec: &FieldSpec) -> Value {
    let bits: Vec<Value> =
        spec.bits.iter().map(|bit| json!({ "bit": bit.bit, "name": bit.name, "meaning": bit.meaning })).collect();
    json!({ "name": spec.name, "at": at, "length": spec.wire.length(), "signed": spec.wire.signed(),
        "unit": spec.unit, "scale": spec.scale, "bits": bits, "meaning": spec.meaning })
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X}")).collect()
}
