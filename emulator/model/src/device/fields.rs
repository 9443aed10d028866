//! What a field carries: a head's output, another value of the sample, or a bit of a status word.

use geu_protocol::layout::{BitField, Coding, Field, Frame, FrameSet, Quantity, ValueSpec};

use super::{Device, Output, columns};
use crate::configuration::{ConfigurationError, Node};
use crate::parameter_spec::ValueFormat;
use crate::units::{ANGLE_UNITS, NamedUnits, RATE_UNITS, TIME_UNITS};

const TEMPERATURE_UNITS: NamedUnits = &[("degC", 1.0)];
const COUNT_UNITS: NamedUnits = &[("count", 1.0)];

/// Words of a `value`.
const VALUES: [&str; 5] = ["sequence", "clock_count", "latency", "electronics", "sensor"];

/// True for a name that programs can have: a letter, then letters, digits and underscores.
pub fn is_identifier(name: &str) -> bool {
    let is_part = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
    name.starts_with(|first: char| first.is_ascii_alphabetic()) && name.len() <= MAX_NAME && name.chars().all(is_part)
}

/// Longest name.
const MAX_NAME: usize = 48;

/// Collects the fields of a link.
pub struct Fields<'a> {
    pub device: &'a Device,
    pub set: FrameSet,
    /// Slots of the outputs that this link carries.
    pub outputs: Vec<usize>,
    /// Samples from one such frame to the next.
    pub every: u32,
}

/// Scale and offset of a field without its own, and its unit in a database.
pub struct Unstated<'a> {
    pub scale: f64,
    pub offset: f64,
    pub unit: &'a str,
}

/// A field without scale and offset.
pub const PLAIN: Unstated = Unstated { scale: 1.0, offset: 0.0, unit: "" };

