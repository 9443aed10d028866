//! Frames and commands as packets of named items, for ground systems.

use std::collections::BTreeSet;

use super::device::{Wire, plain};
use crate::can::CanIdMap;
use crate::command::{ArgumentSpec, COMMAND_CAN, COMMAND_SERIAL, COMMANDS, CommandResult, REPLY_CAN, REPLY_SERIAL};
use crate::field::{CRC, FieldSpec, WireType};
use crate::layout::{BitField, Check, Coding, Field, Frame, Number, Quantity};
use crate::message::{MESSAGES, MessageId};
use crate::serial::{self, DEFAULT_BAUD, HEADER, SYNC, TYPE_AT};

/// The links of a unit as packets. [`Ground::xtce`] and [`Ground::cosmos`] describe them.
#[derive(Debug)]
pub struct Ground {
    /// Name in identifiers, of letters, digits and underscores.
    pub(super) name: String,
    pub(super) title: String,
    pub(super) source: String,
    pub(super) links: Vec<PacketLink>,
}

/// Packets of one link.
#[derive(Debug)]
pub(super) struct PacketLink {
    pub name: &'static str,
    /// Rate of a serial line.
    pub baud: u32,
    pub telemetry: Vec<Packet>,
    pub commands: Vec<Packet>,
}

/// A frame with its header, and what its fields mean.
#[derive(Debug)]
pub(super) struct Packet {
    pub frame: Frame,
    /// A parameter for each field of the frame.
    parameters: Vec<Parameter>,
    pub meaning: String,
}

/// Meaning of a field.
#[derive(Debug, Clone, Default)]
pub(super) struct Parameter {
    pub name: String,
    pub unit: &'static str,
    pub meaning: String,
    /// Smallest and largest value, where the number has other ones.
    pub range: Option<(f64, f64)>,
    pub choices: Vec<(i64, &'static str)>,
}

/// Content of some bits of a packet.
#[derive(Debug)]
pub(super) enum Content<'a> {
    Constant(u64),
    Ignored(u64),
    Field(&'a Field, &'a Parameter),
    Check(&'a Check),
}

#[derive(Debug)]
pub(super) struct Item<'a> {
    pub name: String,
    pub place: BitField,
    pub content: Content<'a>,
}

impl Item<'_> {
    /// The meaning, in words.
    pub fn meaning(&self) -> String {
        match &self.content {
            Content::Constant(_) => "constant".to_owned(),
            Content::Ignored(_) => "of no meaning here".to_owned(),
            Content::Field(_, own) => own.meaning.clone(),
            Content::Check(check) => check.in_words(check.place.at),
        }
    }
}

/// Bytes of the header of a CAN frame in a capture of link type 227 (CAN_SOCKETCAN).
const CAN_HEADER: usize = 8;
/// Bit of its identifier that is set if the identifier has 29 bits.
const EXTENDED: u32 = 1 << 31;
/// Longest constant in one item, byte.
const MAX_CONSTANT: usize = 4;

impl PacketLink {
    pub fn is_can(&self) -> bool {
        self.name == "can"
    }

    /// Constant bytes with which every packet begins; of CAN, which has other limits of frames, none.
    pub fn sync(&self) -> &[u8] {
        let mut starts = self.telemetry.iter().chain(&self.commands).map(|packet| packet.frame.start());
        let first = starts.next().filter(|_| !self.is_can()).unwrap_or_default();
        let same = |one: &[u8], other: &[u8]| one.iter().zip(other).take_while(|(a, b)| a == b).count();
        let length = starts.fold(first.len(), |length, start| length.min(same(first, start)));
        &first[..length]
    }

    /// The items of a packet of this link, in the order of their first bits. Constants end where the constants of other packets begin or end.
    pub fn items<'a>(&self, packet: &'a Packet) -> Vec<Item<'a>> {
        let packets = self.telemetry.iter().chain(&self.commands);
        let ends = packets.flat_map(|packet| {
            let is_required = |bit: &usize| packet.frame.required()[bit / 8] & 0x80 >> (bit % 8) != 0;
            (1..8 * packet.frame.length()).filter(move |bit| is_required(bit) != is_required(&(bit - 1)))
        });
        packet.items(self.sync().len(), &ends.collect())
    }
}

