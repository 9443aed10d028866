//! The unit's messages as classic CAN frames, and samples put together again from any traffic.

use crate::command::{COMMAND_CAN, REPLY_CAN, Reply};
use crate::continuity::ClockCheck;
use crate::crc::crc16;
use crate::field::Sample;
use crate::message::{Clock, Increments, Message, MessageId, Status};

pub const DEFAULT_BASE: u16 = 0x1A0;
/// The largest identifier of eleven bits.
const MAX_ID: u16 = 0x7FF;
/// Data bytes of INCREMENTS, STATUS and CLOCK.
const LENGTH: usize = 8;
/// Bytes of STATUS that its CRC covers.
pub const STATUS_COVERED: usize = 6;

/// A classic CAN data frame with an 11-bit identifier.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CanFrame {
    id: u16,
    length: u8,
    data: [u8; LENGTH],
}

impl CanFrame {
    /// A frame with these data; nothing with an identifier beyond eleven bits or more than eight bytes.
    #[inline]
    pub fn new(id: u16, data: &[u8]) -> Option<CanFrame> {
        if id > MAX_ID {
            return None;
        }
        CanFrame { id, length: 0, data: [0; LENGTH] }.with_data(data)
    }

    /// The same identifier with other data; nothing with more than eight bytes.
    #[inline]
    pub fn with_data(self, data: &[u8]) -> Option<CanFrame> {
        let mut bytes = [0; LENGTH];
        bytes.get_mut(..data.len())?.copy_from_slice(data);
        Some(CanFrame { length: data.len() as u8, data: bytes, ..self })
    }

    /// The identifier, 0…7FF.
    #[inline]
    pub fn id(&self) -> u16 {
        self.id
    }

    #[inline]
    pub fn data(&self) -> &[u8] {
        &self.data[..usize::from(self.length)]
    }
}

/// What a frame is to the unit.
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
    /// Somebody else's.
    Other,
}

/// The identifiers in use: a base and what stands at fixed distances from it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CanIdMap {
    base: u16,
}

impl Default for CanIdMap {
    fn default() -> CanIdMap {
        CanIdMap { base: DEFAULT_BASE }
    }
}

const fn offset(place: MessageId) -> u16 {
    match place {
        MessageId::Can(offset) => offset,
        MessageId::Serial(_) => panic!("not a CAN message"),
    }
}

impl CanIdMap {
    /// Largest base: all identifiers must stay within eleven bits.
    pub const MAX_BASE: u16 = MAX_ID - offset(REPLY_CAN);

    /// The plan with this base; nothing where it is above [`CanIdMap::MAX_BASE`].
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

    /// What a frame with identifier `id` is.
    #[inline]
    pub fn role(self, id: u32) -> Role {
        match id.wrapping_sub(u32::from(self.base)) {
            0 => Role::Increments,
            1 => Role::Status,
            2 => Role::Clock,
            8 => Role::Command,
            9 => Role::Reply,
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
        let frame = |place, data| CanFrame { id: self.base + offset(place), length: LENGTH as u8, data };
        [frame(Increments::SPEC.place, increments), frame(Status::SPEC.place, status), frame(Clock::SPEC.place, clock)]
    }

    pub fn reply(self, reply: &Reply) -> CanFrame {
        let mut data = [0; LENGTH];
        data[..reply.bytes().len()].copy_from_slice(reply.bytes());
        CanFrame { id: self.reply_id(), length: reply.bytes().len() as u8, data }
    }
}

/// The CRC over the data of INCREMENTS and what STATUS tells.
#[inline]
fn status_crc(increments: &[u8], status: &[u8]) -> [u8; 2] {
    let mut covered = [0; LENGTH + STATUS_COVERED];
    let length = increments.len().min(LENGTH);
    covered[..length].copy_from_slice(&increments[..length]);
    covered[length..length + STATUS_COVERED].copy_from_slice(&status[..STATUS_COVERED]);
    crc16(&covered[..length + STATUS_COVERED]).to_be_bytes()
}

/// Makes the CRC of STATUS right for what it tells and for the data of INCREMENTS before it.
#[inline]
pub fn close_status(increments: &[u8], status: &mut [u8; 8]) {
    let crc = status_crc(increments, status);
    status[STATUS_COVERED..].copy_from_slice(&crc);
}

/// What is wrong with a message of the unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum CanDefect {
    /// INCREMENTS, STATUS or CLOCK that is not eight bytes long.
    WrongLength,
    /// INCREMENTS that no STATUS followed before the next INCREMENTS.
    IncrementsWithoutStatus,
    /// STATUS before which no INCREMENTS stood.
    StatusWithoutIncrements,
    /// INCREMENTS and STATUS whose CRC does not match; neither is used.
    CrcMismatch,
    /// CLOCK before which no good STATUS stood.
    ClockWithoutStatus,
    /// CLOCK whose count did not advance by 500 000 per sequence step.
    ClockInconsistent,
}

