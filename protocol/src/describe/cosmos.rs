//! The packets as definitions of an OpenC3 COSMOS target.

use super::packet::{Content, Ground, Item, Packet, PacketLink};
use crate::layout::{BitField, Check, Coding, Number};
use crate::map;
use crate::template::{Value, engine, filled};

/// Names of packets and items, which COSMOS has in upper case.
fn name(text: &str) -> String {
    text.to_uppercase().replace(|letter: char| !letter.is_alphanumeric() && letter != '_', "_")
}

impl Ground {
    /// Definitions of the packets of the first link; comments at the start are the lines of `plugin.txt`.
    pub fn cosmos(&self) -> String {
        let Some(link) = self.links.first() else { return String::new() };
        let sync = link.sync();
        let crc = crc(link);
        // A CRC that begins behind the sync: COSMOS discards the sync of what it reads, and adds it to commands.
        let discarded = crc.map_or(0, |check| check.covers.start);
        let packets = |packets: &[Packet]| packets.iter().map(|own| packet(own, link, discarded)).collect::<Value>();
        let constants = link.telemetry.iter().flat_map(|packet| link.items(packet));
        let constants = constants.filter(|item| matches!(item.content, Content::Constant(_)));
        let others: Vec<&str> = self.links[1..].iter().map(|link| link.name).collect();
        let checks = link.telemetry.iter().chain(&link.commands).flat_map(|packet| {
            let name = &packet.frame.name;
            packet
                .frame
                .checks
                .iter()
                .map(move |check| format!("{name}, byte {}: {}", check.place.at, check.in_words(check.place.at)))
        });
        filled(
            &engine(),
            include_str!("cosmos.txt"),
            &map! { name: self.name.clone(), title: self.title.clone(), source: self.source.clone(), baud: link.baud, is_can: link.is_can(), others: others,
            min_id: constants.map(|item| item.place.end()).max().unwrap_or_default().max(1) as u32, discarded: discarded as u32,
            sync: sync.iter().map(|byte| format!("{byte:02X}")).collect::<String>(),
            crc: crc.map(protocol), checks: if crc.is_some() { Value::None } else { checks.collect::<Value>() },
            telemetry: packets(&link.telemetry), commands: packets(&link.commands) },
        )
    }
}

/// The CRC of every packet, if COSMOS can verify it: at the end, of all bytes before it, with or without the sync, of 16 or 32 bits.
fn crc(link: &PacketLink) -> Option<&Check> {
    let mut packets = link.telemetry.iter().chain(&link.commands);
    let first = link.telemetry.first()?.frame.checks.first()?;
    let parameters = first.parameters()?;
    let ones = u64::MAX >> (u64::BITS - parameters.width);
    let is_known = |value| value == 0 || value == ones;
    let is_possible = matches!(parameters.width, 16 | 32)
        && parameters.reflects_input == parameters.reflects_output
        && is_known(parameters.final_xor)
        && (!parameters.reflects_input || is_known(parameters.initial))
        && first.covers.start <= link.sync().len();
    let is_same = |packet: &Packet| {
        let [check] = &packet.frame.checks[..] else { return false };
        let is_last = check.place.bits as usize == 8 * check.place.length && check.place.end() == packet.frame.length();
        check.name == first.name
            && check.covers == (first.covers.start..check.place.at)
            && is_last
            && check.place.bits == parameters.width
            && check.place.is_little_endian() == first.place.is_little_endian()
            && check.pad_to() == 1
            && check.suffix.is_empty()
    };
    packets.all(is_same).then_some(first).filter(|_| is_possible)
}

/// The arguments of COSMOS' protocol that verifies and writes a CRC.
fn protocol(check: &Check) -> Value {
    let crc = check.parameters().unwrap_or_default();
    map! { width: crc.width, is_little_endian: check.place.is_little_endian(), polynomial: format!("{:#X}", crc.polynomial),
    initial: format!("{:#X}", crc.initial), is_inverted: crc.final_xor != 0, is_reflected: crc.reflects_input }
}

