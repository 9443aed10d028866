//! What a field carries: a head's output, another value of the sample, or a bit of a status word.

use geu_protocol::layout::{BitField, Coding, Field, FrameSet, Quantity, ValueSpec};

use super::{Device, Output};
use crate::configuration::{ConfigurationError, Node};
use crate::parameter_spec::ValueFormat;
use crate::units::{ARCSEC_PER_DEG, ARCSEC_PER_RAD, S_PER_H};

/// Units of a value, with the size of one.
type Units = &'static [(&'static str, f64)];

/// Units of an increment, arcsec.
const ANGLES: Units =
    &[("arcsec", 1.0), ("deg", ARCSEC_PER_DEG), ("rad", ARCSEC_PER_RAD), ("mrad", ARCSEC_PER_RAD * 1e-3)];
/// Units of a rate, arcsec/s.
const RATES: Units = &[
    ("arcsec/s", 1.0),
    ("deg/s", ARCSEC_PER_DEG),
    ("deg/h", ARCSEC_PER_DEG / S_PER_H),
    ("rad/s", ARCSEC_PER_RAD),
    ("mrad/s", ARCSEC_PER_RAD * 1e-3),
];
const TEMPERATURES: Units = &[("degC", 1.0)];
const TIMES: Units = &[("s", 1.0), ("ms", 1e-3), ("us", 1e-6)];
const COUNTS: Units = &[("count", 1.0)];

/// Words of a `value`.
const VALUES: [&str; 5] = ["sequence", "clock_count", "latency", "electronics", "sensor"];
/// Keys of a field that carries something.
pub const KEYS: [&str; 8] = ["head", "value", "of", "unit", "scale", "offset", "modulus", "step"];

/// Collects the fields of a link.
pub struct Fields<'a> {
    pub device: &'a Device,
    pub set: FrameSet,
}

impl<'a> Fields<'a> {
    pub fn new(device: &'a Device) -> Fields<'a> {
        Fields { device, set: FrameSet { frames: Vec::new(), values: Vec::new(), sequence: (1, 1) } }
    }

    /// BitField of a quantity among the values, added if it is new.
    fn slot(&mut self, quantity: Quantity, name: String, factor: f64) -> usize {
        self.set.slot(&quantity).unwrap_or_else(|| {
            self.set.values.push(ValueSpec { quantity, name, factor });
            self.set.values.len() - 1
        })
    }

    /// The field that `node` describes, at this place. `scale` and `offset` hold where it has none.
    ///
    /// # Errors
    /// Unknown words; an output that another field carries already, or that is smaller than the range.
    pub fn field(
        &mut self,
        node: &Node,
        place: BitField,
        (scale, offset): (f64, f64),
    ) -> Result<Field, ConfigurationError> {
        let real = |key: &str, default: f64| {
            Ok::<f64, ConfigurationError>(node.value(key, ValueFormat::Real, -1e12, 1e12)?.unwrap_or(default))
        };
        let (scale, offset) = (real("scale", scale)?, real("offset", offset)?);
        if scale == 0.0 {
            return Err(node.unexpected("scale", "a number that is not 0"));
        }
        let (quantity, stem, units) = self.carried(node)?;
        let names: Vec<&str> = units.iter().map(|(name, _)| *name).collect();
        let (unit, factor) = match node.keys().contains(&"unit") || matches!(quantity, Quantity::Output(_)) {
            true => {
                let unit = node.choice("unit", &names)?;
                (unit, units.iter().find(|(name, _)| *name == unit).map_or(1.0, |(_, factor)| *factor))
            }
            false => units[0],
        };
        if quantity == Quantity::Sequence {
            self.set.sequence = self.sequence(node, &place)?;
        }
        let is_output = matches!(quantity, Quantity::Output(_));
        if is_output && self.set.slot(&quantity).is_some() {
            return Err(node.error("head", "expected one field for the output of a head, got another one".to_owned()));
        }
        let suffix = match unit {
            "count" => String::new(),
            "degC" => "_c".to_owned(),
            unit => format!("_{}", unit.replace('/', "_")),
        };
        let field = Field::new(self.slot(quantity, stem + &suffix, factor), place).scaled(scale, offset);
        let range = match self.device.output {
            Output::Increment => self.device.range_arcsec_s * self.device.interval_s,
            Output::Rate => self.device.range_arcsec_s,
        };
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
    fn carried(&self, node: &Node) -> Result<(Quantity, String, Units), ConfigurationError> {
        if node.keys().contains(&"head") {
            let name = node.text("head")?;
            let head = self.device.head(name).map_err(|message| node.error("head", message))?;
            let of = match node.keys().contains(&"of") {
                true => node.choice("of", &["output", "temperature"])?,
                false => "output",
            };
            return Ok(match (of, self.device.output) {
                ("temperature", _) => (Quantity::Temperature(head), format!("{name}_temperature"), TEMPERATURES),
                (_, Output::Increment) => (Quantity::Output(head), name.to_owned(), ANGLES),
                (_, Output::Rate) => (Quantity::Output(head), name.to_owned(), RATES),
            });
        }
        let value = node.choice("value", &VALUES)?;
        let (quantity, units) = match value {
            "sequence" => (Quantity::Sequence, COUNTS),
            "clock_count" => (Quantity::ClockCount, COUNTS),
            "latency" => (Quantity::Latency, TIMES),
            "electronics" => (Quantity::Electronics, TEMPERATURES),
            _ => (Quantity::Sensor, TEMPERATURES),
        };
        Ok((quantity, value.to_owned(), units))
    }

    /// Modulus and step of the sequence in a field.
    fn sequence(&self, node: &Node, place: &BitField) -> Result<(u64, u64), ConfigurationError> {
        let whole = place.coding == Coding::Unsigned;
        let size = 1u64 << place.bits.min(53);
        let modulus = node.whole_number("modulus")?.unwrap_or(size);
        if !whole || !(2..=size).contains(&modulus) {
            return Err(
                node.unexpected("modulus", &format!("a field without sign, and a whole number from 2 to {size}"))
            );
        }
        let step = node.whole_number("step")?.unwrap_or(1);
        match step > 0 && modulus.is_multiple_of(step) && step < modulus {
            true => Ok((modulus, step)),
            false => Err(node.unexpected("step", &format!("a divisor of the modulus {modulus} below it"))),
        }
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
            let (quantity, is_inverted) = match (head("_valid"), head("_invalid"), head("_saturated")) {
                (Some(head), ..) => (Quantity::Valid(head), false),
                (_, Some(head), _) => (Quantity::Valid(head), true),
                (.., Some(head)) => (Quantity::Saturated(head), false),
                _ => (Quantity::Status(name.to_owned()), false),
            };
            let column = if is_inverted { name.replace("_invalid", "_valid") } else { name.to_owned() };
            let field = Field::new(self.slot(quantity, column, 1.0), word.bits_of(bit as u32, 1));
            fields.push(if is_inverted { field.scaled(-1.0, 1.0) } else { field });
        }
        Ok(fields)
    }
}