impl CanDefect {
    pub const ALL: [CanDefect; 6] = [
        CanDefect::WrongLength,
        CanDefect::IncrementsWithoutStatus,
        CanDefect::StatusWithoutIncrements,
        CanDefect::CrcMismatch,
        CanDefect::ClockWithoutStatus,
        CanDefect::ClockInconsistent,
    ];

    pub const fn name(self) -> &'static str {
        match self {
            CanDefect::WrongLength => "wrong-length",
            CanDefect::IncrementsWithoutStatus => "increments-without-status",
            CanDefect::StatusWithoutIncrements => "status-without-increments",
            CanDefect::CrcMismatch => "crc-mismatch",
            CanDefect::ClockWithoutStatus => "clock-without-status",
            CanDefect::ClockInconsistent => "clock-inconsistent",
        }
    }

    /// How many frames one such defect accounts for.
    pub const fn frames(self) -> u64 {
        if matches!(self, CanDefect::CrcMismatch) { 2 } else { 1 }
    }
}

/// A sample put together again, with the stamp of its INCREMENTS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AssembledSample<S> {
    pub stamp: S,
    /// The fields; clock count and sensor temperature only where `has_clock`.
    pub sample: Sample,
    pub has_clock: bool,
}

/// What the assembler makes of the traffic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AssemblerEvent<S> {
    /// A sample: two frames, three where it has a clock.
    Row(AssembledSample<S>),
    /// A defect, at the stamp of the (first) frame concerned.
    Defect(S, CanDefect, DefectBytes),
}

/// The data bytes that a defect concerns: of one frame, or of INCREMENTS and STATUS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DefectBytes {
    bytes: [u8; 2 * LENGTH],
    length: u8,
}

impl DefectBytes {
    /// The first eight bytes of each part.
    pub fn new(parts: [&[u8]; 2]) -> DefectBytes {
        let (mut bytes, mut length) = ([0; 2 * LENGTH], 0);
        for part in parts {
            let part = &part[..part.len().min(LENGTH)];
            bytes[length..length + part.len()].copy_from_slice(part);
            length += part.len();
        }
        DefectBytes { bytes, length: length as u8 }
    }

    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length)]
    }
}

/// Puts samples together from INCREMENTS, STATUS and CLOCK, with anything between them.
///
/// `S` is whatever the caller knows a frame by: its time, its place in a file.
#[derive(Debug, Clone)]
pub struct Assembler<S> {
    increments: Option<(S, [u8; LENGTH])>,
    row: Option<AssembledSample<S>>,
    clock: ClockCheck,
}

impl<S: Copy> Default for Assembler<S> {
    fn default() -> Self {
        Assembler { increments: None, row: None, clock: ClockCheck::default() }
    }
}

