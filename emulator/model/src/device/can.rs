//! Messages on CAN, from a database and the meaning of its signals.

use std::collections::BTreeMap;
use std::sync::Arc;

use geu_protocol::layout::{
    Assembly, BitField, Database, DatabaseMessage, DatabaseSignal, Frame, FrameSet, SignalRole,
};
use geu_protocol::suggestion::did_you_mean;

use super::fields::{Fields, KEYS};
use super::serial::check;
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

/// Default of `bitrate`.
const BITRATE: f64 = 500_000.0;

/// A frame under construction: a message, for one number of its selector.
type Key = (usize, Option<u64>);

impl CanWire {
    pub(super) fn read(node: &Node, device: &Device, files: Files) -> Result<CanWire, ConfigurationError> {
        node.only(&["dbc", "bitrate", "signals", "checks"])?;
        let bitrate = if node.keys().contains(&"bitrate") { positive(node, "bitrate", 1e3, 1e8)? } else { BITRATE };
        let text =
            files(node.text("dbc")?).map_err(|why| node.unexpected("dbc", &format!("a readable file ({why})")))?;
        let database =
            Database::parse(&text).map_err(|why| node.unexpected("dbc", &format!("a CAN database ({why})")))?;
        let signals = node.table("signals")?;
        let signals =
            signals.ok_or_else(|| node.error("signals", "expected a table `signals`, got none".to_owned()))?;
        let mut fields = Fields::new(device);
        let mut frames: BTreeMap<Key, Frame> = BTreeMap::new();
        for name in signals.keys() {
            let (key, place, signal) = find(&database, &signals, name, name)?;
            let frame = frames.entry(key).or_insert_with(|| of_message(&database.messages[key.0], key.1));
            let own = match signals.table(name)? {
                Some(own) => own,
                None => continue,
            };
            if own.keys().contains(&"bits") {
                own.only(&["bits"])?;
                if let Some(bits) = own.table("bits")? {
                    frame.fields.extend(fields.bits(&bits, place)?);
                }
                continue;
            }
            own.only(&KEYS)?;
            frame.fields.push(fields.field(&own, place, (signal.scale, signal.offset))?);
        }
        for node in node.tables("checks")? {
            let (key, place, _) = find(&database, &node, "signal", node.text("signal")?)?;
            let Some(frame) = frames.get_mut(&key) else {
                return Err(node.unexpected("signal", "a signal of a message that carries something"));
            };
            frame.checks.push(check(&node, place, frame.length())?);
        }
        for frame in frames.values() {
            overlaps(frame, &signals)?;
        }
        if frames.is_empty() || frames.len() > Assembly::MAX_FRAMES {
            return Err(
                node.error("signals", format!("expected 1 to {} messages, got {}", Assembly::MAX_FRAMES, frames.len()))
            );
        }
        fields.set.frames = frames.into_values().collect();
        device.carries_all(&fields.set, node, "signals")?;
        Ok(CanWire { bitrate: bitrate as u32, dbc: text, frames: Arc::new(fields.set) })
    }
}

/// The frame and the place of `MESSAGE.SIGNAL`; errors point at `key`.
fn find<'d>(
    database: &'d Database,
    node: &Node,
    key: &str,
    name: &str,
) -> Result<(Key, BitField, &'d DatabaseSignal), ConfigurationError> {
    let names = database
        .messages
        .iter()
        .flat_map(|message| message.signals.iter().map(move |signal| format!("{}.{}", message.name, signal.name)));
    let names: Vec<String> = names.collect();
    let found = database.messages.iter().enumerate().find_map(|(index, message)| {
        let signal = name.strip_prefix(message.name.as_str())?.strip_prefix('.')?;
        Some((index, message.signals.iter().find(|own| own.name == signal)?))
    });
    let (index, signal) = found.ok_or_else(|| {
        let hint = did_you_mean(name, &names);
        node.error(key, format!("{hint}expected MESSAGE.SIGNAL of the database, got {name}"))
    })?;
    let place = signal.place.ok_or_else(|| {
        node.error(key, format!("expected a signal inside its message, of at most 8 bytes, got {name}"))
    })?;
    let selected = match signal.role {
        SignalRole::Selected(number) => Some(number),
        SignalRole::Plain | SignalRole::Selector => None,
    };
    Ok(((index, selected), place, signal))
}

/// A message with the start values of its signals.
fn of_message(message: &DatabaseMessage, selected: Option<u64>) -> Frame {
    let mut frame = Frame::new(&message.name, message.length);
    frame.id = Some((message.id, message.is_extended));
    for signal in &message.signals {
        match (signal.place, signal.role) {
            (Some(place), SignalRole::Selector) if selected.is_some() => {
                frame.set_selector(place, selected.unwrap_or_default());
            }
            (Some(place), SignalRole::Plain | SignalRole::Selector) => frame.set_number(place, signal.start),
            (Some(place), SignalRole::Selected(number)) if Some(number) == selected => {
                frame.set_number(place, signal.start)
            }
            _ => {}
        }
    }
    frame
}

/// Refuses fields and checks that share a bit.
fn overlaps(frame: &Frame, node: &Node) -> Result<(), ConfigurationError> {
    let places = frame.fields.iter().map(|field| field.place).chain(frame.checks.iter().map(|check| check.place));
    let mut used = vec![0; frame.length()];
    for place in places {
        let own = place.used(frame.length());
        if used.iter().zip(&own).any(|(used, own)| used & own != 0) {
            let name = &frame.name;
            return Err(
                node.error("", format!("expected signals with bits of their own in {name}, got two that share a bit"))
            );
        }
        used.iter_mut().zip(own).for_each(|(used, own)| *used |= own);
    }
    Ok(())
}
