//! A frame: constants, fields and check values at fixed places.

use super::check::Check;
use super::number::{BitField, Coding};

/// A number that a frame carries.
#[derive(Debug, Clone)]
pub struct Field {
    /// Place of its value in a sample.
    pub slot: usize,
    pub place: BitField,
    /// Value of one unit of the number: `scale`, or 1 / `divisor` where that is exact.
    scale: f64,
    divisor: f64,
    /// Both as one factor, if it is exact.
    factor: Option<f64>,
    /// Value of the number 0.
    offset: f64,
}

impl Field {
    /// A field with the number as its value.
    pub fn new(slot: usize, place: BitField) -> Field {
        Field { slot, place, scale: 1.0, divisor: 1.0, factor: Some(1.0), offset: 0.0 }
    }

    /// Sets scale and offset. A scale such as 0.005 divides by 200, so that values are the nearest to their decimals.
    pub fn scaled(self, scale: f64, offset: f64) -> Field {
        let divisor = (1.0 / scale).round();
        let is_divided = divisor.abs() > 1.0 && 1.0 / divisor == scale;
        let (scale, divisor) = if is_divided { (1.0, divisor) } else { (scale, 1.0) };
        // The inverse of a power of two is exact.
        let is_power = divisor.to_bits() << (u64::BITS + 1 - f64::MANTISSA_DIGITS) == 0;
        Field { scale, divisor, factor: is_power.then_some(scale / divisor), offset, ..self }
    }

    /// Value of one unit of the number.
    pub fn scale(&self) -> f64 {
        self.scale / self.divisor
    }

    /// Scale, divisor and offset, in the order in which reading applies them.
    pub fn scaling(&self) -> (f64, f64, f64) {
        (self.scale, self.divisor, self.offset)
    }

    /// Factor and offset of reading.
    pub(super) fn reading(&self) -> Reading {
        Reading { factor: self.factor, divisor: self.divisor, offset: self.offset }
    }

    /// The value by the number on the wire, in words.
    pub fn formula(&self) -> String {
        let scale = if self.scale() == 1.0 { String::new() } else { format!(" × {:?}", self.scale()) };
        match self.offset {
            0.0 => format!("number{scale}"),
            offset if offset < 0.0 => format!("number{scale} − {:?}", -offset),
            offset => format!("number{scale} + {offset:?}"),
        }
    }

    /// The value in a frame.
    pub fn read(&self, bytes: &[u8]) -> f64 {
        self.value(self.place.read(bytes))
    }

    /// The value of a number on the wire.
    #[inline]
    pub fn value(&self, number: f64) -> f64 {
        self.reading().value(number)
    }

    #[inline]
    fn write(&self, value: f64, bytes: &mut [u8]) {
        // A value that is not known is sent as 0.
        let value = if value.is_nan() { 0.0 } else { value };
        self.place.write((value - self.offset) * self.divisor / self.scale, bytes);
    }

    /// True if its values are whole numbers, exact as real ones.
    pub fn is_whole(&self) -> bool {
        let (low, high) = self.limits();
        let is_exact = low.abs().max(high.abs()) < (1u64 << f64::MANTISSA_DIGITS) as f64;
        self.place.coding != Coding::Float && self.scale().fract() == 0.0 && self.offset.fract() == 0.0 && is_exact
    }

    /// Smallest and largest value.
    pub fn limits(&self) -> (f64, f64) {
        let (low, high) = self.place.limits();
        let value = |number: f64| number * self.scale() + self.offset;
        (value(low).min(value(high)), value(low).max(value(high)))
    }
}

/// Factor and offset from a number on the wire to its value.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reading {
    factor: Option<f64>,
    divisor: f64,
    offset: f64,
}

impl Reading {
    #[inline]
    pub fn value(self, number: f64) -> f64 {
        // A division takes longer than all the rest.
        self.factor.map_or_else(|| number / self.divisor, |factor| number * factor) + self.offset
    }
}

/// A frame on a serial line, or a message on CAN.
#[derive(Debug, Clone)]
pub struct Frame {
    pub name: String,
    /// Identifier on CAN; true if it has 29 bits.
    pub id: Option<(u32, bool)>,
    /// Number of samples from one such frame to the next.
    pub every: u32,
    /// Place of the frame in the list that this one comes instead of; where `every` is 1, it is read and not sent.
    pub instead_of: Option<usize>,
    /// Bytes before the fields are written: constants, and values of what this product does not carry.
    template: Vec<u8>,
    /// Bits of the template that a frame must have, and the byte after the last of them.
    required: Vec<u8>,
    required_end: usize,
    pub fields: Vec<Field>,
    pub checks: Vec<Check>,
}

impl Frame {
    /// A frame of zeros, sent with every sample.
    pub fn new(name: &str, length: usize) -> Frame {
        Frame {
            name: name.to_owned(),
            id: None,
            every: 1,
            instead_of: None,
            template: vec![0; length],
            required: vec![0; length],
            required_end: 0,
            fields: Vec::new(),
            checks: Vec::new(),
        }
    }

    /// Length, byte.
    pub fn length(&self) -> usize {
        self.template.len()
    }

    /// Requires these bytes.
    pub fn set_constant(&mut self, at: usize, bytes: &[u8]) {
        self.set_ignored(at, bytes);
        self.required[at..at + bytes.len()].fill(0xFF);
        self.required_end = self.required_end.max(at + bytes.len());
    }

