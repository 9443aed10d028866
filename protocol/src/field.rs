//! The fields of a sample: name, wire type, unit, scale and meaning of each, once.
//!
//! A field is a type with access to its value in [`Sample`] and its encoding; a message (see
//! [`crate::message`]) is a list of such types.

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

use crate::named;

/// Cycles of the nominal 1 MHz unit clock in one sample interval.
pub const CLOCK_PER_SAMPLE: u64 = 500_000;
/// The clock count is a 48-bit number.
pub const CLOCK_MODULUS: u64 = 1 << 48;

/// A gyro of a unit: its number and its name. The constants belong to the default unit.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Gyro {
    index: u8,
    name: &'static str,
}

impl Gyro {
    pub const X: Gyro = Gyro { index: 0, name: "GYRX" };
    pub const Y: Gyro = Gyro { index: 1, name: "GYRY" };
    pub const ZA: Gyro = Gyro { index: 2, name: "GYRZA" };
    pub const ZB: Gyro = Gyro { index: 3, name: "GYRZB" };
    /// The gyros of the default unit, in wire order.
    pub const ALL: [Gyro; 4] = [Gyro::X, Gyro::Y, Gyro::ZA, Gyro::ZB];
    /// Names of the default unit's gyros.
    pub const NAMES: [&'static str; 4] = [Gyro::X.name, Gyro::Y.name, Gyro::ZA.name, Gyro::ZB.name];

    /// The gyro of another unit with that number. Its name is kept for the rest of the process, each name once.
    pub fn new(index: u8, name: &str) -> Gyro {
        static KEPT: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());
        let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        let known = kept.get(name).copied();
        let name = known.unwrap_or_else(|| Box::leak(name.to_owned().into_boxed_str()));
        kept.insert(name);
        Gyro { index, name }
    }

    /// The gyro of the default unit with that name.
    pub fn from_name(name: &str) -> Option<Gyro> {
        Gyro::ALL.into_iter().find(|gyro| gyro.name == name)
    }

    pub const fn name(self) -> &'static str {
        self.name
    }

    /// Number of the head, from 0.
    pub const fn index(self) -> usize {
        self.index as usize
    }

    /// Bit in a mask of gyros (bit 0 is GYRX).
    pub const fn bit(self) -> u8 {
        1 << self.index
    }
}

impl std::fmt::Debug for Gyro {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

/// One sample of the unit: the content of all cyclic messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sample {
    /// +1 each sample, wraps.
    pub sequence: u16,
    /// Angular increments over the sample interval just ended, count, in the order of [`Gyro::ALL`].
    pub increments: [i16; 4],
    /// Bits 0–3 valid, bits 4–7 saturated ([`GYRO_FLAGS`]).
    pub gyro_flags: u8,
    /// State of the unit ([`UNIT_FLAGS`]).
    pub unit_flags: u8,
    /// Electronics temperature, 0.01 °C.
    pub electronics_centi_c: i16,
    /// Cycle of the nominal 1 MHz unit clock at the end of the sample interval, 48 bits.
    pub clock_count: u64,
    /// Sensor temperature, 0.01 °C.
    pub sensor_centi_c: i16,
}

named! {
    /// Encoding of a number on the wire; all are big-endian, signed ones two's complement.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum WireType {
        /// Unsigned, 1 byte.
        U8 = "u8",
        /// Unsigned, 2 bytes.
        U16 = "u16",
        /// Signed, 2 bytes.
        I16 = "i16",
        /// Unsigned, 6 bytes.
        U48 = "u48",
    }
}

impl WireType {
    pub const fn length(self) -> usize {
        match self {
            WireType::U8 => 1,
            WireType::U16 | WireType::I16 => 2,
            WireType::U48 => 6,
        }
    }

    /// True for signed numbers.
    pub const fn signed(self) -> bool {
        matches!(self, WireType::I16)
    }

    /// Smallest and largest number that can be sent.
    pub const fn limits(self) -> (i64, i64) {
        let bits = 8 * self.length() as u32;
        if self.signed() { (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) } else { (0, (1 << bits) - 1) }
    }

    /// The number in the first bytes of `bytes`.
    #[inline]
    pub fn read(self, bytes: &[u8]) -> i64 {
        match self {
            WireType::U8 => i64::from(bytes[0]),
            WireType::U16 => i64::from(u16::from_be_bytes([bytes[0], bytes[1]])),
            WireType::I16 => i64::from(i16::from_be_bytes([bytes[0], bytes[1]])),
            WireType::U48 => i64::from_be_bytes([0, 0, bytes[0], bytes[1], bytes[2], bytes[3], bytes[4], bytes[5]]),
        }
    }

    /// Writes the low bits of `value` into the first bytes of `bytes`.
    #[inline]
    pub fn write(self, value: i64, bytes: &mut [u8]) {
        let length = self.length();
        bytes[..length].copy_from_slice(&value.to_be_bytes()[8 - length..]);
    }
}

/// Description of a field for tables, databases and documents.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldSpec {
    /// Name, lower case, as in the CSV header.
    pub name: &'static str,
    pub wire: WireType,
    /// Unit of `scale`; may be empty.
    pub unit: &'static str,
    /// Physical value of one unit of the number on the wire.
    pub scale: f64,
    /// Bits by name, for a field of flags.
    pub bits: &'static [Bit],
    pub meaning: &'static str,
}

