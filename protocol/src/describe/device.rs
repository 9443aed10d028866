//! Descriptions of any unit's wire: C header, dissector, document.

use crate::hex::spaced_hex;
use crate::layout::{Check, Coding, CrcParameters, Field, Frame, FrameSet};
use crate::map;
use crate::template::{Value, engine, filled};

/// A unit with its links.
#[derive(Debug)]
pub struct Wire<'a> {
    /// Name in identifiers of programs, of letters, digits and underscores.
    pub prefix: &'a str,
    pub title: &'a str,
    pub source: &'a str,
    /// Name and unit vector of each head's input axis.
    pub heads: Vec<(&'a str, [f64; 3])>,
    /// In words: output, interval, range.
    pub output: String,
    /// Largest output, arcsec or arcsec/s.
    pub range: f64,
    /// Names of the links, their rates, and their frames.
    pub links: Vec<(&'a str, u32, &'a FrameSet)>,
}

impl Wire<'_> {
    /// The header for on-board software, in C.
    pub fn header(&self) -> String {
        filled(&engine(), include_str!("device.h"), &self.tables())
    }

    /// The dissector for Wireshark.
    pub fn dissector(&self) -> String {
        filled(&engine(), include_str!("device.lua"), &self.tables())
    }

    /// The interface control document.
    pub fn icd(&self) -> String {
        filled(&engine(), include_str!("device.md"), &self.tables())
    }

    fn tables(&self) -> Value {
        let heads = self.heads.iter().map(|(name, axis)| {
            map! { name: *name, axis: axis.map(|part| format!("{part:.6}")).join(", ") }
        });
        let links = self.links.iter().map(|(name, rate, set)| {
            map! { name: *name, rate: *rate, is_can: set.frames.iter().any(|frame| frame.id.is_some()),
            frames: set.frames.iter().map(|own| frame(own, set)).collect::<Value>() }
        });
        let values = self.links.first().map(|(.., set)| &set.values[..]).unwrap_or_default();
        let values = values.iter().map(|value| map! { name: value.name.clone() });
        map! { prefix: self.prefix, title: plain(self.title), source: plain(self.source), output: self.output.clone(),
        heads: heads.collect::<Value>(), values: values.collect::<Value>(), links: links.collect::<Value>() }
    }
}

/// A text that ends neither a comment nor a string of a program.
pub(super) fn plain(text: &str) -> String {
    text.replace(['"', '\\'], "'").replace("*/", "* /").replace(char::is_control, " ")
}

fn frame(frame: &Frame, set: &FrameSet) -> Value {
    let listed = |bytes: &[u8]| bytes.iter().map(u8::to_string).collect::<Vec<_>>().join(", ");
    let (id, is_extended) = frame.id.unwrap_or_default();
    let fields = frame.fields.iter().map(|own| field(own, &set.values[own.slot].name));
    let others = frame.other_bytes().into_iter().map(|(at, bytes, is_constant)| {
        map! { at: at as u32, text: spaced_hex(bytes), kind: if is_constant { "constant" } else { "ignored" } }
    });
    let bits = frame.constant_bits().map(|(at, bits, own)| {
        map! { at: at as u32, text: format!("{own:02X} in the bits {bits:02X}"), kind: "constant" }
    });
    let others = others.chain(bits);
    map! { name: frame.name.clone(), others: others.collect::<Value>(), id: id, is_extended: is_extended, length: frame.length() as u32, cadence: set.cadence(frame),
    template: listed(frame.template()), required: listed(frame.required()),
    fields: fields.collect::<Value>(), checks: frame.checks.iter().map(|own| check(own, frame)).collect::<Value>() }
}

/// A number that a program can hold exactly.
fn exact(number: f64) -> String {
    format!("{number:?}")
}

fn field(field: &Field, name: &str) -> Value {
    let place = field.place;
    let (scale, divisor, offset) = field.scaling();
    let coding = match place.coding {
        Coding::Unsigned => "UNSIGNED",
        Coding::Signed => "SIGNED",
        Coding::Float => "FLOAT",
    };
    map! { name: name, at: place.at as u32, length: place.length as u32, type: place.to_string(),
    is_little_endian: place.is_little_endian(), shift: place.shift(), bits: place.bits, coding: coding,
    scale: exact(scale), divisor: exact(divisor), offset: exact(offset), formula: field.formula() }
}

fn check(check: &Check, frame: &Frame) -> Value {
    let place = check.place;
    let hex = |number: u64| format!("0x{number:X}");
    let crc = check.parameters().unwrap_or(CrcParameters { width: 0, ..CrcParameters::default() });
    map! { text: check.in_words(frame.length()), at: place.at as u32, length: place.length as u32, type: place.to_string(),
    is_little_endian: place.is_little_endian(), shift: place.shift(), bits: place.bits, from: check.covers.start as u32,
    to: check.covers.end as u32, pad_to: check.pad_to() as u32,
    suffix: check.suffix.iter().map(|byte| u32::from(*byte)).collect::<Value>(), suffix_list: check.suffix.iter().map(u8::to_string).collect::<Vec<_>>().join(", "),
    width: crc.width, polynomial: hex(crc.polynomial), initial: hex(crc.initial), reflects_input: crc.reflects_input,
    reflects_output: crc.reflects_output, final_xor: hex(crc.final_xor),
    is_negated: check.name.starts_with("negated-"),
    kind: if crc.width > 0 { "CRC".to_owned() } else { check.name.trim_start_matches("negated-").to_uppercase().replace('-', "_") } }
}
