//! Samples from INCREMENTS, STATUS and CLOCK in any traffic.

use super::{LENGTH, Role, is_closed};
use crate::continuity::ClockCheck;
use crate::field::Sample;
use crate::message::{Clock, Increments, Message, Status};
use crate::named;

named! {
    /// Defect of a message of the unit.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
    pub enum CanDefect {
        /// INCREMENTS, STATUS or CLOCK that is not eight bytes long.
        WrongLength = "wrong-length",
        /// INCREMENTS without a STATUS before the next INCREMENTS.
        IncrementsWithoutStatus = "increments-without-status",
        /// STATUS without INCREMENTS before it.
        StatusWithoutIncrements = "status-without-increments",
        /// INCREMENTS and STATUS with a wrong CRC; neither is used.
        CrcMismatch = "crc-mismatch",
        /// CLOCK without a good STATUS before it.
        ClockWithoutStatus = "clock-without-status",
        /// CLOCK with a count that did not advance by 500 000 per sequence step.
        ClockInconsistent = "clock-inconsistent",
    }
}

impl CanDefect {
    /// Number of frames of one such defect.
    pub const fn frames(self) -> u64 {
        if matches!(self, CanDefect::CrcMismatch) { 2 } else { 1 }
    }
}

/// A sample assembled from its frames, with the stamp of its INCREMENTS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AssembledSample<S> {
    pub stamp: S,
    /// The fields; clock count and sensor temperature only if `has_clock`.
    pub sample: Sample,
    pub has_clock: bool,
}

/// Result of the assembler.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AssemblerEvent<S> {
    /// A sample: two frames, or three if it has a clock.
    Row(AssembledSample<S>),
    /// A defect, at the stamp of the (first) frame concerned.
    Defect(S, CanDefect, DefectBytes),
}

/// Result of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress<S> {
    /// The sample is not complete.
    Waiting,
    Row(AssembledSample<S>),
    /// Out of order or with an error.
    Irregular,
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

/// Assembles samples from INCREMENTS, STATUS and CLOCK in any traffic.
///
/// `S` identifies a frame for the caller: its time, its position in a file.
#[derive(Debug, Clone)]
pub struct Assembler<S> {
    pending: Option<Pending<S>>,
    clock: ClockCheck,
}

/// The frames of a sample that is not complete.
#[derive(Debug, Clone)]
struct Pending<S> {
    /// Time and place of INCREMENTS.
    stamp: S,
    /// INCREMENTS and STATUS.
    data: [u8; 2 * LENGTH],
    /// True once a STATUS with the right CRC came.
    has_status: bool,
}

impl<S: Copy> Pending<S> {
    #[inline]
    fn new(stamp: S, increments: &[u8; LENGTH]) -> Pending<S> {
        let mut data = [0; 2 * LENGTH];
        data[..LENGTH].copy_from_slice(increments);
        Pending { stamp, data, has_status: false }
    }

    fn increments(&self) -> &[u8] {
        &self.data[..LENGTH]
    }

    /// Adds STATUS, if it has the right CRC.
    #[inline]
    fn add_status(&mut self, status: &[u8; LENGTH]) -> bool {
        self.data[LENGTH..].copy_from_slice(status);
        self.has_status = is_closed(&self.data);
        self.has_status
    }

    /// The sample without a clock; `None` without a STATUS.
    #[inline]
    fn row(&self) -> Option<AssembledSample<S>> {
        if !self.has_status {
            return None;
        }
        let mut sample = Sample::default();
        Increments::read(&self.data[..LENGTH], &mut sample);
        Status::read(&self.data[LENGTH..], &mut sample);
        Some(AssembledSample { stamp: self.stamp, sample, has_clock: false })
    }
}

impl<S: Copy> Default for Assembler<S> {
    fn default() -> Self {
        Assembler { pending: None, clock: ClockCheck::default() }
    }
}

impl<S: Copy> Assembler<S> {
    /// Reads the next INCREMENTS, STATUS or CLOCK (any other role is ignored).
    #[inline]
    pub fn push(&mut self, role: Role, stamp: S, data: &[u8], sink: &mut impl FnMut(AssemblerEvent<S>)) {
        if !matches!(role, Role::Increments | Role::Status | Role::Clock) {
            return;
        }
        match self.advance(role, || stamp, data) {
            Progress::Waiting => {}
            Progress::Row(row) => sink(AssemblerEvent::Row(row)),
            Progress::Irregular => self.irregular(role, stamp, data, sink),
        }
    }

