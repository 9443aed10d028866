//! Numbers in bytes: of whole bytes as on a serial line, or of any bits as on CAN.

/// Encoding of a number's bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Coding {
    Unsigned,
    /// Two's complement.
    Signed,
    /// IEEE 754, 32 or 64 bits.
    Float,
}

/// Type of a number of whole bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Number {
    pub coding: Coding,
    /// 1 to 8.
    pub length: usize,
    pub is_little_endian: bool,
}

impl Number {
    /// Longest type of whole numbers, bit.
    const MAX_BITS: usize = 48;

    /// All types.
    pub fn all() -> impl Iterator<Item = Number> {
        let whole = (1..=Number::MAX_BITS / 8)
            .flat_map(|length| [Coding::Unsigned, Coding::Signed].map(|coding| (coding, length)));
        let types = whole.filter(|(_, length)| *length != 5).chain([4, 8].map(|length| (Coding::Float, length)));
        types.flat_map(|(coding, length)| {
            let orders = if length == 1 { &[false][..] } else { &[false, true] };
            orders.iter().map(move |&is_little_endian| Number { coding, length, is_little_endian })
        })
    }

    /// The type of that name: `u8`, `i24be`, `f32le` and so on.
    pub fn from_name(name: &str) -> Option<Number> {
        Number::all().find(|number| number.name() == name)
    }

    /// Name, as in [`Number::from_name`].
    pub fn name(self) -> String {
        let coding = match self.coding {
            Coding::Unsigned => 'u',
            Coding::Signed => 'i',
            Coding::Float => 'f',
        };
        let order = match self.length {
            1 => "",
            _ if self.is_little_endian => "le",
            _ => "be",
        };
        format!("{coding}{}{order}", 8 * self.length)
    }
}

/// Place of a number in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BitField {
    /// First byte, and number of bytes, at most 8.
    pub at: usize,
    pub length: usize,
    is_little_endian: bool,
    /// Bits of these bytes below the number's lowest.
    shift: u32,
    /// Width, bit.
    pub bits: u32,
    pub coding: Coding,
}

impl BitField {
    /// A number of whole bytes from byte `at` on.
    pub fn bytes(at: usize, number: Number) -> BitField {
        let Number { coding, length, is_little_endian } = number;
        BitField { at, length, is_little_endian, shift: 0, bits: 8 * length as u32, coding }
    }

    /// Bits of a number of whole bytes, the lowest of which has the number `bit`.
    pub fn bits_of(self, bit: u32, bits: u32) -> BitField {
        BitField { shift: self.shift + bit, bits, coding: Coding::Unsigned, ..self }
    }

    /// A signal of a CAN database: `start` is the lowest bit of a little-endian signal, the highest of a big-endian one, counted from
    /// bit 0 of byte 0. `None` for more than 8 bytes.
    pub fn signal(start: usize, bits: usize, is_little_endian: bool, coding: Coding) -> Option<BitField> {
        if !(1..=64).contains(&bits) || start >= 64 {
            return None;
        }
        let (at, shift, length) = if is_little_endian {
            (start / 8, start % 8, (start % 8 + bits).div_ceil(8))
        } else {
            let before = 7 - start % 8;
            let length = (before + bits).div_ceil(8);
            (start / 8, 8 * length - before - bits, length)
        };
        let place = BitField { at, length, is_little_endian, shift: shift as u32, bits: bits as u32, coding };
        (length <= 8).then_some(place)
    }

    pub fn is_little_endian(&self) -> bool {
        self.is_little_endian
    }

    /// Bits of the bytes below the number's lowest.
    pub fn shift(&self) -> u32 {
        self.shift
    }

    /// The byte after the last.
    pub fn end(&self) -> usize {
        self.at + self.length
    }

    /// First bit, counted from the highest bit of byte 0, where the number is one run of bits from the highest to the lowest or
    /// whole bytes; `None` for other little-endian bits.
    pub fn first_bit(&self) -> Option<usize> {
        let (low, high) = (self.shift as usize, (self.shift + self.bits) as usize);
        let is_whole = low.is_multiple_of(8) && high.is_multiple_of(8);
        match self.is_little_endian {
            false => Some(8 * self.end() - high),
            true if low / 8 == (high - 1) / 8 => Some(8 * (self.at + 2 * (low / 8) + 1) - high),
            true => is_whole.then_some(8 * self.at + low),
        }
    }

    fn mask(&self) -> u64 {
        u64::MAX >> (64 - self.bits)
    }

    #[inline]
    fn gather(&self, bytes: &[u8]) -> u64 {
        let own = &bytes[self.at..self.at + self.length];
        let next = |word: u64, byte: &u8| word << 8 | u64::from(*byte);
        if self.is_little_endian { own.iter().rev().fold(0, next) } else { own.iter().fold(0, next) }
    }

    /// The bits, as an unsigned number.
    #[inline]
    pub fn read_bits(&self, bytes: &[u8]) -> u64 {
        self.gather(bytes) >> self.shift & self.mask()
    }

    /// Writes the lowest bits of `bits`; the other bits of the bytes stay.
    #[inline]
    pub fn write_bits(&self, bits: u64, bytes: &mut [u8]) {
        let word = self.gather(bytes) & !(self.mask() << self.shift) | (bits & self.mask()) << self.shift;
        for index in 0..self.length {
            let place = if self.is_little_endian { index } else { self.length - 1 - index };
            bytes[self.at + place] = (word >> (8 * index)) as u8;
        }
    }

    /// Longest whole number, bit, that a real number of 64 bits holds exactly.
    pub const MAX_EXACT_BITS: u32 = 53;

