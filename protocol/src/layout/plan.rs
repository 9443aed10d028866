//! Fields of a frame as steps: a load of eight bytes, two shifts, scale and offset; or a bit.

use super::frame::{Field, Reading};
use super::number::Coding;

/// Reads the fields of frames of one length.
#[derive(Debug, Clone)]
pub(super) struct FieldPlan {
    numbers: Vec<NumberStep>,
    /// Fields of other numbers, and of frames of less than eight bytes.
    others: Vec<Field>,
    /// Bits: slot, byte and number of the bit in it, and the values of 0 and 1.
    bits: Vec<(usize, usize, u32, [f64; 2])>,
}

/// A whole number of less than 64 bits.
#[derive(Debug, Clone)]
struct NumberStep {
    slot: usize,
    /// First of eight bytes with the number.
    at: usize,
    is_little_endian: bool,
    /// Bits of these bytes above the number, and 64 minus its width.
    left: u32,
    right: u32,
    /// The bit of the sign, or 0.
    sign: u64,
    reading: Reading,
}

impl FieldPlan {
    /// The fields of a frame of this length.
    pub fn new(fields: &[Field], length: usize) -> FieldPlan {
        // The last field of a value gives it.
        let is_last = |(index, field): &(usize, &Field)| fields[index + 1..].iter().all(|next| next.slot != field.slot);
        let fields = fields.iter().enumerate().filter(is_last).map(|(_, field)| field);
        let is_bit = |field: &&Field| field.place.bits == 1 && field.place.coding == Coding::Unsigned;
        let (bits, numbers): (Vec<&Field>, Vec<&Field>) = fields.partition(is_bit);
        let bit = |field: &Field| {
            let (place, byte) = (field.place, field.place.shift() as usize / 8);
            let at = if place.is_little_endian() { place.at + byte } else { place.end() - 1 - byte };
            (field.slot, at, place.shift() % 8, [0.0, 1.0].map(|number| field.value(number)))
        };
        let last = length.checked_sub(size_of::<u64>());
        let number = |field: &Field| {
            let (place, at) = (field.place, field.place.at.min(last.unwrap_or_default()));
            let before = if place.is_little_endian() { place.at - at } else { at + 8 - place.end() };
            NumberStep {
                slot: field.slot,
                at,
                is_little_endian: place.is_little_endian(),
                left: u64::BITS - 8 * before as u32 - place.shift() - place.bits,
                right: u64::BITS - place.bits,
                sign: u64::from(place.coding == Coding::Signed) << (place.bits - 1),
                reading: field.reading(),
            }
        };
        let is_whole = |field: &&Field| field.place.coding != Coding::Float && field.place.bits < u64::BITS;
        let (whole, others): (Vec<&Field>, Vec<&Field>) =
            numbers.into_iter().partition(|field| last.is_some() && is_whole(field));
        FieldPlan {
            numbers: whole.into_iter().map(number).collect(),
            others: others.into_iter().cloned().collect(),
            bits: bits.into_iter().map(bit).collect(),
        }
    }

    /// Reads the fields of a frame of that length.
    #[inline]
    pub fn read(&self, bytes: &[u8], values: &mut [f64]) {
        for step in &self.numbers {
            let own = bytes[step.at..step.at + size_of::<u64>()].try_into().expect("eight bytes");
            let word = if step.is_little_endian { u64::from_le_bytes(own) } else { u64::from_be_bytes(own) };
            let bits = word << step.left >> step.right;
            values[step.slot] = step.reading.value((bits ^ step.sign).wrapping_sub(step.sign) as i64 as f64);
        }
        for field in &self.others {
            values[field.slot] = field.read(bytes);
        }
        for (slot, at, shift, own) in &self.bits {
            values[*slot] = own[usize::from(bytes[*at] >> shift & 1)];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::{BitField, Number};
    use proptest::prelude::*;

    fn place() -> impl Strategy<Value = BitField> {
        let coding = prop_oneof![Just(Coding::Signed), Just(Coding::Unsigned)];
        let signal = (0usize..64, 1usize..=64, any::<bool>(), coding);
        let of_signal = |(start, bits, is_little, coding)| BitField::signal(start, bits, is_little, coding);
        let numbers: Vec<Number> = Number::all().collect();
        let at = (0usize..12, proptest::sample::select(numbers)).prop_map(|(at, number)| BitField::bytes(at, number));
        prop_oneof![signal.prop_filter_map("in eight bytes", of_signal), at]
    }

    proptest! {
        #[test]
        fn a_plan_reads_what_the_field_reads(
            place in place(), bytes: [u8; 24], more in 0usize..4, divisor in prop_oneof![-1000i32..-1, 1i32..70_000], is_scaled: bool,
        ) {
            let scale = if is_scaled { 1.0 / f64::from(divisor) } else { f64::from(divisor) / 3.0 };
            let field = Field::new(0, place).scaled(scale, if is_scaled { 0.0 } else { -40.0 });
            let bytes = &bytes[..place.end() + more];
            let mut values = [f64::NAN];
            FieldPlan::new(std::slice::from_ref(&field), bytes.len()).read(bytes, &mut values);
            prop_assert!(values[0] == field.read(bytes) || field.read(bytes).is_nan() && values[0].is_nan());
        }
    }
}