impl Packet {
    /// The items; the first `sync` bytes are an item, and no constant crosses an end in `ends`, bit.
    fn items(&self, sync: usize, ends: &BTreeSet<usize>) -> Vec<Item<'_>> {
        let Packet { frame, parameters, .. } = self;
        let fields = frame.fields.iter().zip(parameters).map(|(field, parameter)| Item {
            name: parameter.name.clone(),
            place: field.place,
            content: Content::Field(field, parameter),
        });
        let checks = frame.checks.iter().map(|check| Item {
            name: if check.parameters().is_some() { "crc" } else { "check" }.to_owned(),
            place: check.place,
            content: Content::Check(check),
        });
        let mut items: Vec<Item> = fields.chain(checks).chain(self.other_items(sync, ends)).collect();
        items.sort_by_key(|item| item.place.first_bit().unwrap_or(8 * item.place.at));
        items
    }

    /// Runs of bits without a field or a check.
    fn other_items(&self, sync: usize, ends: &BTreeSet<usize>) -> Vec<Item<'_>> {
        let frame = &self.frame;
        let mut used = vec![0; frame.length()];
        let places = frame.fields.iter().map(|field| field.place).chain(frame.checks.iter().map(|check| check.place));
        places.for_each(|place| used.iter_mut().zip(place.used(frame.length())).for_each(|(used, own)| *used |= own));
        // Free, and constant.
        let kind = |bit: usize| {
            let (byte, mask) = (bit / 8, 0x80 >> (bit % 8));
            (used[byte] & mask == 0, frame.required()[byte] & mask != 0)
        };
        let is_end = |bit: usize| kind(bit).1 && (bit == 8 * sync || ends.contains(&bit));
        let bits: Vec<usize> = (0..8 * frame.length()).collect();
        let runs = bits.chunk_by(|one, next| kind(*one) == kind(*next) && !is_end(*next));
        let runs = runs.filter(|run| kind(run[0]).0);
        let parts = runs.flat_map(|run| {
            let part = move |bit: &usize| (bit - run[0] / 8 * 8) / (8 * MAX_CONSTANT);
            run.chunk_by(move |one, next| part(one) == part(next))
        });
        let item = |part: &[usize]| {
            let (start, end) = (part[0], part[0] + part.len());
            let at = start / 8;
            let length = end.div_ceil(8) - at;
            let number = Number { coding: Coding::Unsigned, length, is_little_endian: false };
            let place = BitField::bytes(at, number).bits_of((8 * (at + length) - end) as u32, part.len() as u32);
            let bits = place.read_bits(frame.template());
            let (name, content) = match kind(start) {
                (_, true) if end <= 8 * sync && start == 0 => ("sync".to_owned(), Content::Constant(bits)),
                (_, true) => (format!("constant_at_bit_{start}"), Content::Constant(bits)),
                _ => (format!("ignored_at_bit_{start}"), Content::Ignored(bits)),
            };
            Item { name, place, content }
        };
        parts.map(item).collect()
    }

    /// The packet of a CAN frame: identifier and length before its bytes, as in captures of link type 227.
    fn with_can_header(self) -> Packet {
        let Some((id, is_extended)) = self.frame.id else { return self };
        let mut frame = Frame::new(&self.frame.name, CAN_HEADER + self.frame.length());
        frame.set_constant(0, &(id | if is_extended { EXTENDED } else { 0 }).to_be_bytes());
        frame.set_constant(size_of::<u32>(), &[self.frame.length() as u8]);
        frame.set_ignored(CAN_HEADER, self.frame.template());
        let byte = |at| BitField::bytes(at, Number { coding: Coding::Unsigned, length: 1, is_little_endian: false });
        for (at, (own, required)) in self.frame.template().iter().zip(self.frame.required()).enumerate() {
            for bit in (0..8).filter(|bit| required >> bit & 1 == 1) {
                frame.set_selector(byte(CAN_HEADER + at).bits_of(bit, 1), (own >> bit & 1).into());
            }
        }
        frame.fields = self.frame.fields;
        frame.fields.iter_mut().for_each(|field| field.place.at += CAN_HEADER);
        frame.checks = self.frame.checks;
        for check in &mut frame.checks {
            check.place.at += CAN_HEADER;
            check.covers = check.covers.start + CAN_HEADER..check.covers.end + CAN_HEADER;
        }
        Packet { frame, ..self }
    }
}

