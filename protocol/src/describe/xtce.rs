//! The packets as an XTCE 1.2 document.

use std::mem::discriminant;

use super::packet::{Content, Ground, Item, Packet, PacketLink};
use crate::layout::{BitField, Check, Coding};
use crate::map;
use crate::template::{Value, engine, filled};

/// Names that are in use.
#[derive(Default)]
struct Names {
    /// Parameters; the same one may be in several packets.
    parameters: Vec<(String, Value)>,
    containers: Vec<String>,
}

impl Names {
    /// A free name of a container; `can` and `serial` are the containers of the links.
    fn container(&mut self, name: String) -> String {
        let is_free = |name: &String| !matches!(&**name, "can" | "serial") && !self.containers.contains(name);
        let others = (2..).map(|count| format!("{name}_{count}"));
        let name = [name.clone()].into_iter().chain(others).find(is_free).unwrap_or_default();
        self.containers.push(name.clone());
        name
    }

    /// The name of a parameter: `name` if no other one has it, or else with the name of its packet.
    fn register(&mut self, name: &str, packet: &str, own: Value) -> String {
        let names = [name.to_owned(), format!("{packet}_{name}")].into_iter();
        let mut names = names.chain((2..).map(|count| format!("{packet}_{name}_{count}")));
        loop {
            let name = names.next().unwrap_or_default();
            match self.parameters.iter().find(|(other, _)| *other == name) {
                Some((_, other)) if *other != own => {}
                Some(_) => return name,
                None => {
                    self.parameters.push((name.clone(), own));
                    return name;
                }
            }
        }
    }
}

/// Parts that the document includes in several places.
const PARTS: [(&str, &str); 3] = [
    ("encoding", include_str!("xtce_encoding.xml")),
    ("checks", include_str!("xtce_checks.xml")),
    ("entry", include_str!("xtce_entry.xml")),
];

/// A name as XTCE allows it.
fn name(text: &str) -> String {
    text.replace(|letter: char| !letter.is_alphanumeric() && !matches!(letter, '_' | '-'), "_")
}

impl Ground {
    /// The document.
    ///
    /// # Errors
    /// Numbers or frames that XTCE cannot express, in words.
    pub fn xtce(&self) -> Result<String, String> {
        let mut names = Names::default();
        let links = self.links.iter().map(|link| containers(link, &mut names));
        let links = links.collect::<Result<Vec<_>, String>>()?;
        let commands: Vec<Value> =
            self.links.iter().flat_map(|link| link.commands.iter().map(|own| command(own, link))).collect();
        let parameters: Vec<Value> =
            names.parameters.into_iter().map(|(name, own)| map! { name: name, own: own }).collect();
        let mut engine = engine();
        PARTS
            .iter()
            .for_each(|(name, part)| engine.add_template(*name, *part).unwrap_or_else(|error| panic!("{error:#}")));
        let text = filled(
            &engine,
            include_str!("xtce.xml"),
            &map! { name: self.name.clone(), title: self.title.clone(), source: self.source.clone(), parameters: parameters,
            links: links, commands: commands },
        );
        // Lines that only direct the template.
        Ok(text.lines().filter(|line| !line.trim().is_empty()).flat_map(|line| [line, "\n"]).collect())
    }
}

/// The number of an item: its encoding, its value and its limits.
fn number(item: &Item) -> Value {
    let Item { place, content, .. } = item;
    let is_reversed = place.is_little_endian() && place.bits > 8;
    let (mut kind, mut scale, mut offset, mut unit) = ("Integer", 1.0, 0.0, "");
    let (mut range, mut choices, meaning) = (None, Value::List(Vec::new()), item.meaning());
    if let Content::Field(field, own) = content {
        (scale, offset, unit, range) = (field.scale(), field.scaling().2, own.unit, own.range);
        choices = own.choices.iter().map(|&(value, label)| map! { value: value, label: label }).collect();
        if !own.choices.is_empty() {
            kind = "Enumerated";
        } else if place.coding == Coding::Float || (scale, offset) != (1.0, 0.0) {
            kind = "Float";
        }
    }
    if let Content::Constant(bits) = content {
        range = Some((*bits as f64, *bits as f64));
    }
    let limit = |value: f64| if kind == "Float" { format!("{value:?}") } else { format!("{value:.0}") };
    let range = range.map(|(low, high)| map! { low: limit(low), high: limit(high) });
    let encoding = match place.coding {
        Coding::Unsigned => "unsigned",
        Coding::Signed => "twosComplement",
        Coding::Float => "IEEE754_1985",
    };
    map! { kind: kind, is_real: kind == "Float", is_integer: kind == "Integer", is_float: place.coding == Coding::Float, encoding: encoding, bits: place.bits,
    size: if place.bits > 32 { 64 } else { 32 }, is_signed: place.coding != Coding::Unsigned, is_reversed: is_reversed,
    is_scaled: (scale, offset) != (1.0, 0.0), scale: format!("{scale:?}"), offset: format!("{offset:?}"), unit: unit,
    range: range, choices: choices, meaning: meaning }
}

