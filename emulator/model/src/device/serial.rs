//! Frames on a serial line, from a description: fields one after the other.

use std::sync::Arc;

use geu_protocol::hex::read_hex;
use geu_protocol::layout::{Assembly, BitField, Check, Coding, Frame, FrameSet, Number, check_names};
use geu_protocol::serial::{BITS_PER_BYTE, DEFAULT_BAUD};
use geu_protocol::suggestion::did_you_mean;

use super::fields::{Fields, KEYS};
use super::{Device, positive};
use crate::configuration::{ConfigurationError, Node};

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
    pub(super) fn read(node: &Node, device: &Device) -> Result<SerialWire, ConfigurationError> {
        node.only(&["baud", "frame"])?;
        let baud = match node.keys().contains(&"baud") {
            true => positive(node, "baud", 50.0, 1e8)? as u32,
            false => DEFAULT_BAUD,
        };
        let mut fields = Fields::new(device);
        let (mut is_unchecked, mut line_s) = (false, 0.0);
        let nodes = node.tables("frame")?;
        for node in &nodes {
            let (frame, unchecked) = frame(node, &mut fields)?;
            line_s += frame.length() as f64 * f64::from(BITS_PER_BYTE) / f64::from(baud) / f64::from(frame.every);
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
        if line_s > device.interval_s {
            let message = format!(
                "expected frames that take at most the sample interval of {} s, got {line_s:.6} s a sample at {baud} baud",
                device.interval_s
            );
            return Err(node.error("baud", message));
        }
        device.carries_all(&fields.set, node, "frame")?;
        Ok(SerialWire { baud, frames: Arc::new(fields.set), is_unchecked })
    }
}

/// A frame, and true if its constants or checks are not enough to find it.
fn frame(node: &Node, fields: &mut Fields) -> Result<(Frame, bool), ConfigurationError> {
    node.only(&["name", "every", "fields", "unchecked"])?;
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
    let mut frame = Frame::new(node.text("name")?, length);
    frame.every = match node.whole_number("every")? {
        None => 1,
        Some(every @ 1..=1_000_000) => every as u32,
        Some(_) => return Err(node.unexpected("every", "a whole number from 1 to 1000000")),
    };
    for (field, at) in own.iter().zip(places) {
        add(field, at, &mut frame, fields)?;
    }
    let is_found = !frame.start().is_empty() && !frame.checks.is_empty();
    let is_unchecked = node.value("unchecked", crate::parameter_spec::ValueFormat::Flag, 0.0, 1.0)? == Some(1.0);
    match is_found || is_unchecked {
        _ if frame.start().is_empty() && frame.checks.is_empty() => {
            Err(node.error("fields", "expected a constant at the start, or a check, got none".to_owned()))
        }
        true => Ok((frame, !is_found)),
        false => {
            let message = "expected a constant at the start and a check, so that no other bytes are taken for a frame, got only \
                           the one or the other; `unchecked = true` accepts that";
            Err(node.error("fields", message.to_owned()))
        }
    }
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
    let kinds = ["constant", "ignored", "head", "value", "bits", "crc"];
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
        frame.checks.push(check(node, BitField::bytes(at, number(node)?), frame.length())?);
    } else if has("bits") {
        node.only(&["bits", "type"])?;
        let word = BitField::bytes(at, number(node)?);
        if word.coding != Coding::Unsigned {
            return Err(node.unexpected("type", "a type without sign"));
        }
        if let Some(bits) = node.table("bits")? {
            frame.fields.extend(fields.bits(&bits, word)?);
        }
    } else {
        node.only(&[&KEYS[..], &["type"]].concat())?;
        let place = BitField::bytes(at, number(node)?);
        frame.fields.push(fields.field(node, place, (1.0, 0.0))?);
    }
    Ok(())
}

/// A check, in a frame of this length.
pub(super) fn check(node: &Node, place: BitField, length: usize) -> Result<Check, ConfigurationError> {
    node.only(&["crc", "type", "signal", "from", "to", "pad_to", "suffix"])?;
    let whole = |key: &str, default: usize, max: usize| match node.whole_number(key)? {
        None => Ok(default),
        Some(value) if value as usize <= max => Ok(value as usize),
        Some(_) => Err(node.unexpected(key, &format!("a whole number up to {max}"))),
    };
    // On a serial line a check covers what comes before it, on CAN the rest of the message.
    let all = if node.keys().contains(&"signal") { length } else { place.at };
    let to = whole("to", all, length)?;
    let from = whole("from", 0, to)?;
    let name = node.text("crc")?;
    let mut check = Check::new(name, place, from..to).ok_or_else(|| {
        let names = check_names();
        let hint = did_you_mean(name, &names);
        node.unexpected("crc", &format!("a name of the CRC catalogue, sum, negated-sum or xor; {hint}"))
    })?;
    if place.coding != Coding::Unsigned || (check.width() > 0 && check.width() != place.bits) {
        let message = format!(
            "expected a field of {} bits without sign for {name}, got {} bits",
            check.width().max(place.bits),
            place.bits
        );
        return Err(node.error("crc", message));
    }
    check.pad_to = whole("pad_to", 1, Check::MAX_PADDING)?.max(1);
    if node.keys().contains(&"suffix") {
        check.suffix = bytes(node, "suffix")?;
    }
    Ok(check)
}