impl<S: Copy> Assembler<S> {
    /// Takes the next INCREMENTS, STATUS or CLOCK (any other role is ignored).
    #[inline]
    pub fn push(&mut self, role: Role, stamp: S, data: &[u8], sink: &mut impl FnMut(AssemblerEvent<S>)) {
        if !matches!(role, Role::Increments | Role::Status | Role::Clock) {
            return;
        }
        if role == Role::Increments {
            self.finish(sink);
        }
        let Ok(bytes) = <&[u8; LENGTH]>::try_from(data) else {
            return defect(stamp, CanDefect::WrongLength, [data, &[]], sink);
        };
        match role {
            Role::Increments => self.increments = Some((stamp, *bytes)),
            Role::Status => self.status(stamp, bytes, sink),
            _ => self.clock(stamp, bytes, sink),
        }
    }

    /// Whether a sample has begun that the next frames may complete.
    pub fn is_waiting(&self) -> bool {
        self.increments.is_some() || self.row.is_some()
    }

    /// Gives out what still waits: at the end of the traffic.
    #[inline]
    pub fn finish(&mut self, sink: &mut impl FnMut(AssemblerEvent<S>)) {
        if let Some(row) = self.row.take() {
            sink(AssemblerEvent::Row(row));
        }
        if let Some((stamp, bytes)) = self.increments.take() {
            defect(stamp, CanDefect::IncrementsWithoutStatus, [&bytes, &[]], sink);
        }
    }

    #[inline]
    fn status(&mut self, stamp: S, bytes: &[u8; LENGTH], sink: &mut impl FnMut(AssemblerEvent<S>)) {
        let Some((first, increments)) = self.increments.take() else {
            self.finish(sink);
            return defect(stamp, CanDefect::StatusWithoutIncrements, [bytes, &[]], sink);
        };
        if status_crc(&increments, bytes) != bytes[STATUS_COVERED..] {
            return defect(first, CanDefect::CrcMismatch, [&increments, bytes], sink);
        }
        let mut sample = Sample::default();
        Increments::read(&increments, &mut sample);
        Status::read(bytes, &mut sample);
        self.row = Some(AssembledSample { stamp: first, sample, has_clock: false });
    }

    #[inline]
    fn clock(&mut self, stamp: S, bytes: &[u8; LENGTH], sink: &mut impl FnMut(AssemblerEvent<S>)) {
        let Some(mut row) = self.row.take() else {
            return defect(stamp, CanDefect::ClockWithoutStatus, [bytes, &[]], sink);
        };
        let mut clocked = row.sample;
        Clock::read(bytes, &mut clocked);
        if self.clock.accepts(clocked.sequence, clocked.clock_count) {
            row.sample = clocked;
            row.has_clock = true;
            sink(AssemblerEvent::Row(row));
        } else {
            sink(AssemblerEvent::Row(row));
            defect(stamp, CanDefect::ClockInconsistent, [bytes, &[]], sink);
        }
    }
}

