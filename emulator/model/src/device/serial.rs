//! Frames on a serial line, from a description: fields one after the other.

use std::sync::Arc;

use geu_protocol::hex::read_hex;
use geu_protocol::layout::{Assembly, BitField, Check, Coding, Frame, FrameSet, Number, check_names, sum_names};
use geu_protocol::serial::{BITS_PER_BYTE, DEFAULT_BAUD};
use geu_protocol::suggestion::did_you_mean;

use super::fields::{Fields, PLAIN, is_identifier};
use super::{Device, positive};
use crate::configuration::{ConfigurationError, Node};
use crate::parameter_spec::ValueFormat;

/// Most checks of a frame: each has tables.
const MAX_CHECKS: usize = 4;

/// Longest frame, byte.
const MAX_FRAME: usize = 1024;

/// The frames of a unit on a serial line.
#[derive(Debug, Clone)]
pub struct SerialWire {
    /// Rate of the line.
    pub baud: u32,
    pub frames: Arc<FrameSet>,
    /// True if a frame may have no constant or no check.
    pub is_unchecked: bool,
}

impl SerialWire {
    /// Time of the frames of a sample on a line of this rate, s.
    pub fn line_s(&self, baud: u32) -> f64 {
        let frames = &self.frames.frames;
        let bytes = |frame: &Frame| match frame.instead_of.map(|other| frames[other].length() as f64) {
            None => frame.length() as f64 / f64::from(frame.every),
            Some(_) if frame.every == 1 => 0.0,
            Some(other) => (frame.length() as f64 - other) / f64::from(frame.every),
        };
        frames.iter().map(bytes).sum::<f64>() * f64::from(BITS_PER_BYTE) / f64::from(baud)
    }

    pub(super) fn read(node: &Node, device: &Device) -> Result<SerialWire, ConfigurationError> {
        node.only(&["baud", "frame"])?;
        let baud = match node.keys().contains(&"baud") {
            true => positive(node, "baud", 50.0, 1e8)? as u32,
            false => DEFAULT_BAUD,
        };
        let mut fields = Fields::new(device, Vec::new());
        let mut is_unchecked = false;
        let nodes = node.tables("frame")?;
        for node in &nodes {
            let (frame, unchecked) = frame(node, &mut fields)?;
            is_unchecked |= unchecked;
            fields.set.frames.push(frame);
        }
        if nodes.is_empty() || nodes.len() > Assembly::MAX_FRAMES {
            return Err(node.error(
                "frame",
                format!("expected 1 to {} tables [[device.serial.frame]], got {}", Assembly::MAX_FRAMES, nodes.len()),
            ));
        }
        if fields.set.frames.iter().all(|frame| frame.every > 1) {
            return Err(nodes[0].unexpected("every", "1 for one frame or more"));
        }
        fields.check(node, "frame")?;
        let wire = SerialWire { baud, frames: Arc::new(fields.set), is_unchecked };
        let line_s = wire.line_s(baud);
        if line_s > device.interval_s {
            let message = format!(
                "expected frames that take at most the sample interval of {} s, got {line_s:.6} s a sample at {baud} baud",
                device.interval_s
            );
            return Err(node.error("baud", message));
        }
        Ok(wire)
    }
}

