//! Messages on CAN, from a database and the meaning of its signals.

use std::collections::BTreeMap;
use std::sync::Arc;

use geu_protocol::excerpt::excerpt;
use geu_protocol::layout::{
    Assembly, BitField, Database, DatabaseMessage, DatabaseSignal, Frame, FrameSet, SignalRole, ValueSpec,
};
use geu_protocol::suggestion::{did_you_mean, listed};

use super::fields::{Fields, Unstated};
use super::serial::{CHECK_KEYS, check};
use super::{Device, Files, positive};
use crate::configuration::{ConfigurationError, Node};

/// The messages of a unit on CAN.
#[derive(Debug, Clone)]
pub struct CanWire {
    /// Bit rate of the bus; it is for information.
    pub bitrate: u32,
    /// The database.
    pub dbc: String,
    pub frames: Arc<FrameSet>,
}

/// Longest message, byte.
const MAX_LENGTH: usize = 8;

/// Default of `bitrate`.
const BITRATE: f64 = 500_000.0;

/// A frame under construction: a message, for one number of its selector.
type Key = (usize, Option<u64>);

/// Frames under construction.
type Frames = BTreeMap<Key, Frame>;

impl CanWire {
    /// Reads `node`; `values` belong to the other link.
    pub(super) fn read(
        node: &Node,
        device: &Device,
        values: Vec<ValueSpec>,
        files: Files,
    ) -> Result<CanWire, ConfigurationError> {
        node.only(&["dbc", "bitrate", "signals", "checks"])?;
        let bitrate = if node.keys().contains(&"bitrate") { positive(node, "bitrate", 1e3, 1e8)? } else { BITRATE };
        let text =
            files(node.text("dbc")?).map_err(|why| node.unexpected("dbc", &format!("a readable file ({why})")))?;
        let database = Database::parse(&text)
            .map_err(|why| node.unexpected("dbc", &format!("a CAN database ({})", excerpt(&why))))?;
        let signals = node.table("signals")?;
        let signals =
            signals.ok_or_else(|| node.error("signals", "expected a table `signals`, got none".to_owned()))?;
        let (mut fields, mut frames) = (Fields::new(device, values), Frames::new());
        for name in signals.keys() {
            let (key, place, signal) = find(&database, &signals, name, name)?;
            let frame = frames.entry(key).or_insert_with(|| of_message(&database.messages[key.0], key.1));
            let Some(own) = signals.table(name)? else { continue };
            if own.keys().contains(&"bits") {
                own.only(&["bits"])?;
                if let Some(bits) = own.table("bits")? {
                    frame.fields.extend(fields.bits(&bits, place)?);
                }
                continue;
            }
            let unstated = Unstated { scale: signal.scale, offset: signal.offset, unit: &signal.unit };
            frame.fields.push(fields.field(&own, place, &unstated, &[])?);
        }
        for node in node.tables("checks")? {
            node.only(&[&CHECK_KEYS[..], &["signal"]].concat())?;
            let (key, place, _) = find(&database, &node, "signal", node.text("signal")?)?;
            let frame = frames.entry(key).or_insert_with(|| of_message(&database.messages[key.0], key.1));
            frame.checks.push(check(&node, place, frame.length())?);
        }
        fields.set.frames = spread(frames).into_values().collect();
        if fields.set.frames.is_empty() || fields.set.frames.len() > Assembly::MAX_FRAMES {
            let (max, got) = (Assembly::MAX_FRAMES, fields.set.frames.len());
            return Err(node.error("signals", format!("expected 1 to {max} messages, got {got}")));
        }
        if let Some(frame) = fields.set.frames.iter().find(|frame| frame.fields.is_empty()) {
            let message = format!("expected a message that carries something, got {}", frame.name);
            return Err(node.error("checks", message));
        }
        fields.check(node, "signals")?;
        Ok(CanWire { bitrate: bitrate as u32, dbc: text, frames: Arc::new(fields.set) })
    }
}

/// In a message with a selector, its plain signals and checks are in the frame of each number.
fn spread(mut frames: Frames) -> Frames {
    let plain: Vec<usize> = frames.keys().filter(|(_, selected)| selected.is_none()).map(|(index, _)| *index).collect();
    for index in plain {
        let selected: Vec<Key> = frames.keys().filter(|key| key.0 == index && key.1.is_some()).copied().collect();
        if selected.is_empty() {
            continue;
        }
        let Some(common) = frames.remove(&(index, None)) else { continue };
        for key in selected {
            if let Some(frame) = frames.get_mut(&key) {
                frame.fields.extend(common.fields.iter().cloned());
                frame.checks.extend(common.checks.iter().cloned());
            }
        }
    }
    frames
}

/// The frame and the place of `MESSAGE.SIGNAL`; errors point at `key`.
fn find<'d>(
    database: &'d Database,
    node: &Node,
    key: &str,
    name: &str,
) -> Result<(Key, BitField, &'d DatabaseSignal), ConfigurationError> {
    let found = database.messages.iter().enumerate().find_map(|(index, message)| {
        let signal = name.strip_prefix(message.name.as_str())?.strip_prefix('.')?;
        Some((index, message.signals.iter().find(|own| own.name == signal)?))
    });
    let (index, signal) = found.ok_or_else(|| {
        let of_message = |message: &DatabaseMessage| {
            message.signals.iter().map(|signal| format!("{}.{}", message.name, signal.name)).collect::<Vec<_>>()
        };
        let names: Vec<String> = database.messages.iter().flat_map(of_message).collect();
        let hint = did_you_mean(name, &names);
        let known = listed(&names);
        node.error(
            key,
            format!("{hint}expected \"MESSAGE.SIGNAL\" of the database, in quotes, got {name}; it has {known}"),
        )
    })?;
    let message = &database.messages[index];
    if !(1..=MAX_LENGTH).contains(&message.length) {
        return Err(
            node.error(key, format!("expected a message of 1 to {MAX_LENGTH} bytes, got {} bytes", message.length))
        );
    }
    let place = signal.place.ok_or_else(|| {
        let max = BitField::MAX_EXACT_BITS;
        node.error(key, format!("expected a signal inside its message, of 1 to {max} bits, got {name}"))
    })?;
    let selected = match signal.role {
        SignalRole::Selected(number) => Some(number),
        SignalRole::Plain | SignalRole::Selector => None,
        SignalRole::Nested => {
            return Err(node.error(key, format!("expected a message with at most one selector, got {}", message.name)));
        }
    };
    Ok(((index, selected), place, signal))
}

/// A message with the start values of its signals.
fn of_message(message: &DatabaseMessage, selected: Option<u64>) -> Frame {
    let name = selected.map_or(message.name.clone(), |number| format!("{}_{number}", message.name));
    let mut frame = Frame::new(&name, message.length);
    frame.id = Some((message.id, message.is_extended));
    for signal in &message.signals {
        let Some(place) = signal.place else { continue };
        match (signal.role, selected) {
            (SignalRole::Selector, Some(number)) => frame.set_selector(place, number),
            (SignalRole::Plain | SignalRole::Selector, _) => frame.set_number(place, signal.start),
            (SignalRole::Selected(number), Some(own)) if number == own => frame.set_number(place, signal.start),
            _ => {}
        }
    }
    frame
}
