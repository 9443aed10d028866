//! Check values: the catalogue of parametrised CRC algorithms, sums and exclusive-ors.

use std::fmt::{self, Debug, Formatter};
use std::ops::Range;
use std::sync::Arc;

use ::crc::{self, Crc, Table};

use super::crc_catalogue::{crc_algorithm, crc_algorithms};
use super::number::BitField;
use crate::hex::spaced_hex;

/// Value of a CRC of these parts.
type Run = dyn Fn(&[&[u8]]) -> u32 + Send + Sync;

/// An algorithm ready to run.
enum Engine {
    Crc(CrcParameters, Box<Run>, ByteTables),
    /// A sum; true for its two's complement.
    Sum(Sum, bool),
}

/// Sums and exclusive-ors; their names are in [`SUMS`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sum {
    /// Sum of bytes, modulo the field's width.
    Bytes,
    /// Sum of words of 16 bits, of which this byte is the higher one.
    Words(usize),
    /// Sum of bytes in the first byte, sum of these sums in the second, as u-blox and MicroStrain send it.
    Fletcher,
    Xor,
}

impl Sum {
    /// The sum of all bytes of the parts.
    fn sum(self, parts: &[&[u8]]) -> u64 {
        let bytes = parts.iter().copied().flatten().map(|byte| u64::from(*byte));
        match self {
            Sum::Bytes => bytes.sum(),
            Sum::Words(high) => bytes.enumerate().map(|(count, byte)| byte << (8 * ((count + high + 1) % 2))).sum(),
            Sum::Fletcher => {
                let (first, second) = bytes.fold((0, 0), |(first, second), byte| (first + byte, second + first + byte));
                (first & 0xFF) << 8 | second & 0xFF
            }
            Sum::Xor => bytes.fold(0, |sum, byte| sum ^ byte),
        }
    }
}

/// A CRC of few bytes as the exclusive-or of a table's entry for each: no step waits for the one before.
struct ByteTables {
    /// Changes of the value by a byte, the last byte's last.
    changes: Vec<[u32; 256]>,
    /// Values of as many zeros.
    of_zeros: Vec<u32>,
}

impl ByteTables {
    /// The tables of this CRC up to a number of bytes.
    fn new(run: &Run, length: usize) -> ByteTables {
        // The tables of more bytes would leave the processor's fast memory.
        let mut bytes = [0; 64];
        let of_zeros: Vec<u32> = (0..=length.min(bytes.len())).map(|length| run(&[&bytes[..length]])).collect();
        let mut changes = vec![[0; 256]; of_zeros.len() - 1];
        for (table, length) in changes.iter_mut().rev().zip(1..) {
            for byte in 1..256usize {
                bytes[0] = byte as u8;
                table[byte] = match byte & (byte - 1) {
                    0 => run(&[&bytes[..length]]) ^ of_zeros[length],
                    others => table[others] ^ table[byte ^ others],
                };
            }
        }
        ByteTables { changes, of_zeros }
    }

    /// The value of [`Check::parts`], the third of which are zeros; `None` if the bytes are too many.
    #[inline]
    fn value(&self, [before, after, zeros, suffix]: &[&[u8]; 4]) -> Option<u32> {
        let zeros = zeros.len();
        let length = before.len() + after.len() + zeros + suffix.len();
        let mut tables = &self.changes[self.changes.len().checked_sub(length)?..];
        let mut add = |value: u32, part: &[u8], zeros: usize| {
            let (own, later) = tables.split_at(part.len());
            // A zero changes nothing.
            tables = &later[zeros..];
            part.iter().zip(own).fold(value, |value, (byte, table)| value ^ table[usize::from(*byte)])
        };
        let value = add(self.of_zeros[length], before, if after.is_empty() { zeros } else { 0 });
        let value = if after.is_empty() { value } else { add(value, after, zeros) };
        Some(if suffix.is_empty() { value } else { add(value, suffix, 0) })
    }
}