impl<'a> Fields<'a> {
    /// Fields of a link, beside these values of another one.
    pub fn new(device: &'a Device, values: Vec<ValueSpec>) -> Fields<'a> {
        Fields { device, set: FrameSet { frames: Vec::new(), values, sequence: (1, 1) }, outputs: Vec::new(), every: 1 }
    }

    /// Place of a quantity among the values, added if it is new.
    ///
    /// # Errors
    /// It has another name, and with it another unit; or another quantity has the name. In words.
    fn slot(&mut self, quantity: Quantity, name: String, (unit, factor): (&'static str, f64)) -> Result<usize, String> {
        if let Some(slot) = self.set.slot(&quantity) {
            let known = &self.set.values[slot].name;
            return match *known == name {
                true => Ok(slot),
                false => Err(format!("expected the unit of the other field, for the column {known}, got {name}")),
            };
        }
        let names = self.set.values.iter().map(|value| value.name.as_str()).chain(columns::all());
        if let Some(other) = names.into_iter().find(|other| other.eq_ignore_ascii_case(&name)) {
            return Err(format!("expected a name of its own, got {name} beside {other}"));
        }
        self.set.values.push(ValueSpec { quantity, name, unit, factor });
        Ok(self.set.values.len() - 1)
    }

    /// The field that `node` describes, at this place; `more` are keys that it may have beside its own.
    ///
    /// # Errors
    /// Unknown words; an output that another field carries already, or that is smaller than the range.
    pub fn field(
        &mut self,
        node: &Node,
        place: BitField,
        unstated: &Unstated,
        more: &[&str],
    ) -> Result<Field, ConfigurationError> {
        let keys: &[&str] = match node.keys().contains(&"head") {
            true => &["head", "of", "unit", "scale", "divisor", "offset"],
            false if node.text("value").is_ok_and(|value| value == "sequence") => &["value", "modulus", "step"],
            false => &["value", "unit", "scale", "divisor", "offset"],
        };
        node.only(&[keys, more].concat())?;
        let real = |key: &str, default: f64| {
            Ok::<f64, ConfigurationError>(node.value(key, ValueFormat::Real, -1e12, 1e12)?.unwrap_or(default))
        };
        let (scale, divisor, offset) =
            (real("scale", unstated.scale)?, real("divisor", 1.0)?, real("offset", unstated.offset)?);
        let key = if scale == 0.0 { "scale" } else { "divisor" };
        let scale = scale / divisor;
        if scale == 0.0 || !scale.is_finite() {
            return Err(node.unexpected(key, "a number that is not 0"));
        }
        let (quantity, stem, units) = self.carried(node)?;
        let key = if node.keys().contains(&"head") { "head" } else { "value" };
        let names: Vec<&str> = units.iter().map(|(name, _)| *name).collect();
        let (is_angle, is_rate) = (matches!(quantity, Quantity::Angle(_)), self.device.output == Output::Rate);
        let is_output = is_angle || matches!(quantity, Quantity::Output(_));
        let (unit, factor) = match node.keys().contains(&"unit") || is_output {
            true => {
                let unit = node.choice("unit", &names)?;
                units.iter().find(|(name, _)| *name == unit).copied().unwrap_or(units[0])
            }
            false => units[0],
        };
        if names.contains(&unstated.unit) && unstated.unit != unit {
            return Err(node.error("unit", format!("expected the unit of the database, {}, got {unit}", unstated.unit)));
        }
        if quantity == Quantity::Sequence {
            self.sequence(node, &place, (scale, offset))?;
        }
        let suffix = match unit {
            "count" => String::new(),
            "degC" => "_c".to_owned(),
            unit => format!("_{}", unit.replace('/', "_")),
        };
        let slot = self.slot(quantity, stem + &suffix, (unit, factor)).map_err(|message| node.error(key, message))?;
        if is_output && self.outputs.contains(&slot) {
            return Err(node.error("head", "expected one field for the output of a head, got another one".to_owned()));
        }
        if is_output {
            self.outputs.push(slot);
        }
        let field = Field::new(slot, place).scaled(scale, offset);
        let samples = if is_angle { f64::from(self.every) } else { 1.0 };
        let per_s = if is_rate && !is_angle { 1.0 } else { self.device.interval_s * samples };
        let range = self.device.range_arcsec_s * per_s;
        let (low, high) = field.limits();
        if is_output && (low * factor > -range || high * factor < range) {
            let message = format!(
                "expected a field for ±{} {unit}, the range of the unit, got one from {low} to {high} {unit}",
                range / factor
            );
            return Err(node.error("head", message));
        }
        Ok(field)
    }

    /// Quantity, name without unit, and possible units.
    fn carried(&self, node: &Node) -> Result<(Quantity, String, NamedUnits), ConfigurationError> {
        if node.keys().contains(&"head") {
            let name = node.text("head")?;
            let head = self.device.head(name).map_err(|message| node.error("head", message))?;
            let of = match node.keys().contains(&"of") {
                true => node.choice("of", &["output", "angle", "temperature"])?,
                false => "output",
            };
            return Ok(match (of, self.device.output) {
                ("temperature", _) => (Quantity::Temperature(head), format!("{name}_temperature"), TEMPERATURE_UNITS),
                ("angle", _) => (Quantity::Angle(head), format!("{name}_angle"), ANGLE_UNITS),
                (_, Output::Increment) => (Quantity::Output(head), name.to_owned(), ANGLE_UNITS),
                (_, Output::Rate) => (Quantity::Output(head), name.to_owned(), RATE_UNITS),
            });
        }
        let value = node.choice("value", &VALUES)?;
        let (quantity, units) = match value {
            "sequence" => (Quantity::Sequence, COUNT_UNITS),
            "clock_count" => (Quantity::ClockCount, COUNT_UNITS),
            "latency" => (Quantity::Latency, TIME_UNITS),
            "electronics" => (Quantity::Electronics, TEMPERATURE_UNITS),
            _ => (Quantity::Sensor, TEMPERATURE_UNITS),
        };
        Ok((quantity, value.to_owned(), units))
    }

    /// Takes the modulus and step of the sequence from a field.
    fn sequence(&mut self, node: &Node, place: &BitField, scaling: (f64, f64)) -> Result<(), ConfigurationError> {
        if place.coding != Coding::Unsigned || scaling != (1.0, 0.0) {
            let message = format!("expected a sequence in a whole number without sign and scale, got {place}");
            return Err(node.error("value", message));
        }
        let size = 1u64 << place.bits;
        let modulus = node.whole_number("modulus")?.unwrap_or(size);
        if !(2..=size).contains(&modulus) {
            return Err(node.unexpected("modulus", &format!("a whole number from 2 to {size}")));
        }
        let step = node.whole_number("step")?.unwrap_or(1);
        if step == 0 || !modulus.is_multiple_of(step) || step >= modulus {
            return Err(node.unexpected("step", &format!("a divisor of the modulus {modulus} below it")));
        }
        if self.set.sequence != (1, 1) && self.set.sequence != (modulus, step) {
            let (other, _) = self.set.sequence;
            let message = format!("expected the modulus of the other field, {other}, got {modulus}");
            return Err(node.error("value", message));
        }
        self.set.sequence = (modulus, step);
        Ok(())
    }

    /// Refuses a link in which a frame of every sample does not carry the outputs and the sequence.
    ///
    /// # Errors
    /// Such a link; the error points at `key`.
    pub fn check(&self, node: &Node, key: &str) -> Result<(), ConfigurationError> {
        let slots = |frame: &Frame| frame.fields.iter().map(|field| field.slot).collect::<Vec<_>>();
        for frame in &self.set.frames {
            let (own, other) = (slots(frame), frame.instead_of.map(|other| &self.set.frames[other]));
            if let Some(other) = other.filter(|other| slots(other).iter().any(|slot| !own.contains(slot))) {
                let (name, other) = (&frame.name, &other.name);
                let message = format!("expected all values of {other} in {name}, which comes instead of it, got fewer");
                return Err(node.error(key, message));
            }
        }
        let frames = self.set.frames.iter().filter(|frame| frame.every == 1);
        let carried: Vec<usize> = frames.flat_map(|frame| &frame.fields).map(|field| field.slot).collect();
        let has = |quantity: Quantity| self.set.slot(&quantity).is_some_and(|slot| carried.contains(&slot));
        if let Some(head) = (0..self.device.heads.len()).find(|head| !has(Quantity::Output(*head))) {
            let name = self.device.heads[head].gyro.name();
            let message =
                format!("expected a field for each head in a frame of every sample, got none for head {name}");
            return Err(node.error(key, message));
        }
        if self.set.sequence != (1, 1) && !has(Quantity::Sequence) {
            return Err(node.error(key, "expected the sequence in a frame of every sample, got a rarer one".to_owned()));
        }
        for (index, frame) in self.set.frames.iter().enumerate() {
            if self.set.frames[..index].iter().any(|other| other.name.eq_ignore_ascii_case(&frame.name)) {
                return Err(node.error(key, format!("expected frames of different names, got {} twice", frame.name)));
            }
            if let Some(name) = self.shared_bit(frame) {
                let message =
                    format!("expected content with bits of its own in {}, got {name} on bits of another", frame.name);
                return Err(node.error(key, message));
            }
            let constant = |frame: &Frame| {
                let (template, required) = (frame.template(), frame.required().to_vec());
                (frame.id, template.iter().zip(&required).map(|(own, mask)| own & mask).collect::<Vec<u8>>(), required)
            };
            if let Some(other) = self.set.frames[..index].iter().find(|other| constant(other) == constant(frame)) {
                let (one, other) = (&other.name, &frame.name);
                return Err(
                    node.error(key, format!("expected frames that differ in a constant, got {one} and {other}"))
                );
            }
        }
        Ok(())
    }

    /// Name of the first field or check that shares a bit with another one or with a constant.
    fn shared_bit<'f>(&'f self, frame: &'f Frame) -> Option<&'f str> {
        let mut used = frame.required().to_vec();
        let fields = frame.fields.iter().map(|field| (field.place, self.set.values[field.slot].name.as_str()));
        let checks = frame.checks.iter().map(|check| (check.place, check.name.as_str()));
        let shared = |(place, _): &(BitField, &str)| {
            let own = place.used(frame.length());
            let is_shared = used.iter().zip(&own).any(|(used, own)| used & own != 0);
            used.iter_mut().zip(own).for_each(|(used, own)| *used |= own);
            is_shared
        };
        fields.chain(checks).find(shared).map(|(_, name)| name)
    }

    /// Fields of the named bits of a word: `X_valid`, `X_invalid`, `X_saturated` of a head; any other name is a bit of the status.
    ///
    /// # Errors
    /// A bit that the word does not have.
    pub fn bits(&mut self, node: &Node, word: BitField) -> Result<Vec<Field>, ConfigurationError> {
        let mut fields = Vec::new();
        for name in node.keys() {
            let last = f64::from(word.bits - 1);
            let bit = node.value(name, ValueFormat::Whole, 0.0, last)?.unwrap_or_default();
            let head = |suffix: &str| name.strip_suffix(suffix).and_then(|head| self.device.head(head).ok());
            let (quantity, column, is_inverted) = match (head("_valid"), head("_invalid"), head("_saturated")) {
                (Some(head), ..) => (Quantity::Valid(head), name.to_owned(), false),
                (_, Some(head), _) => (Quantity::Valid(head), name.replace("_invalid", "_valid"), true),
                (.., Some(head)) => (Quantity::Saturated(head), name.to_owned(), false),
                _ if is_identifier(name) => (Quantity::Status(name.to_owned()), format!("status_{name}"), false),
                _ => {
                    return Err(
                        node.error(name, format!("expected a name of letters, digits and underscores, got {name:?}"))
                    );
                }
            };
            let slot = self.slot(quantity, column, ("", 1.0)).map_err(|message| node.error(name, message))?;
            let field = Field::new(slot, word.bits_of(bit as u32, 1));
            fields.push(if is_inverted { field.scaled(-1.0, 1.0) } else { field });
        }
        Ok(fields)
    }
}