/// The items of a packet, which must follow one another.
fn items<'a>(packet: &'a Packet, link: &PacketLink) -> Result<Vec<Item<'a>>, String> {
    let items = link.items(packet);
    let mut end = 0;
    for Item { name, place, .. } in &items {
        let at = format!("{}, {name}", packet.frame.name);
        match place.first_bit() {
            None => {
                return Err(format!(
                    "{at}: XTCE expects big-endian bits, bits of one byte or whole bytes, got {place} from byte {} on",
                    place.at
                ));
            }
            Some(first) if first != end => {
                return Err(format!(
                    "{at}: XTCE expects each bit in one number, got the bits of another one in {place}"
                ));
            }
            Some(first) => end = first + place.bits as usize,
        }
    }
    Ok(items)
}

/// A packet and its items.
type Itemised<'a> = (&'a Packet, Vec<Item<'a>>);

/// The items that select a packet of a link, and whether they are the first items of each packet.
///
/// # Errors
/// Two packets have no place with different constants.
fn selectors<'a>(packets: &'a [Itemised]) -> Result<(Vec<&'a Item<'a>>, bool), String> {
    let is_common = |item: &Item| {
        let is_same =
            |other: &Item| other.place == item.place && discriminant(&other.content) == discriminant(&item.content);
        packets.iter().all(|(_, items)| items.iter().any(is_same))
    };
    let first = packets.first().map(|(_, items)| &items[..]).unwrap_or_default();
    let leading: Vec<&Item> = first.iter().take_while(|item| is_fixed(item) && is_common(item)).collect();
    if twins(packets, &leading).is_none() {
        return Ok((leading, true));
    }
    let shortest = packets.iter().map(|(packet, _)| packet.frame.length()).min().unwrap_or_default();
    let is_selector = |item: &&Item| matches!(item.content, Content::Constant(_)) && item.place.end() <= shortest;
    let mut all: Vec<&Item> = Vec::new();
    for item in packets.iter().flat_map(|(_, items)| items).filter(is_selector) {
        if all.iter().all(|other| other.place != item.place) {
            all.push(item);
        }
    }
    match twins(packets, &all) {
        None => Ok((all, false)),
        Some((one, other)) => Err(format!(
            "{}: XTCE expects a constant that distinguishes it from {}, within the length of each frame, got none",
            other.frame.name, one.frame.name
        )),
    }
}

fn is_fixed(item: &Item) -> bool {
    matches!(item.content, Content::Constant(_) | Content::Ignored(_))
}

/// Values of the constants at the places of these items.
fn key(items: &[Item], selectors: &[&Item]) -> Vec<(BitField, u64)> {
    let constants = items.iter().filter_map(|item| match item.content {
        Content::Constant(bits) => Some((item.place, bits)),
        _ => None,
    });
    constants.filter(|(place, _)| selectors.iter().any(|selector| selector.place == *place)).collect()
}

/// Two packets that the selectors do not distinguish.
fn twins<'a>(packets: &'a [Itemised], selectors: &[&Item]) -> Option<(&'a Packet, &'a Packet)> {
    let keys: Vec<_> = packets.iter().map(|(_, items)| key(items, selectors)).collect();
    let differ = |one: usize, other: usize| {
        let is_other = |(place, bits): &(BitField, u64)| keys[other].iter().any(|(at, own)| at == place && own != bits);
        keys[one].iter().any(is_other)
    };
    let mut pairs = (1..keys.len()).flat_map(|other| (0..other).map(move |one| (one, other)));
    pairs.find(|(one, other)| !differ(*one, *other)).map(|(one, other)| (packets[one].0, packets[other].0))
}