/// The engine of a CRC that usually covers `length` bytes.
fn crc_engine(algorithm: &'static crc::Algorithm<u32>, length: usize) -> Engine {
    let crc = Crc::<u32, Table<16>>::new(algorithm);
    let parameters = CrcParameters {
        width: algorithm.width.into(),
        polynomial: algorithm.poly.into(),
        initial: algorithm.init.into(),
        reflects_input: algorithm.refin,
        reflects_output: algorithm.refout,
        final_xor: algorithm.xorout.into(),
    };
    let run = move |parts: &[&[u8]]| {
        let mut digest = crc.digest();
        parts.iter().for_each(|part| digest.update(part));
        digest.finalize()
    };
    let tables = ByteTables::new(&run, length);
    Engine::Crc(parameters, Box::new(run), tables)
}

/// Names of sums; true for the two's complement, with which all words add up to 0.
const SUMS: [(&str, Sum, bool); 8] = [
    ("sum", Sum::Bytes, false),
    ("negated-sum", Sum::Bytes, true),
    ("sum-u16be", Sum::Words(0), false),
    ("negated-sum-u16be", Sum::Words(0), true),
    ("sum-u16le", Sum::Words(1), false),
    ("negated-sum-u16le", Sum::Words(1), true),
    ("fletcher", Sum::Fletcher, false),
    ("xor", Sum::Xor, false),
];

/// Names of the sums.
pub fn sum_names() -> Vec<String> {
    SUMS.iter().map(|(name, ..)| (*name).to_owned()).collect()
}

/// Names of all check algorithms.
pub fn check_names() -> Vec<String> {
    sum_names().into_iter().chain(crc_algorithms().map(|(name, _)| name)).collect()
}

/// Parameters of a CRC, as the catalogue has them.
#[derive(Debug, Clone, Copy, Default)]
pub struct CrcParameters {
    pub width: u32,
    pub polynomial: u64,
    pub initial: u64,
    pub reflects_input: bool,
    pub reflects_output: bool,
    pub final_xor: u64,
}

/// A check value and the bytes that it covers.
#[derive(Clone)]
pub struct Check {
    pub name: String,
    engine: Arc<Engine>,
    pub place: BitField,
    /// Bytes covered, without the check itself.
    pub covers: Range<usize>,
    /// Zeros follow the covered bytes up to a multiple of this.
    pad_to: usize,
    /// Number of these zeros.
    zeros: usize,
    /// Bytes that follow the covered ones and are not sent, such as an identifier.
    pub suffix: Vec<u8>,
}

impl Debug for Check {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        write!(f, "{} of {:?} in {:?}", self.name, self.covers, self.place)
    }
}

impl Check {
    /// Largest `pad_to`.
    pub const MAX_PADDING: usize = 16;

    /// The check of that name or alias; `None` for an unknown name.
    pub fn new(name: &str, place: BitField, covers: Range<usize>) -> Option<Check> {
        let found = crc_algorithm(name);
        let name = found.as_ref().map_or(name, |(name, _)| name).to_owned();
        let crc = found.as_ref().map(|(_, algorithm)| crc_engine(algorithm, covers.len() + Check::MAX_PADDING));
        let sum = || SUMS.iter().find(|(sum, ..)| *sum == name).map(|(_, sum, negated)| Engine::Sum(*sum, *negated));
        let engine = Arc::new(crc.or_else(sum)?);
        Some(Check { name, engine, place, covers, pad_to: 1, zeros: 0, suffix: Vec::new() })
    }

    /// Lets zeros follow the covered bytes up to a multiple of `pad_to`, at most [`Check::MAX_PADDING`].
    pub fn pad(&mut self, pad_to: usize) {
        let pad_to = pad_to.clamp(1, Check::MAX_PADDING);
        let is_covered = |at: &usize| !(self.place.at..self.place.end()).contains(at);
        let length = self.covers.clone().filter(is_covered).count();
        (self.pad_to, self.zeros) = (pad_to, length.next_multiple_of(pad_to) - length);
    }

