//! The protocol's tables as JSON: commands, replies, and the fields of frames.

use geu_model::device::Device;
use geu_protocol::command::{self, COMMANDS, CommandSpec};
use geu_protocol::field::{CRC, FieldSpec, WireType};
use geu_protocol::layout::{Coding, Field, Frame};
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
pub fn layout() -> Value {
    let can = MESSAGES.iter().filter_map(|message| match message.id {
        MessageId::Can(offset) => Some(json!({ "name": message.name, "offset": offset, "meaning": message.meaning,
            "fields": fields(message.fields) })),
        MessageId::Serial(_) => None,
    });
    let serial = fields(HEADER.iter().chain(Data::SPEC.fields).chain([&CRC]));
    json!({ "serial": serial, "can": can.collect::<Value>() })
}

/// Fields of the frames of a described unit: whole numbers of whole bytes with their values, any others as digits.
pub fn layout_of(device: &Device) -> Value {
    let of_link = |is_can: bool| device.frames(is_can).map_or(&[][..], |set| &set.frames);
    let mut start = 0;
    let serial = of_link(false).iter().filter(|frame| frame.instead_of.is_none()).flat_map(|frame| {
        let fields = described(device, frame, start);
        start += frame.length();
        fields
    });
    let serial: Value = serial.collect();
    let can = array(
        of_link(true),
        |frame| json!({ "name": frame.name, "meaning": "", "fields": described(device, frame, 0) }),
    );
    json!({ "serial": serial, "can": can })
}

fn described(device: &Device, frame: &Frame, start: usize) -> Vec<Value> {
    let (mut fields, mut at) = (Vec::new(), 0);
    while at < frame.length() {
        let begins = |field: &&Field| field.place.at == at;
        let is_number =
            |field: &&Field| field.place.bits as usize == 8 * field.place.length && field.place.coding != Coding::Float;
        let number = frame.fields.iter().find(|field| begins(field) && is_number(field));
        let (length, field) = match number {
            Some(field) => (field.place.length, Some(field)),
            None => {
                let is_next = |at: &usize| !frame.fields.iter().any(|field| field.place.at == *at && is_number(&field));
                ((at + 1..frame.length()).take_while(is_next).count() + 1, None)
            }
        };
        let (scale, _, offset) = field.map_or((1.0, 1.0, 0.0), Field::scaling);
        fields.push(json!({
            "name": field.map_or("", |field| &device.values()[field.slot].name), "at": start + at, "length": length,
            "form": if field.is_some() { "number" } else { "digits" }, "unit": "", "bits": [], "meaning": frame.name,
            "signed": field.is_some_and(|field| field.place.coding == Coding::Signed),
            "scale": field.map_or(scale, Field::scale), "offset": offset,
            "little_endian": field.is_some_and(|field| field.place.is_little_endian()),
        }));
        at += length;
    }
    fields
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