/// A frame, and true if its constants or checks are not enough to find it.
fn frame(node: &Node, fields: &mut Fields) -> Result<(Frame, bool), ConfigurationError> {
    node.only(&["name", "every", "instead_of", "fields", "unchecked"])?;
    let own = node.tables("fields")?;
    let mut places = Vec::new();
    let mut length = 0;
    for field in &own {
        places.push(length);
        length += length_of(field)?;
    }
    if length == 0 || length > MAX_FRAME {
        return Err(node.error("fields", format!("expected fields of 1 to {MAX_FRAME} bytes, got {length}")));
    }
    let name = node.text("name")?;
    if !is_identifier(name) {
        return Err(node.unexpected("name", "a name of letters, digits and underscores"));
    }
    let mut frame = Frame::new(name, length);
    frame.every = match node.whole_number("every")? {
        None => 1,
        Some(every @ 1..=1_000_000) => every as u32,
        Some(_) => return Err(node.unexpected("every", "a whole number from 1 to 1000000")),
    };
    if node.keys().contains(&"instead_of") {
        let name = node.text("instead_of")?;
        let is_it = |frame: &Frame| frame.name == name && frame.every == 1 && frame.instead_of.is_none();
        let other = fields.set.frames.iter().position(is_it);
        frame.instead_of =
            Some(other.ok_or_else(|| node.unexpected("instead_of", "an earlier frame of every sample"))?);
        if frame.every == 1 && node.keys().contains(&"every") {
            return Err(node.unexpected("every", "2 or more in a frame that comes instead of another"));
        }
        fields.outputs.clear();
    }
    fields.every = frame.every;
    for (field, at) in own.iter().zip(places) {
        add(field, at, &mut frame, fields)?;
    }
    let is_unchecked = node.value("unchecked", ValueFormat::Flag, 0.0, 1.0)? == Some(1.0);
    let (has_start, has_check) = (!frame.start().is_empty(), !frame.checks.is_empty());
    let is_found = has_start && has_check && frame.is_covered();
    if is_found || (is_unchecked && (has_start || has_check)) {
        return Ok((frame, !is_found));
    }
    let got = match (has_start, has_check) {
        (true, true) => "a check that does not cover every field",
        (true, false) => "no check",
        (false, true) => "no constant",
        (false, false) => "neither",
    };
    let message = format!(
        "expected a constant at the start and a check of all fields, by which the frame is found, got {got}; \
         `unchecked = true` accepts a frame without the one or the other"
    );
    Err(node.error("fields", message))
}

/// The bytes under a key, in hexadecimal.
fn bytes(node: &Node, key: &str) -> Result<Vec<u8>, ConfigurationError> {
    let bytes = read_hex(node.text(key)?).filter(|bytes| !bytes.is_empty());
    bytes.ok_or_else(|| node.unexpected(key, "bytes in hexadecimal, such as \"FE 81\""))
}

fn number(node: &Node) -> Result<Number, ConfigurationError> {
    let names: Vec<String> = Number::all().map(Number::name).collect();
    let name = node.choice("type", &names.iter().map(String::as_str).collect::<Vec<_>>())?;
    Number::from_name(name).ok_or_else(|| node.unexpected("type", "a type"))
}

/// The type of a word of bits.
fn unsigned(node: &Node) -> Result<Number, ConfigurationError> {
    match number(node)? {
        number if number.coding == Coding::Unsigned => Ok(number),
        _ => Err(node.unexpected("type", "a type without sign")),
    }
}

fn length_of(node: &Node) -> Result<usize, ConfigurationError> {
    let has = |key: &str| node.keys().contains(&key);
    match (has("constant"), has("ignored")) {
        (true, _) => Ok(bytes(node, "constant")?.len()),
        (_, true) => Ok(bytes(node, "ignored")?.len()),
        _ => Ok(number(node)?.length),
    }
}

/// Adds a field at a byte.
fn add(node: &Node, at: usize, frame: &mut Frame, fields: &mut Fields) -> Result<(), ConfigurationError> {
    let has = |key: &str| node.keys().contains(&key);
    let kinds = ["constant", "ignored", "head", "value", "bits", "parts", "crc"];
    match kinds.iter().filter(|kind| has(kind)).count() {
        1 => {}
        got => {
            let message = format!("expected a single content ({}) in each field, got {got}", kinds.join(", "));
            return Err(node.error(node.keys().first().unwrap_or(&""), message));
        }
    }
    if has("constant") {
        node.only(&["constant"])?;
        frame.set_constant(at, &bytes(node, "constant")?);
    } else if has("ignored") {
        node.only(&["ignored", "comment"])?;
        frame.set_ignored(at, &bytes(node, "ignored")?);
    } else if has("crc") {
        node.only(&[&CHECK_KEYS[..], &["type"]].concat())?;
        if frame.checks.len() == MAX_CHECKS {
            return Err(node.error("crc", format!("expected at most {MAX_CHECKS} checks in a frame, got more")));
        }
        frame.checks.push(check(node, BitField::bytes(at, number(node)?), frame.length())?);
    } else if has("bits") {
        node.only(&["bits", "type"])?;
        let word = BitField::bytes(at, unsigned(node)?);
        if let Some(bits) = node.table("bits")? {
            frame.fields.extend(fields.bits(&bits, word)?);
        }
    } else if has("parts") {
        node.only(&["parts", "type"])?;
        let word = BitField::bytes(at, unsigned(node)?);
        let mut taken = 0;
        for part in node.tables("parts")? {
            add_part(&part, (word, &mut taken), frame, fields)?;
        }
    } else {
        let place = BitField::bytes(at, number(node)?);
        frame.fields.push(fields.field(node, place, &PLAIN, &["type"])?);
    }
    Ok(())
}