impl Wire<'_> {
    /// The links as packets.
    pub fn ground(&self) -> Ground {
        let links = self.links.iter().map(|(_, rate, set)| {
            let packet = |frame: &Frame| {
                let parameter = |field: &Field| {
                    let value = &set.values[field.slot];
                    let range = self.range / value.factor;
                    Parameter {
                        name: value.name.clone(),
                        unit: value.unit,
                        meaning: format!("{} = {}", field.place, field.formula()),
                        range: matches!(value.quantity, Quantity::Output(_)).then_some((-range, range)),
                        choices: Vec::new(),
                    }
                };
                let parameters = frame.fields.iter().map(parameter).collect();
                Packet { frame: frame.clone(), parameters, meaning: set.cadence(frame) }.with_can_header()
            };
            let is_can = set.frames.iter().any(|frame| frame.id.is_some());
            PacketLink {
                name: if is_can { "can" } else { "serial" },
                baud: *rate,
                telemetry: set.frames.iter().map(packet).collect(),
                commands: Vec::new(),
            }
        });
        Ground {
            name: self.prefix.to_uppercase(),
            title: plain(self.title),
            source: format!("{}; {}", plain(self.source), self.output),
            links: links.collect(),
        }
    }
}

/// The part of a message of the default unit.
enum Part {
    Constant(u8),
    /// A number, its scale, and its bits by their numbers if these are the fields.
    Number(WireType, f64, Parameter, Vec<(u8, Parameter)>),
}

fn field(spec: &FieldSpec) -> Part {
    let covered =
        if spec.name == CRC.name { ", over the 8 bytes of INCREMENTS then the first 6 of STATUS" } else { "" };
    let meaning = format!("{}{covered}", spec.meaning);
    let whole = Parameter { name: spec.name.to_owned(), unit: spec.unit, meaning, ..Parameter::default() };
    let bits = spec.bits.iter().map(|bit| {
        (bit.bit, Parameter { name: bit.name.to_owned(), meaning: bit.meaning.to_owned(), ..Parameter::default() })
    });
    Part::Number(spec.wire, spec.scale, whole, bits.collect())
}

fn argument(spec: &ArgumentSpec) -> Part {
    let (low, high) = spec.range;
    let range = (spec.range != spec.wire.limits()).then_some((low as f64, high as f64));
    let (name, meaning) = (spec.name.to_owned(), spec.meaning.to_owned());
    Part::Number(spec.wire, 1.0, Parameter { name, unit: "", meaning, range, choices: spec.choices() }, Vec::new())
}

