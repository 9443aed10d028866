//! The unit's messages as classic CAN frames, and samples put together again from any traffic.

mod assembler;

pub use assembler::{AssembledSample, Assembler, AssemblerEvent, CanDefect, DefectBytes, Progress};

use crate::command::{COMMAND_CAN, REPLY_CAN, Reply};
use crate::crc::crc16;
use crate::field::Sample;
use crate::message::{Clock, Increments, Message, MessageId, Status};

pub const DEFAULT_BASE: u16 = 0x1A0;
/// The largest identifier of eleven bits.
const MAX_ID: u16 = 0x7FF;
/// The largest identifier of 29 bits.
const MAX_EXTENDED_ID: u32 = 0x1FFF_FFFF;
/// Data bytes of INCREMENTS, STATUS and CLOCK.
const LENGTH: usize = 8;
/// Bytes of STATUS that its CRC covers.
pub const STATUS_COVERED: usize = 6;

/// A classic CAN data frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CanFrame {
    id: u32,
    is_extended: bool,
    length: u8,
    data: [u8; LENGTH],
}

impl CanFrame {
    fn empty(id: u16) -> CanFrame {
        CanFrame { id: id.into(), is_extended: false, length: 0, data: [0; LENGTH] }
    }

    /// A frame with these data; `None` for an identifier beyond eleven bits or more than eight bytes.
    #[inline]
    pub fn new(id: u16, data: &[u8]) -> Option<CanFrame> {
        if id > MAX_ID {
            return None;
        }
        CanFrame::empty(id).with_data(data)
    }

    /// A frame with an identifier of 29 bits; `None` for a larger one or more than eight bytes.
    #[inline]
    pub fn extended(id: u32, data: &[u8]) -> Option<CanFrame> {
        let frame = CanFrame { id, is_extended: true, ..CanFrame::empty(0) }.with_data(data);
        frame.filter(|_| id <= MAX_EXTENDED_ID)
    }

    /// The frame under another identifier of the same length, the largest one instead of a larger one.
    #[must_use]
    pub fn with_id(self, id: u32) -> CanFrame {
        CanFrame { id: id.min(if self.is_extended { MAX_EXTENDED_ID } else { MAX_ID.into() }), ..self }
    }

    /// Replaces the data; `None` for more than eight bytes.
    #[inline]
    pub fn with_data(self, data: &[u8]) -> Option<CanFrame> {
        let mut bytes = [0; LENGTH];
        bytes.get_mut(..data.len())?.copy_from_slice(data);
        Some(CanFrame { length: data.len() as u8, data: bytes, ..self })
    }

    /// The identifier.
    #[inline]
    pub fn id(&self) -> u32 {
        self.id
    }

    /// True for an identifier of 29 bits.
    pub fn is_extended(&self) -> bool {
        self.is_extended
    }

    #[inline]
    pub fn data(&self) -> &[u8] {
        &self.data[..usize::from(self.length)]
    }
}

/// Meaning of an identifier.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// B+0.
    Increments,
    /// B+1.
    Status,
    /// B+2.
    Clock,
    /// B+8, to the unit.
    Command,
    /// B+9, from the unit.
    Reply,
    /// Other traffic.
    Other,
}

/// The identifiers in use: a base plus the offsets of the messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CanIdMap {
    base: u16,
}

impl Default for CanIdMap {
    fn default() -> CanIdMap {
        CanIdMap { base: DEFAULT_BASE }
    }
}

const fn offset(id: MessageId) -> u16 {
    match id {
        MessageId::Can(offset) => offset,
        MessageId::Serial(_) => panic!("not a CAN message"),
    }
}

impl CanIdMap {
    /// Largest base: all identifiers must stay within eleven bits.
    pub const MAX_BASE: u16 = MAX_ID - offset(REPLY_CAN);

    /// The map with this base; `None` above [`CanIdMap::MAX_BASE`].
    pub fn with_base(base: u16) -> Option<CanIdMap> {
        (base <= CanIdMap::MAX_BASE).then_some(CanIdMap { base })
    }

    pub fn base(self) -> u16 {
        self.base
    }

    pub fn command_id(self) -> u16 {
        self.base + offset(COMMAND_CAN)
    }

    pub fn reply_id(self) -> u16 {
        self.base + offset(REPLY_CAN)
    }

    /// Role of a frame with identifier `id`.
    #[inline]
    pub fn role(self, id: u32) -> Role {
        const INCREMENTS: u32 = offset(Increments::SPEC.id) as u32;
        const STATUS: u32 = offset(Status::SPEC.id) as u32;
        const CLOCK: u32 = offset(Clock::SPEC.id) as u32;
        const COMMAND: u32 = offset(COMMAND_CAN) as u32;
        const REPLY: u32 = offset(REPLY_CAN) as u32;
        match id.wrapping_sub(u32::from(self.base)) {
            INCREMENTS => Role::Increments,
            STATUS => Role::Status,
            CLOCK => Role::Clock,
            COMMAND => Role::Command,
            REPLY => Role::Reply,
            _ => Role::Other,
        }
    }

    /// INCREMENTS, STATUS and CLOCK of one sample, in sending order.
    pub fn frames(self, sample: &Sample) -> [CanFrame; 3] {
        let [mut increments, mut status, mut clock] = [[0; LENGTH]; 3];
        Increments::write(sample, &mut increments);
        Status::write(sample, &mut status);
        close_status(&increments, &mut status);
        Clock::write(sample, &mut clock);
        let frame = |id, data| CanFrame { length: LENGTH as u8, data, ..CanFrame::empty(self.base + offset(id)) };
        [frame(Increments::SPEC.id, increments), frame(Status::SPEC.id, status), frame(Clock::SPEC.id, clock)]
    }

    pub fn reply(self, reply: &Reply) -> CanFrame {
        let mut data = [0; LENGTH];
        data[..reply.bytes().len()].copy_from_slice(reply.bytes());
        CanFrame { length: reply.bytes().len() as u8, data, ..CanFrame::empty(self.reply_id()) }
    }
}

/// Writes the CRC of STATUS over the data of INCREMENTS and its own fields.
#[inline]
pub fn close_status(increments: &[u8], status: &mut [u8; 8]) {
    let mut covered = [0; LENGTH + STATUS_COVERED];
    let length = increments.len().min(LENGTH);
    covered[..length].copy_from_slice(&increments[..length]);
    covered[length..length + STATUS_COVERED].copy_from_slice(&status[..STATUS_COVERED]);
    let crc = crc16(&covered[..length + STATUS_COVERED]);
    status[STATUS_COVERED..].copy_from_slice(&crc.to_be_bytes());
}

/// True if STATUS, the last bytes, has the CRC of INCREMENTS and its own fields: the CRC of bytes that end with their CRC is 0.
#[inline]
fn is_closed(increments_and_status: &[u8; 2 * LENGTH]) -> bool {
    crc16(increments_and_status) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_frame_has_an_identifier_beyond_eleven_bits_or_more_than_eight_bytes() {
        assert!(CanFrame::new(0x7FF, &[0; 8]).is_some());
        assert_eq!(CanFrame::new(0x800, &[]), None);
        assert_eq!(CanFrame::new(0x1A0, &[0; 9]), None);
    }
}