/// One named bit of a field of flags.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bit {
    /// Bit number; 0 is the lowest bit.
    pub bit: u8,
    pub name: &'static str,
    pub meaning: &'static str,
}

/// A field as a type: access to it in a sample, and its description.
pub trait Field {
    const SPEC: FieldSpec;
    fn get(sample: &Sample) -> i64;
    /// Puts the number `value` into `sample`.
    fn set(sample: &mut Sample, value: i64);
}

macro_rules! fields {
    ($($(#[bits($bits:expr)])? $type:ident, $name:literal, $wire:ident, $unit:literal, $scale:literal,
       |$sample:ident| $place:expr, $as:ty, $meaning:literal;)*) => {
        $(
            #[doc = $meaning]
            pub struct $type;
            impl Field for $type {
                const SPEC: FieldSpec = FieldSpec { name: $name, wire: WireType::$wire, unit: $unit, scale: $scale,
                    bits: { const NONE: &[Bit] = &[]; let _bits = NONE; $(let _bits: &[Bit] = $bits;)? _bits },
                    meaning: $meaning };
                #[inline]
                fn get($sample: &Sample) -> i64 { $place as i64 }
                #[inline]
                fn set($sample: &mut Sample, value: i64) { $place = value as $as }
            }
        )*
        /// Every field, in the order of the interface control document.
        pub const FIELDS: &[FieldSpec] = &[$($type::SPEC),*];
    };
}

fields! {
    IncrementX, "gyrx", I16, "count", 1.0, |h| h.increments[0], i16,
        "GYRX angular increment over the sample interval just ended; clipped, never wrapped";
    IncrementY, "gyry", I16, "count", 1.0, |h| h.increments[1], i16,
        "GYRY angular increment over the sample interval just ended; clipped, never wrapped";
    IncrementZa, "gyrza", I16, "count", 1.0, |h| h.increments[2], i16,
        "GYRZA angular increment over the sample interval just ended; clipped, never wrapped";
    IncrementZb, "gyrzb", I16, "count", 1.0, |h| h.increments[3], i16,
        "GYRZB angular increment over the sample interval just ended; clipped, never wrapped";
    Sequence, "sequence", U16, "", 1.0, |h| h.sequence, u16,
        "+1 each sample, wraps";
    #[bits(GYRO_FLAGS)]
    GyroFlags, "gyro_flags", U8, "", 1.0, |h| h.gyro_flags, u8,
        "validity and saturation of each gyro";
    #[bits(UNIT_FLAGS)]
    UnitFlags, "unit_flags", U8, "", 1.0, |h| h.unit_flags, u8,
        "state of the unit";
    Electronics, "electronics_c", I16, "degC", 0.01, |h| h.electronics_centi_c, i16,
        "electronics temperature";
    ClockCount, "clock_count", U48, "cycle", 1.0, |h| h.clock_count, u64,
        "cycle of the nominal 1 MHz unit clock at the end of the sample interval; exactly +500000 each sample";
    Sensor, "sensor_c", I16, "degC", 0.01, |h| h.sensor_centi_c, i16,
        "sensor temperature";
}

/// CRC-16/IBM-3740 of STATUS and of every serial frame.
pub const CRC: FieldSpec = FieldSpec {
    name: "crc",
    wire: WireType::U16,
    unit: "",
    scale: 1.0,
    bits: &[],
    meaning: "CRC-16/IBM-3740 (poly 1021, init FFFF, not reflected, no final xor)",
};

macro_rules! bits {
    ($($bit:literal $name:literal $meaning:literal;)*) => {
        &[$(Bit { bit: $bit, name: $name, meaning: $meaning }),*]
    };
}

pub const GYRO_FLAGS: &[Bit] = bits! {
    0 "gyrx_valid" "GYRX runs, is spun up and its increment is a measurement";
    1 "gyry_valid" "GYRY runs, is spun up and its increment is a measurement";
    2 "gyrza_valid" "GYRZA runs, is spun up and its increment is a measurement";
    3 "gyrzb_valid" "GYRZB runs, is spun up and its increment is a measurement";
    4 "gyrx_saturated" "GYRX increment was clipped to 16 bits";
    5 "gyry_saturated" "GYRY increment was clipped to 16 bits";
    6 "gyrza_saturated" "GYRZA increment was clipped to 16 bits";
    7 "gyrzb_saturated" "GYRZB increment was clipped to 16 bits";
};

/// Bits of `unit_flags`; 5–7 are reserved, sent 0.
pub const UNIT_FLAGS: &[Bit] = bits! {
    0 "heater_in_band" "sensor heater in 70 +- 1 degC";
    1 "motors_synchronous" "spin motor of every powered gyro synchronous";
    2 "clock_locked" "clock locked";
    3 "self_test" "self-test running";
    4 "polled" "polled mode";
};

/// The mask of the unit flag of that name in [`UNIT_FLAGS`].
pub const fn unit_flag(name: &str) -> u8 {
    let mut index = 0;
    while index < UNIT_FLAGS.len() {
        if same(UNIT_FLAGS[index].name.as_bytes(), name.as_bytes()) {
            return 1 << UNIT_FLAGS[index].bit;
        }
        index += 1;
    }
    panic!("no unit flag of that name")
}

const fn same(a: &[u8], b: &[u8]) -> bool {
    if a.len() != b.len() {
        return false;
    }
    let mut index = 0;
    while index < a.len() {
        if a[index] != b[index] {
            return false;
        }
        index += 1;
    }
    true
}