/// The container of a link and the containers of its packets, which are restrictions of it by their constants.
///
/// The link's container has the first items of each packet, if they select the packet. If not, it has the selectors at their places, and
/// each packet has all of its items.
fn containers(link: &PacketLink, used: &mut Names) -> Result<Value, String> {
    let packets = link.telemetry.iter().map(|packet| Ok((packet, items(packet, link)?)));
    let packets = packets.collect::<Result<Vec<Itemised>, String>>()?;
    let (selectors, is_sequence) = selectors(&packets)?;
    let names = selectors.iter().map(|item| {
        let mut own = number(item);
        if let Value::Map(own) = &mut own {
            own.insert("range".to_owned(), Value::None);
        }
        used.register(&format!("{}_{}", link.name, item.name), link.name, own)
    });
    let names: Vec<String> = names.collect();
    let entries = selectors.iter().zip(&names).map(|(item, name)| {
        map! { name: name.clone(), is_located: !is_sequence, at: item.place.first_bit().unwrap_or_default() as u32 }
    });
    let entries = entries.collect::<Value>();
    let selector =
        |place: BitField| selectors.iter().position(|item| item.place == place).map(|index| names[index].clone());
    let containers = packets.iter().map(|(packet, items)| {
        let packet_name = used.container(name(&packet.frame.name));
        let own = items.iter().skip(if is_sequence { selectors.len() } else { 0 }).enumerate().map(|(index, item)| {
            let mut own = || match item.content {
                Content::Field(..) | Content::Check(_) => used.register(&name(&item.name), &packet_name, number(item)),
                _ => used.register(&format!("{packet_name}_{}", item.name), &packet_name, number(item)),
            };
            let name = selector(item.place).filter(|_| is_fixed(item)).unwrap_or_else(&mut own);
            map! { name: name, is_located: index == 0 && !is_sequence, at: 0 }
        });
        let own = own.collect::<Value>();
        let comparisons = key(items, &selectors).into_iter().map(|(place, bits)| map! { name: selector(place), value: bits as u32 });
        map! { name: packet_name, meaning: packet.meaning.clone(), bits: 8 * packet.frame.length() as u32, crc: crc(packet),
        checks: checks(packet), entries: own, comparisons: comparisons.collect::<Value>() }
    });
    let containers = containers.collect::<Value>();
    Ok(
        map! { name: link.name, is_can: link.is_can(), is_sequence: is_sequence, entries: entries, containers: containers },
    )
}

/// The check values of a packet, in words.
fn checks(packet: &Packet) -> Value {
    let words = |check: &Check| {
        let place = &check.place;
        format!("The {place} from byte {} on is {}.", place.at, check.in_words(check.place.at))
    };
    packet.frame.checks.iter().map(words).collect()
}

/// The CRC of a packet that XTCE can express: of all bytes before it.
fn crc(packet: &Packet) -> Value {
    let [check] = &packet.frame.checks[..] else { return Value::None };
    let is_whole = check.covers == (0..check.place.at) && check.pad_to() == 1 && check.suffix.is_empty();
    let Some(crc) = check.parameters().filter(|_| is_whole) else { return Value::None };
    let digits = crc.width.div_ceil(8) as usize * 2;
    let hex = |number: u64| format!("{number:0digits$X}");
    map! { width: crc.width, polynomial: hex(crc.polynomial), initial: hex(crc.initial), final_xor: hex(crc.final_xor),
    reflects_input: crc.reflects_input, reflects_output: crc.reflects_output, at: 8 * check.place.at as u32 }
}

fn command(packet: &Packet, link: &PacketLink) -> Value {
    let command = name(&packet.frame.name);
    let items = link.items(packet).into_iter().map(|item| {
        let size = item.place.bits;
        let digits = size.div_ceil(8) as usize * 2;
        let (fixed, argument) = match item.content {
            Content::Constant(bits) | Content::Ignored(bits) => (Some(format!("{bits:0digits$X}")), None),
            Content::Check(_) => (Some("0".repeat(digits)), None),
            Content::Field(..) => (None, Some(number(&item))),
        };
        map! { name: name(&item.name), fixed: fixed, argument: argument, size: size }
    });
    map! { name: command, meaning: packet.meaning.clone(), bits: 8 * packet.frame.length() as u32,
    has_arguments: !packet.frame.fields.is_empty(), items: items.collect::<Value>(), crc: crc(packet), checks: checks(packet) }
}