/// A message of the default unit; serial ones have sync, type, length and CRC around it.
fn message(name: &str, id: MessageId, plan: CanIdMap, meaning: &str, parts: Vec<Part>) -> Packet {
    let size = |part: &Part| match part {
        Part::Constant(_) => 1,
        Part::Number(wire, ..) => wire.length(),
    };
    let number = |wire: WireType| {
        let coding = if wire.signed() { Coding::Signed } else { Coding::Unsigned };
        Number { coding, length: wire.length(), is_little_endian: false }
    };
    let payload: usize = parts.iter().map(size).sum();
    let (mut frame, mut at) = match id {
        MessageId::Can(offset) => {
            let mut frame = Frame::new(name, payload);
            frame.id = Some(((plan.base() + offset).into(), false));
            (frame, 0)
        }
        MessageId::Serial(code) => {
            let end = HEADER + payload;
            let mut frame = Frame::new(name, end + serial::CRC);
            frame.set_constant(0, &[SYNC[0], SYNC[1], code, payload as u8]);
            let place = BitField::bytes(end, number(CRC.wire));
            frame.checks.extend(Check::new("CRC-16/IBM-3740", place, TYPE_AT..end));
            (frame, HEADER)
        }
    };
    let mut parameters = Vec::new();
    for part in parts {
        let length = size(&part);
        match part {
            Part::Constant(byte) => frame.set_constant(at, &[byte]),
            Part::Number(wire, scale, whole, bits) => {
                let place = BitField::bytes(at, number(wire));
                let mut push = |place, parameter| {
                    frame.fields.push(Field::new(parameters.len(), place).scaled(scale, 0.0));
                    parameters.push(parameter);
                };
                match bits.is_empty() {
                    true => push(place, whole),
                    false => bits.into_iter().for_each(|(bit, own)| push(place.bits_of(bit.into(), 1), own)),
                }
            }
        }
        at += length;
    }
    Packet { frame, parameters, meaning: meaning.to_owned() }.with_can_header()
}

/// Messages, replies and commands of the default unit on one link; `prefix` begins the names that both links have.
fn link(is_can: bool, plan: CanIdMap) -> PacketLink {
    let (name, prefix) = if is_can { ("can", "CAN_") } else { ("serial", "") };
    let (command, reply) = if is_can { (COMMAND_CAN, REPLY_CAN) } else { (COMMAND_SERIAL, REPLY_SERIAL) };
    let cyclic = MESSAGES.iter().filter(|spec| matches!(spec.id, MessageId::Can(_)) == is_can);
    let cyclic = cyclic
        .map(|spec| message(spec.name, spec.id, plan, spec.meaning, spec.fields.iter().map(field).collect::<Vec<_>>()));
    let number = |name: &str, meaning: &str, choices| {
        let own = Parameter { name: name.to_owned(), meaning: meaning.to_owned(), choices, ..Parameter::default() };
        Part::Number(WireType::U8, 1.0, own, Vec::new())
    };
    let result = || {
        let choices = CommandResult::ALL.iter().map(|result| (*result as i64, result.text())).collect();
        number("result", "how the command ended", choices)
    };
    let parts = vec![number("opcode", "of the command", Vec::new()), result()];
    let plain = message(&format!("{prefix}REPLY"), reply, plan, "reply without values, to the link that asked", parts);
    let answers = COMMANDS.iter().filter(|spec| !spec.values.is_empty()).map(|spec| {
        let parts = [Part::Constant(spec.opcode), result()].into_iter().chain(spec.values.iter().map(argument));
        let name = format!("{prefix}REPLY_{}", spec.name);
        message(&name, reply, plan, &format!("reply to {} that is done", spec.name), parts.collect())
    });
    let commands = COMMANDS.iter().map(|spec| {
        let parts = [Part::Constant(spec.opcode)].into_iter().chain(spec.arguments.iter().map(argument));
        message(&format!("{prefix}{}", spec.name), command, plan, spec.meaning, parts.collect())
    });
    PacketLink {
        name,
        baud: DEFAULT_BAUD,
        telemetry: cyclic.chain([plain]).chain(answers).collect(),
        commands: commands.collect(),
    }
}

/// The links of the default unit as packets, with CAN identifiers at `plan`.
pub fn ground(plan: CanIdMap) -> Ground {
    Ground {
        name: "GEU".to_owned(),
        title: "Gyro electronics unit".to_owned(),
        source: format!("interface control document, link {}.{}", crate::LINK_VERSION.0, crate::LINK_VERSION.1),
        links: [false, true].map(|is_can| link(is_can, plan)).into(),
    }
}