/// Adds a part of a word, of which earlier parts have taken bits: a number, named bits, or a constant.
fn add_part(
    part: &Node,
    (word, taken): (BitField, &mut u64),
    frame: &mut Frame,
    fields: &mut Fields,
) -> Result<(), ConfigurationError> {
    if let Some(bits) = part.table("bits")? {
        part.only(&["bits"])?;
        frame.fields.extend(fields.bits(&bits, word)?);
        return Ok(());
    }
    let whole = |key: &str, min: u64, max: u64| match part.whole_number(key)? {
        Some(value) if (min..=max).contains(&value) => Ok(value),
        _ => Err(part.unexpected(key, &format!("a whole number from {min} to {max}"))),
    };
    let first = whole("first", 0, u64::from(word.bits) - 1)? as u32;
    let mut place = word.bits_of(first, whole("length", 1, u64::from(word.bits - first))? as u32);
    let largest = u64::MAX >> (u64::BITS - place.bits);
    if *taken & largest << first != 0 {
        let message = format!("expected a part with bits of its own in {}, got bits of an earlier part", frame.name);
        return Err(part.error("first", message));
    }
    *taken |= largest << first;
    if part.keys().contains(&"constant") {
        part.only(&["constant", "first", "length"])?;
        frame.set_selector(place, whole("constant", 0, largest)?);
    } else if part.keys().contains(&"ignored") {
        part.only(&["ignored", "comment", "first", "length"])?;
        frame.set_number(place, whole("ignored", 0, largest)? as f64);
    } else {
        if part.value("signed", ValueFormat::Flag, 0.0, 1.0)? == Some(1.0) {
            place.coding = Coding::Signed;
        }
        frame.fields.push(fields.field(part, place, &PLAIN, &["first", "length", "signed"])?);
    }
    Ok(())
}

/// Keys of a check.
pub(super) const CHECK_KEYS: [&str; 5] = ["crc", "from", "to", "pad_to", "suffix"];

/// A check, in a frame of this length.
pub(super) fn check(node: &Node, place: BitField, length: usize) -> Result<Check, ConfigurationError> {
    let whole = |key: &str, default: usize, max: usize| match node.whole_number(key)? {
        None => Ok(default),
        Some(value) if value as usize <= max => Ok(value as usize),
        Some(_) => Err(node.unexpected(key, &format!("a whole number up to {max}"))),
    };
    // On CAN a check covers the rest of the message.
    let all = if node.keys().contains(&"signal") { length } else { place.at };
    let to = whole("to", all, length)?;
    let from = whole("from", 0, to)?;
    let name = node.text("crc")?;
    let mut check = Check::new(name, place, from..to).ok_or_else(|| {
        let (hint, sums) = (did_you_mean(name, check_names()), sum_names());
        let sums = sums.join(", ");
        let expected = format!("a name of the CRC catalogue such as CRC-16/XMODEM, or a sum ({sums})");
        node.error("crc", format!("{hint}expected {expected}, got {name}"))
    })?;
    if place.coding != Coding::Unsigned || (check.width() > 0 && check.width() != place.bits) {
        let width = if check.width() > 0 { format!("{} bits", check.width()) } else { "any bits".to_owned() };
        let message = format!("expected a field of {width} without sign for {name}, got {place}");
        return Err(node.error("crc", message));
    }
    check.pad(whole("pad_to", 1, Check::MAX_PADDING)?.max(1));
    if node.keys().contains(&"suffix") {
        check.suffix = bytes(node, "suffix")?;
    }
    Ok(check)
}