fn packet(packet: &Packet, link: &PacketLink, discarded: usize) -> Value {
    let mut taken: Vec<String> = Vec::new();
    let items = link.items(packet).into_iter().filter(|item| item.place.at >= discarded);
    let items = items.flat_map(|item| {
        let wanted = name(&item.name);
        let names = std::iter::once(wanted.clone()).chain((2..).map(|count| format!("{wanted}_{count}")));
        let name = names.into_iter().find(|name| !taken.contains(name)).unwrap_or_default();
        taken.push(name.clone());
        let parts = parts(&item.place);
        let weights = parts
            .iter()
            .enumerate()
            .map(|(index, (_, weight))| format!("packet.read('{name}_PART_{index}') * {weight}"));
        let expression = (!parts.is_empty()).then(|| weights.collect::<Vec<_>>().join(" + "));
        let whole = definition(&item, &name, discarded, expression);
        let parts = parts.iter().enumerate().map(|(index, (place, _))| {
            let part = Item { name: String::new(), place: *place, content: Content::Ignored(0) };
            definition(&part, &format!("{name}_PART_{index}"), discarded, None)
        });
        parts.chain([whole]).collect::<Vec<_>>()
    });
    map! { name: name(&packet.frame.name), meaning: packet.meaning.clone(), items: items.collect::<Value>() }
}

/// Parts in one byte each, with their weights, of little-endian bits that COSMOS does not count in the length of a packet.
fn parts(place: &BitField) -> Vec<(BitField, u64)> {
    let is_usual = place.bits <= 8 || matches!(place.bits, 16 | 32 | 64);
    if !place.is_little_endian() || is_usual && place.first_bit().is_some() {
        return Vec::new();
    }
    let (low, high) = (place.shift() as usize, (place.shift() + place.bits) as usize);
    let part = |byte: usize| {
        let (from, to) = (low.max(8 * byte), high.min(8 * byte + 8));
        let coding = if to == high { place.coding } else { Coding::Unsigned };
        let number = Number { coding, length: 1, is_little_endian: false };
        let mut bits = BitField::bytes(place.at + byte, number).bits_of((from - 8 * byte) as u32, (to - from) as u32);
        bits.coding = coding;
        (bits, 1 << (from - low))
    };
    (low / 8..high.div_ceil(8)).map(part).collect()
}

/// An item, or a derived one with an expression that both Ruby and Python evaluate.
fn definition(item: &Item, name: &str, discarded: usize, expression: Option<String>) -> Value {
    let place = item.place;
    let is_reversed = place.is_little_endian() && place.bits > 8;
    let at = place.first_bit().unwrap_or_default().saturating_sub(8 * discarded);
    let coding = match place.coding {
        Coding::Unsigned => "UINT",
        Coding::Signed => "INT",
        Coding::Float => "FLOAT",
    };
    let (mut unit, mut range, mut scaling, mut choices) = ("", None, None, Value::List(Vec::new()));
    let (mut fixed, mut default) = (None, 0);
    match &item.content {
        Content::Constant(bits) => fixed = Some(*bits as i64),
        Content::Ignored(bits) => default = *bits as i64,
        Content::Check(_) => {}
        Content::Field(field, own) => {
            (unit, range) = (own.unit, own.range);
            default = range.map_or(0, |(low, _)| low.max(0.0) as i64);
            let (scale, offset) = (field.scale(), field.scaling().2);
            scaling = ((scale, offset) != (1.0, 0.0)).then(|| format!("{offset:?} {scale:?}"));
            choices =
                own.choices.iter().map(|&(value, label)| map! { value: value, label: label.to_uppercase() }).collect();
        }
    }
    let expression = expression.map(|sum| match &item.content {
        Content::Field(field, _) if scaling.is_some() => {
            format!("({sum}) * {:?} + {:?}", field.scale(), field.scaling().2)
        }
        _ => sum,
    });
    let range = range.map(|(low, high)| (format!("{low:.0}"), format!("{high:.0}")));
    let (low, high) = range.unwrap_or_else(|| ("MIN".to_owned(), "MAX".to_owned()));
    map! { name: name, at: at as u32, bits: place.bits, coding: coding, is_reversed: is_reversed, meaning: item.meaning().replace('"', "'"),
    is_fixed: fixed.is_some(), fixed: fixed, unit: unit, low: low, high: high, default: default,
    scaling: scaling, expression: expression, choices: choices }
}