    /// Sends these bytes, and ignores them when they are read.
    pub fn set_ignored(&mut self, at: usize, bytes: &[u8]) {
        self.template[at..at + bytes.len()].copy_from_slice(bytes);
    }

    /// Sends this number, and ignores it when it is read.
    pub fn set_number(&mut self, place: BitField, number: f64) {
        place.write(number, &mut self.template);
    }

    /// Requires these bits.
    pub fn set_selector(&mut self, place: BitField, bits: u64) {
        place.write_bits(bits, &mut self.template);
        place.write_bits(u64::MAX, &mut self.required);
        self.required_end = self.required_end.max(place.end());
    }

    /// Constant bytes at the start.
    pub fn start(&self) -> &[u8] {
        let length = self.required.iter().take_while(|required| **required == 0xFF).count();
        &self.template[..length]
    }

    /// Bytes of the frame where no field is.
    pub fn template(&self) -> &[u8] {
        &self.template
    }

    /// Bits of these that a frame must have.
    pub fn required(&self) -> &[u8] {
        &self.required
    }

    /// Appends the frame of a sample.
    pub fn write(&self, values: &[f64], out: &mut Vec<u8>) {
        let start = out.len();
        out.extend_from_slice(&self.template);
        let bytes = &mut out[start..];
        self.fields.iter().for_each(|field| field.write(values[field.slot], bytes));
        self.checks.iter().for_each(|check| check.write(bytes));
    }

    /// True if the bytes have the frame's length and constants.
    #[inline]
    pub fn has_constants(&self, bytes: &[u8]) -> bool {
        let own = self.template.iter().zip(&self.required[..self.required_end]);
        let wrong = bytes.iter().zip(own).fold(0, |wrong, (byte, (own, required))| wrong | (byte ^ own) & required);
        bytes.len() == self.template.len() && wrong == 0
    }

    /// Runs of bytes in which no field or check has a bit: the first byte, the bytes, and true for a constant.
    pub fn other_bytes(&self) -> Vec<(usize, &[u8], bool)> {
        let mut used = vec![0; self.length()];
        let places = self.fields.iter().map(|field| field.place).chain(self.checks.iter().map(|check| check.place));
        places.for_each(|place| used.iter_mut().zip(place.used(self.length())).for_each(|(used, own)| *used |= own));
        let kind = |at: &usize| (used[*at] == 0, self.required[*at] == 0xFF);
        let all: Vec<usize> = (0..self.length()).collect();
        let runs = all.chunk_by(|one, next| kind(one) == kind(next)).filter(|run| kind(&run[0]).0);
        runs.map(|run| (run[0], &self.template[run[0]..run[0] + run.len()], kind(&run[0]).1)).collect()
    }

    /// Bytes with constant bits beside others: the byte, its constant bits, and their values.
    pub fn constant_bits(&self) -> impl Iterator<Item = (usize, u8, u8)> {
        let bytes = self.template.iter().zip(&self.required).enumerate();
        bytes.filter(|(_, (_, bits))| !matches!(bits, 0 | 0xFF)).map(|(at, (own, bits))| (at, *bits, own & bits))
    }

    /// True if a check covers every field.
    pub fn is_covered(&self) -> bool {
        let covers = |at: usize| self.checks.iter().any(|check| check.covers.contains(&at));
        self.fields.iter().all(|field| (field.place.at..field.place.end()).all(covers))
    }

    /// True if all check values are right.
    #[inline]
    pub fn checks_hold(&self, bytes: &[u8]) -> bool {
        self.checks.iter().all(|check| check.holds(bytes))
    }

    /// Reads the fields of a frame of the right length.
    #[inline]
    pub fn read(&self, bytes: &[u8], values: &mut [f64]) {
        self.fields.iter().for_each(|field| values[field.slot] = field.read(bytes));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::Number;

    #[test]
    fn values_of_a_decimal_scale_are_the_nearest_to_their_decimals() {
        let place = BitField::bytes(0, Number::from_name("u16be").unwrap());
        let field = Field::new(0, place).scaled(0.005, -163.84);
        assert_eq!((field.divisor, field.scale()), (200.0, 0.005));
        for number in 0..=u16::MAX {
            let bytes = number.to_be_bytes();
            let mut again = [0; 2];
            field.write(field.read(&bytes), &mut again);
            assert_eq!(again, bytes);
        }
        let plain = Field::new(0, place).scaled(0.005, 0.0);
        assert_eq!(plain.read(&[0, 70]), 0.35);
        assert_eq!(Field::new(0, place).scaled(-2.5, 0.0).read(&[0, 2]), -5.0);
        assert_eq!(field.limits(), (-163.84, 65535.0 * 0.005 - 163.84));
    }

    #[test]
    fn a_required_bit_is_required_and_an_ignored_byte_is_not() {
        let mut frame = Frame::new("F", 3);
        frame.set_constant(0, &[0xA5]);
        frame.set_ignored(1, &[7]);
        frame.set_selector(BitField::bytes(2, Number::from_name("u8").unwrap()).bits_of(0, 4), 3);
        assert_eq!(frame.start(), [0xA5]);
        let mut bytes = Vec::new();
        frame.write(&[], &mut bytes);
        assert_eq!(bytes, [0xA5, 7, 3]);
        assert!(frame.has_constants(&[0xA5, 9, 0xF3]));
        assert!(!frame.has_constants(&[0xA5, 7, 2]) && !frame.has_constants(&[0xA4, 7, 3]));
        assert!(!frame.has_constants(&[0xA5, 7]));
    }
}