    /// Zeros follow the covered bytes up to a multiple of this.
    pub fn pad_to(&self) -> usize {
        self.pad_to
    }

    /// Algorithm and covered bytes of a frame of this length, in words.
    pub fn in_words(&self, length: usize) -> String {
        let covers = match self.covers.clone() {
            all if all == (0..length) => "the other bytes".to_owned(),
            some => format!("bytes {} to {}", some.start, some.end.saturating_sub(1)),
        };
        let zeros =
            if self.pad_to > 1 { format!(", then zeros up to a multiple of {}", self.pad_to) } else { String::new() };
        let suffix =
            if self.suffix.is_empty() { String::new() } else { format!(", then {}", spaced_hex(&self.suffix)) };
        format!("{} over {covers}{zeros}{suffix}", self.name)
    }

    /// Width of the algorithm, bit; 0 for a sum, which has that of its field.
    pub fn width(&self) -> u32 {
        self.parameters().map_or(0, |parameters| parameters.width)
    }

    /// Parameters of a CRC; `None` for a sum.
    pub fn parameters(&self) -> Option<CrcParameters> {
        match &*self.engine {
            Engine::Crc(parameters, ..) => Some(*parameters),
            Engine::Sum(..) => None,
        }
    }

    /// The parts of the covered bytes: before the check, after it, zeros, and the suffix.
    #[inline]
    fn parts<'a>(&'a self, bytes: &'a [u8]) -> [&'a [u8]; 4] {
        const ZEROS: [u8; Check::MAX_PADDING] = [0; Check::MAX_PADDING];
        let Range { start, end } = self.covers;
        let before = &bytes[start.min(self.place.at)..self.place.at.min(end)];
        let before = if start > self.place.at { &[] } else { before };
        let after = if end > self.place.end() { &bytes[start.max(self.place.end())..end] } else { &[] };
        [before, after, &ZEROS[..self.zeros], &self.suffix]
    }

    /// The check value of these bytes of a frame.
    #[inline]
    pub fn value(&self, bytes: &[u8]) -> u64 {
        let parts = self.parts(bytes);
        match &*self.engine {
            Engine::Crc(_, run, tables) => tables.value(&parts).unwrap_or_else(|| run(&parts)).into(),
            Engine::Sum(sum, is_negated) if *is_negated => sum.sum(&parts).wrapping_neg(),
            Engine::Sum(sum, _) => sum.sum(&parts),
        }
    }

    /// Writes the check value of a frame.
    pub fn write(&self, bytes: &mut [u8]) {
        let value = self.value(bytes);
        self.place.write_bits(value, bytes);
    }

    /// True if the frame has its check value.
    #[inline]
    pub fn holds(&self, bytes: &[u8]) -> bool {
        (self.place.read_bits(bytes) ^ self.value(bytes)) << (u64::BITS - self.place.bits) == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::Number;

    fn check(name: &str, number: &str, at: usize, covers: Range<usize>) -> Check {
        Check::new(name, BitField::bytes(at, Number::from_name(number).unwrap()), covers).unwrap()
    }

    #[test]
    fn algorithms_agree_with_the_published_check_values() {
        // The check values of the catalogue for "123456789".
        for (name, number, expected) in [
            ("CRC-8/SAE-J1850", "u8", 0x4B),
            ("CRC-8/AUTOSAR", "u8", 0xDF),
            ("CRC-16/IBM-3740", "u16be", 0x29B1),
            ("CRC-16/MODBUS", "u16le", 0x4B37),
            ("CRC-24/OPENPGP", "u24be", 0x21_CF02),
            ("CRC-32/MPEG-2", "u32be", 0x0376_E6E7),
            ("CRC-32/ISO-HDLC", "u32le", 0xCBF4_3926),
            ("xor", "u8", 0x31),
            ("sum", "u16be", 0x1DD),
            // 3132 + 3334 + 3536 + 3738 + 3900, and with the bytes of each word exchanged.
            ("sum-u16be", "u16be", 0x3132 + 0x3334 + 0x3536 + 0x3738 + 0x3900),
            ("sum-u16le", "u16le", 0x3231 + 0x3433 + 0x3635 + 0x3837 + 0x0039),
            // The algorithm of u-blox, computed in Python.
            ("fletcher", "u16be", 0xDD15),
        ] {
            assert_eq!(check(name, number, 9, 0..9).value(b"123456789"), expected, "{name}");
        }
        assert!(Check::new("CRC-32/MPEG2", check("xor", "u8", 0, 0..0).place, 0..1).is_none());
        assert_eq!(check_names().iter().filter(|name| name.starts_with("CRC-16/")).count(), 31);
    }

    #[test]
    fn zeros_and_a_suffix_are_covered_and_the_check_itself_is_not() {
        let mut padded = check("CRC-32/MPEG-2", "u32be", 9, 0..9);
        padded.pad(4);
        assert_eq!(
            padded.value(b"123456789----"),
            check("CRC-32/MPEG-2", "u32be", 12, 0..12).value(b"123456789\0\0\0")
        );
        let mut first = check("CRC-8/SAE-J1850", "u8", 0, 0..8);
        assert_eq!(first.value(b"-3456789"), check("CRC-8/SAE-J1850", "u8", 7, 0..7).value(b"3456789"));
        first.suffix = vec![b'0'];
        assert_eq!(first.value(b"-3456789"), check("CRC-8/SAE-J1850", "u8", 8, 0..8).value(b"34567890"));
        let middle = check("xor", "u8", 2, 0..4);
        let mut bytes = [1, 2, 0, 4];
        assert!(!middle.holds(&bytes));
        middle.write(&mut bytes);
        assert!(middle.holds(&bytes) && bytes[2] == 7);
        let negated = check("negated-sum", "u8", 4, 0..4);
        assert_eq!(negated.value(&[1, 2, 3, 250]) as u8, 0);
    }

    #[test]
    fn every_algorithm_of_the_catalogue_gives_its_check_value() {
        for (name, algorithm) in crc_algorithms() {
            let Engine::Crc(parameters, run, _) = crc_engine(algorithm, 9) else { unreachable!("a CRC") };
            assert_eq!(run(&[b"12345", b"6789"]), algorithm.check, "{name}");
            assert!(name.contains(&format!("-{}/", parameters.width)), "{name}");
        }
    }

    #[test]
    fn the_tables_of_short_frames_give_the_value_of_the_algorithm() {
        let bytes: Vec<u8> = (0..100u32).map(|index| ((index * index * 37) >> 3) as u8).collect();
        for name in
            ["CRC-8/SAE-J1850", "CRC-8/MAXIM-DOW", "CRC-16/DNP", "CRC-24/BLE", "CRC-32/MPEG-2", "CRC-32/ISO-HDLC"]
        {
            for (at, end, pad_to, suffix) in
                [(3, 30, 4, 0), (0, 60, 1, 3), (40, 40, 16, 2), (61, 61, 4, 0), (90, 90, 7, 1)]
            {
                let mut check = check(name, "u8", at, 0..end);
                check.suffix = bytes[..suffix].to_vec();
                check.pad(pad_to);
                let Engine::Crc(_, run, tables) = &*check.engine else { unreachable!("a CRC") };
                let (parts, used) = (check.parts(&bytes), tables.value(&check.parts(&bytes)));
                assert_eq!(check.value(&bytes), u64::from(run(&parts)), "{name} {at} {end}");
                assert_eq!(used.is_some(), end < 62, "{name} {at} {end}");
            }
        }
    }
}