    /// Reads INCREMENTS, STATUS or CLOCK in their usual order and without an error; [`Assembler::irregular`] must read any other.
    // One caller, which passes much by value.
    #[inline(always)]
    pub fn advance(&mut self, role: Role, stamp: impl FnOnce() -> S, data: &[u8]) -> Progress<S> {
        let Ok(bytes) = <&[u8; LENGTH]>::try_from(data) else { return Progress::Irregular };
        match (role, &mut self.pending) {
            (Role::Increments, None) => {
                self.pending = Some(Pending::new(stamp(), bytes));
                Progress::Waiting
            }
            (Role::Status, Some(pending @ Pending { has_status: false, .. })) => match pending.add_status(bytes) {
                true => Progress::Waiting,
                false => Progress::Irregular,
            },
            (Role::Clock, Some(pending)) => {
                let Some(mut row) = pending.row() else { return Progress::Irregular };
                row.has_clock = true;
                Clock::read(bytes, &mut row.sample);
                if !self.clock.accepts(row.sample.sequence, row.sample.clock_count) {
                    return Progress::Irregular;
                }
                self.pending = None;
                Progress::Row(row)
            }
            _ => Progress::Irregular,
        }
    }

    /// Reads a frame that [`Assembler::advance`] found irregular.
    #[cold]
    pub fn irregular(&mut self, role: Role, stamp: S, data: &[u8], sink: &mut impl FnMut(AssemblerEvent<S>)) {
        if role == Role::Increments {
            self.finish(sink);
        }
        let Ok(bytes) = <&[u8; LENGTH]>::try_from(data) else {
            return defect(stamp, CanDefect::WrongLength, [data, &[]], sink);
        };
        let pending = self.pending.take();
        if let Some(row) = pending.as_ref().and_then(Pending::row) {
            sink(AssemblerEvent::Row(row));
            let kind =
                if role == Role::Status { CanDefect::StatusWithoutIncrements } else { CanDefect::ClockInconsistent };
            return defect(stamp, kind, [bytes, &[]], sink);
        }
        match (role, pending) {
            (Role::Increments, _) => self.pending = Some(Pending::new(stamp, bytes)),
            (Role::Status, Some(first)) => {
                defect(first.stamp, CanDefect::CrcMismatch, [first.increments(), bytes], sink);
            }
            (Role::Status, None) => defect(stamp, CanDefect::StatusWithoutIncrements, [bytes, &[]], sink),
            (_, pending) => {
                // INCREMENTS, if any, still wait for their STATUS.
                self.pending = pending;
                defect(stamp, CanDefect::ClockWithoutStatus, [bytes, &[]], sink);
            }
        }
    }

    /// True if the next frames may complete a sample.
    pub fn is_waiting(&self) -> bool {
        self.pending.is_some()
    }

    /// Reports what is pending, at the end of the traffic.
    #[inline]
    pub fn finish(&mut self, sink: &mut impl FnMut(AssemblerEvent<S>)) {
        let Some(pending) = self.pending.take() else { return };
        match pending.row() {
            Some(row) => sink(AssemblerEvent::Row(row)),
            None => defect(pending.stamp, CanDefect::IncrementsWithoutStatus, [pending.increments(), &[]], sink),
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
    use crate::can::{CanFrame, CanIdMap};
    use crate::field::CLOCK_PER_SAMPLE;

    fn sample(sequence: u16) -> Sample {
        Sample {
            sequence,
            increments: [1, -2, 3, sequence as i16],
            clock_count: (u64::from(sequence) + 1) * CLOCK_PER_SAMPLE + 7_000_000,
            sensor_centi_c: 7000,
            ..Sample::default()
        }
    }

    /// A row, or a defect and its frame.
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
            assembler.push(plan.role(frame.id()), index, frame.data(), &mut see);
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
    fn a_second_status_ends_the_sample_and_a_short_clock_does_not() {
        let without_clock = |stamp, sequence| {
            let sample = Sample { clock_count: 0, sensor_centi_c: 0, ..sample(sequence) };
            Seen::Row(AssembledSample { stamp, sample, has_clock: false })
        };
        let mut traffic = frames(&[0, 1]);
        traffic.insert(2, traffic[1]);
        assert_eq!(
            assemble(&traffic),
            [
                without_clock(0, 0),
                Seen::Defect(2, CanDefect::StatusWithoutIncrements),
                Seen::Defect(3, CanDefect::ClockWithoutStatus),
                row(4, 1)
            ]
        );
        let mut traffic = frames(&[0, 1]);
        traffic.insert(2, CanFrame::new(0x1A2, &[1, 2, 3]).unwrap());
        assert_eq!(assemble(&traffic), [Seen::Defect(2, CanDefect::WrongLength), row(0, 0), row(4, 1)]);
    }

    #[test]
    fn a_clock_that_jumps_is_rejected_once_and_then_accepted() {
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