    /// The number; a whole one is exact up to [`BitField::MAX_EXACT_BITS`].
    #[inline]
    pub fn read(&self, bytes: &[u8]) -> f64 {
        let bits = self.read_bits(bytes);
        match self.coding {
            Coding::Unsigned => bits as f64,
            Coding::Signed => ((bits << (64 - self.bits)) as i64 >> (64 - self.bits)) as f64,
            Coding::Float if self.bits == 32 => f32::from_bits(bits as u32).into(),
            Coding::Float => f64::from_bits(bits),
        }
    }

    /// Writes the nearest number within the limits, halves away from zero.
    #[inline]
    pub fn write(&self, value: f64, bytes: &mut [u8]) {
        let bits = match self.coding {
            Coding::Float if self.bits == 32 => u64::from((value as f32).to_bits()),
            Coding::Float => value.to_bits(),
            _ => {
                let (low, high) = self.limits();
                let whole = value.round().clamp(low, high);
                if self.coding == Coding::Unsigned { whole as u64 } else { whole as i64 as u64 }
            }
        };
        self.write_bits(bits, bytes);
    }

    /// Smallest and largest number.
    pub fn limits(&self) -> (f64, f64) {
        let size = 2f64.powi(self.bits as i32);
        match self.coding {
            Coding::Unsigned => (0.0, size - 1.0),
            Coding::Signed => (-size / 2.0, size / 2.0 - 1.0),
            Coding::Float if self.bits == 32 => (f32::MIN.into(), f32::MAX.into()),
            Coding::Float => (f64::MIN, f64::MAX),
        }
    }

    /// Bits that this number uses of a frame, one for each, from bit 0 of byte 0 on.
    pub fn used(&self, length: usize) -> Vec<u8> {
        let mut used = vec![0; length.max(self.end())];
        self.write_bits(u64::MAX, &mut used);
        used
    }
}

impl std::fmt::Display for BitField {
    /// Writes the type, or the bits.
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let BitField { length, is_little_endian, coding, .. } = *self;
        let number = Number { coding, length, is_little_endian };
        let of = if length > 1 {
            format!(" of {}", Number { coding: Coding::Unsigned, ..number }.name())
        } else {
            String::new()
        };
        let sign = if coding == Coding::Signed { ", signed" } else { "" };
        match self.bits {
            bits if bits as usize == 8 * length => f.write_str(&number.name()),
            1 => write!(f, "bit {}{of}", self.shift),
            bits => write!(f, "bits {} to {}{of}{sign}", self.shift, self.shift + bits - 1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn names_of_types_give_the_type_and_back() {
        for name in ["u8", "i8", "u16be", "i16le", "u24be", "i24le", "u32be", "i32be", "u48be", "f32le", "f64be"] {
            assert_eq!(Number::from_name(name).map(Number::name).as_deref(), Some(name));
        }
        for name in ["", "u", "u16", "u8be", "i12be", "u64be", "f16be", "x8", "u8le ", "f32", "u+8", "é8"] {
            assert_eq!(Number::from_name(name), None, "{name}");
        }
    }

    #[test]
    fn signals_have_the_bits_that_cantools_gives_them() {
        // cantools 45: 3|12@0+, 52|12@1-, 17|10@0+ of these bytes.
        let bytes = [0x12, 0x34, 0x56, 0x78, 0x9A, 0xBC, 0xDE, 0xF0];
        let read =
            |start, bits, is_little, coding| BitField::signal(start, bits, is_little, coding).unwrap().read(&bytes);
        assert_eq!(read(3, 12, false, Coding::Unsigned), f64::from(0x234));
        assert_eq!(read(52, 12, true, Coding::Signed), f64::from(0xF0D_i32 - 0x1000));
        assert_eq!(read(17, 10, false, Coding::Unsigned), f64::from(0b10_0111_1000));
        assert_eq!(BitField::signal(3, 64, false, Coding::Unsigned), None);
    }

    #[test]
    fn the_first_bit_is_counted_from_the_highest_bit_of_the_first_byte() {
        let first = |name, bit, bits| {
            let number = BitField::bytes(3, Number::from_name(name).unwrap());
            if bits == 0 { number.first_bit() } else { number.bits_of(bit, bits).first_bit() }
        };
        assert_eq!([first("i24be", 0, 0), first("i24le", 0, 0)], [Some(24); 2]);
        assert_eq!([first("u16be", 4, 10), first("u32be", 31, 1)], [Some(26), Some(24)]);
        assert_eq!(
            [first("u16le", 15, 1), first("u16le", 0, 2), first("u32le", 8, 16)],
            [Some(32), Some(30), Some(32)]
        );
        assert_eq!(first("u16le", 4, 10), None);
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_and_the_other_bits_stay(
            start in 0usize..64, bits in 1usize..=48, is_little: bool, is_signed: bool, value: i64, fill: [u8; 16],
        ) {
            let coding = if is_signed { Coding::Signed } else { Coding::Unsigned };
            let Some(place) = BitField::signal(start, bits, is_little, coding) else { return Ok(()) };
            let (low, high) = place.limits();
            let value = (value >> (64 - bits)) as f64;
            let value = value.clamp(low, high);
            let mut bytes = fill;
            place.write(value, &mut bytes);
            prop_assert_eq!(place.read(&bytes), value);
            for (index, used) in place.used(16).into_iter().enumerate() {
                prop_assert_eq!(bytes[index] & !used, fill[index] & !used);
            }
            place.write(high + 1.0, &mut bytes);
            prop_assert_eq!(place.read(&bytes), high);
        }
    }
}