#[cold]
fn defect<S>(stamp: S, defect: CanDefect, parts: [&[u8]; 2], sink: &mut impl FnMut(AssemblerEvent<S>)) {
    sink(AssemblerEvent::Defect(stamp, defect, DefectBytes::new(parts)));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::CLOCK_PER_SAMPLE;

    #[test]
    fn no_frame_has_an_identifier_beyond_eleven_bits_or_more_than_eight_bytes() {
        assert!(CanFrame::new(0x7FF, &[0; 8]).is_some());
        assert_eq!(CanFrame::new(0x800, &[]), None);
        assert_eq!(CanFrame::new(0x1A0, &[0; 9]), None);
    }

    fn sample(sequence: u16) -> Sample {
        Sample {
            sequence,
            increments: [1, -2, 3, sequence as i16],
            clock_count: (u64::from(sequence) + 1) * CLOCK_PER_SAMPLE + 7_000_000,
            sensor_centi_c: 7000,
            ..Sample::default()
        }
    }

    /// A row, or what is wrong at which frame.
    #[derive(Debug, PartialEq)]
    enum Seen {
        Row(AssembledSample<usize>),
        Defect(usize, CanDefect),
    }

    fn assemble(frames: &[CanFrame]) -> Vec<Seen> {
        let (plan, mut assembler, mut found) = (CanIdMap::default(), Assembler::default(), Vec::new());
        let mut see = |event| {
            found.push(match event {
                AssemblerEvent::Row(row) => Seen::Row(row),
                AssemblerEvent::Defect(stamp, defect, _) => Seen::Defect(stamp, defect),
            })
        };
        for (index, frame) in frames.iter().enumerate() {
            assembler.push(plan.role(frame.id().into()), index, frame.data(), &mut see);
        }
        assembler.finish(&mut see);
        found
    }

    fn row(stamp: usize, sequence: u16) -> Seen {
        Seen::Row(AssembledSample { stamp, sample: sample(sequence), has_clock: true })
    }

    fn frames(sequences: &[u16]) -> Vec<CanFrame> {
        sequences.iter().flat_map(|&s| CanIdMap::default().frames(&sample(s))).collect()
    }

    #[test]
    fn samples_come_back_with_other_traffic_between() {
        let mut traffic = frames(&[0, 1]);
        traffic.insert(1, CanFrame::new(0x123, &[1, 2, 3]).unwrap());
        assert_eq!(assemble(&traffic), [row(0, 0), row(4, 1)]);
    }

    #[test]
    fn increments_pair_only_with_the_next_status_and_a_matching_crc() {
        let mut traffic = frames(&[0, 1, 2]);
        traffic.remove(1);
        let mut found = assemble(&traffic);
        assert_eq!(found.remove(0), Seen::Defect(1, CanDefect::ClockWithoutStatus));
        assert_eq!(found.remove(0), Seen::Defect(0, CanDefect::IncrementsWithoutStatus));
        assert_eq!(found, [row(2, 1), row(5, 2)]);

        let mut traffic = frames(&[0, 1]);
        traffic.remove(0);
        assert_eq!(
            assemble(&traffic),
            [
                Seen::Defect(0, CanDefect::StatusWithoutIncrements),
                Seen::Defect(1, CanDefect::ClockWithoutStatus),
                row(2, 1)
            ]
        );

        let mut traffic = frames(&[0, 1]);
        traffic[0] = CanFrame::new(0x1A0, &[9; 8]).unwrap();
        assert_eq!(
            assemble(&traffic),
            [Seen::Defect(0, CanDefect::CrcMismatch), Seen::Defect(2, CanDefect::ClockWithoutStatus), row(3, 1)]
        );
    }

    #[test]
    fn increments_of_a_wrong_length_come_between_all_the_same() {
        let mut traffic = frames(&[0, 1]);
        traffic.insert(1, CanFrame::new(0x1A0, &[1, 2, 3]).unwrap());
        assert_eq!(
            assemble(&traffic),
            [
                Seen::Defect(0, CanDefect::IncrementsWithoutStatus),
                Seen::Defect(1, CanDefect::WrongLength),
                Seen::Defect(2, CanDefect::StatusWithoutIncrements),
                Seen::Defect(3, CanDefect::ClockWithoutStatus),
                row(4, 1)
            ]
        );
    }

    #[test]
    fn a_clock_that_jumps_is_doubted_once_and_a_new_course_is_believed() {
        let clock = |sequence, clock_count| CanIdMap::default().frames(&Sample { clock_count, ..sample(sequence) })[2];
        let defects =
            |traffic: &[CanFrame]| assemble(traffic).iter().filter(|event| matches!(event, Seen::Defect(..))).count();
        let mut corrupt = frames(&[0, 1, 2, 3]);
        corrupt[5] = clock(1, 99);
        assert_eq!(defects(&corrupt), 1);
        let mut jumped = frames(&[0, 1, 2, 3]);
        for s in 1..4 {
            jumped[3 * usize::from(s) + 2] = clock(s, 90_000_000 + u64::from(s) * CLOCK_PER_SAMPLE);
        }
        assert_eq!(defects(&jumped), 1);
        let mut reset = frames(&[5, 6, 0, 1]);
        reset[8] = clock(0, 500_000);
        reset[11] = clock(1, 1_000_000);
        assert_eq!(defects(&reset), 0);
    }
}
