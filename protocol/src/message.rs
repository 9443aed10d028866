//! The messages: each a name and a list of fields, once. Codec and tables both come from the list.

use crate::field::*;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MessageId {
    /// CAN identifier: the base plus this.
    Can(u16),
    /// Serial frame of this type.
    Serial(u8),
}

/// Description of a message for tables, databases and documents.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MessageSpec {
    /// Name, upper case.
    pub name: &'static str,
    pub id: MessageId,
    /// Fields in wire order, without gaps.
    pub fields: &'static [FieldSpec],
    pub meaning: &'static str,
}

impl MessageSpec {
    pub const fn length(&self) -> usize {
        let (mut length, mut index) = (0, 0);
        while index < self.fields.len() {
            length += self.fields[index].wire.length();
            index += 1;
        }
        length
    }

    /// Each field with the byte it starts at.
    pub fn placed_fields(&self) -> impl Iterator<Item = (usize, &'static FieldSpec)> {
        let mut at = 0;
        self.fields.iter().map(move |field| {
            let start = at;
            at += field.wire.length();
            (start, field)
        })
    }
}

/// A message as a type: its bytes from a sample, and back.
pub trait Message {
    const SPEC: MessageSpec;
    /// Writes the fields of `sample`; a check value is left to the caller.
    fn write(sample: &Sample, bytes: &mut [u8]);
    /// Reads the fields into `sample`, leaving the others as they are.
    fn read(bytes: &[u8], sample: &mut Sample);
}

macro_rules! messages {
    ($($type:ident, $name:literal, $id:expr, [$($field:ident),*] $(+ $crc:ident)?, $meaning:literal;)*) => {
        $(
            #[doc = $meaning]
            pub struct $type;
            impl Message for $type {
                const SPEC: MessageSpec = MessageSpec { name: $name, id: $id,
                    fields: &[$($field::SPEC,)* $($crc)?], meaning: $meaning };
                #[inline]
                fn write(sample: &Sample, bytes: &mut [u8]) {
                    let mut at = 0;
                    $($field::SPEC.wire.write($field::get(sample), &mut bytes[at..]); at += $field::SPEC.wire.length();)*
                    let _ = at;
                }
                #[inline]
                fn read(bytes: &[u8], sample: &mut Sample) {
                    let mut at = 0;
                    $($field::set(sample, $field::SPEC.wire.read(&bytes[at..])); at += $field::SPEC.wire.length();)*
                    let _ = at;
                }
            }
        )*
        /// Every cyclic message.
        pub const MESSAGES: &[MessageSpec] = &[$($type::SPEC),*];
    };
}

messages! {
    Increments, "INCREMENTS", MessageId::Can(0), [IncrementX, IncrementY, IncrementZa, IncrementZb],
        "increments of the sample just ended; used only with the STATUS that follows it";
    Status, "STATUS", MessageId::Can(1), [Sequence, GyroFlags, UnitFlags, Electronics] + CRC,
        "state, and CRC over the 8 bytes of INCREMENTS then the first 6 of STATUS";
    Clock, "CLOCK", MessageId::Can(2), [ClockCount, Sensor],
        "clock count and sensor temperature, of the STATUS before it";
    Data, "DATA", MessageId::Serial(0x01),
        [Sequence, IncrementX, IncrementY, IncrementZa, IncrementZb, GyroFlags, UnitFlags, Electronics, ClockCount, Sensor],
        "all fields of one sample";
}
