//! Decodes capture records and serial bytes to rows and defects.

mod bus;
mod serial;

use std::collections::HashMap;

use geu_protocol::can::{Assembler, AssemblerEvent, CanDefect, DefectBytes, Progress, Role};
use geu_protocol::capture::{CaptureRecord, Format, Frame, RecordPosition, Timestamp};
use geu_protocol::command::{COMMAND_LENGTHS, REPLY_LENGTHS};
use geu_protocol::continuity::ClockCheck;
use geu_protocol::excerpt::excerpt_of_name;
use geu_protocol::{CanIdMap, Gyro};

use self::bus::{Bus, InterfaceSelection};
pub use self::serial::InputStarts;
use self::serial::Serial;
use crate::archive::{ArchiveRows, ArchiveUnit, TimeRange};
use crate::defect::DefectKind;
use crate::flow::Flow;
use crate::input_reader::Decode;
use crate::row::{ReceivedSample, Sink};
use crate::summary::DecodeSummary;

#[derive(Debug, Clone, Default)]
pub struct DecoderOptions {
    pub plan: CanIdMap,
    /// Interface of the unit, if a capture has several; otherwise the first with frames of the unit.
    pub interface: Option<String>,
    /// Format of the inputs; otherwise detected from their content.
    pub format: Option<&'static Format>,
    pub baud: Option<u32>,
    /// Times of the rows of archives; other inputs are then refused.
    pub range: Option<TimeRange>,
    /// True if bytes are read, and rows of archives are no input.
    pub reads_no_archives: bool,
}

/// Decodes inputs, one after the other, to rows and defects.
#[derive(Debug)]
pub struct Decoder {
    plan: CanIdMap,
    buses: Vec<Bus>,
    places: HashMap<Vec<u8>, usize>,
    /// Frames of the unit on interfaces beyond [`MAX_INTERFACES`].
    beyond: u64,
    /// The bus that was looked for last.
    last_bus: usize,
    choice: InterfaceSelection,
    /// True if the user named the interface.
    is_named: bool,
    /// Number of buses in the inputs before.
    known: usize,
    serial: Serial,
    /// True if the inputs were not read to their end.
    is_stopped: bool,
    flow: Flow,
    /// Clock of the rows of archives.
    clock: ClockCheck,
}

/// Rows of another known interface, without a frame of the chosen one, after which it is chosen instead.
const ROWS_TO_TAKE_OVER: usize = 3;

/// Interfaces that are decoded separately; a bench has a handful. Frames on more are counted together.
const MAX_INTERFACES: usize = 256;

impl Decoder {
    /// A decoder before its first input.
    pub fn new(options: &DecoderOptions) -> Decoder {
        Decoder {
            plan: options.plan,
            buses: Vec::new(),
            places: HashMap::new(),
            beyond: 0,
            last_bus: 0,
            is_named: options.interface.is_some(),
            choice: options
                .interface
                .as_ref()
                .map_or(InterfaceSelection::First, |name| InterfaceSelection::Named(name.clone().into_bytes())),
            known: 0,
            serial: Serial::default(),
            is_stopped: false,
            flow: Flow::new(Gyro::NAMES.map(str::to_owned), None),
            clock: ClockCheck::default(),
        }
    }

    // A function for each message: a frame passes through one, and the others need no registers that are saved for it.
    #[inline(never)]
    fn increments(&mut self, place: RecordPosition, frame: &Frame, sink: &mut impl Sink) {
        self.unit_frame(Role::Increments, place, frame, sink);
    }

    #[inline(never)]
    fn status(&mut self, place: RecordPosition, frame: &Frame, sink: &mut impl Sink) {
        self.unit_frame(Role::Status, place, frame, sink);
    }

    #[inline(never)]
    fn clock(&mut self, place: RecordPosition, frame: &Frame, sink: &mut impl Sink) {
        self.unit_frame(Role::Clock, place, frame, sink);
    }

    /// Reads a COMMAND or a REPLY.
    #[inline(never)]
    fn dialogue(&mut self, role: Role, place: RecordPosition, frame: &Frame, sink: &mut impl Sink) {
        self.unit_frame(role, place, frame, sink);
    }

    #[inline(always)]
    fn unit_frame(&mut self, role: Role, place: RecordPosition, frame: &Frame, sink: &mut impl Sink) {
        match self.choice {
            InterfaceSelection::Made(index)
                if self.flow.summary.rows > 0 && is_same(&self.buses[index].name, frame.interface) =>
            {
                self.frame_of(index, true, role, place, frame, sink);
            }
            _ => self.frame_of_other(role, place, frame, sink),
        }
    }

    /// Reads a frame of the unit before the first row, or on another interface than the chosen one.
    #[cold]
    fn frame_of_other(&mut self, role: Role, place: RecordPosition, frame: &Frame, sink: &mut impl Sink) {
        self.note_before_rows(frame);
        let Some(index) = self.bus(frame.interface) else {
            self.beyond += 1;
            return;
        };
        if let InterfaceSelection::Before(before) = self.choice {
            self.follow(before, index, role, sink);
        }
        self.frame_of(index, self.choice.is(index), role, place, frame, sink);
        if let InterfaceSelection::Before(before) = self.choice {
            let enough = if index < self.known { ROWS_TO_TAKE_OVER } else { 1 };
            if self.buses[index].tally.rows.len() >= enough {
                self.leave(before, index, sink);
            }
        }
    }

    /// Reads a frame of the unit on the interface of this index.
    #[inline(always)]
    fn frame_of(
        &mut self,
        index: usize,
        is_chosen: bool,
        role: Role,
        place: RecordPosition,
        frame: &Frame,
        sink: &mut impl Sink,
    ) {
        let Decoder { buses, choice, flow, .. } = self;
        let Bus { assembler, tally, is_proven, .. } = &mut buses[index];
        tally.frames += 1;
        match role {
            Role::Command if COMMAND_LENGTHS.contains(&frame.data.len()) => tally.commands += 1,
            Role::Reply if REPLY_LENGTHS.contains(&frame.data.len()) => tally.replies += 1,
            Role::Command | Role::Reply => {
                let (stamp, concerned) = (flow.stamp(place, frame.time), DefectBytes::new([frame.data, &[]]));
                tally.defect(is_chosen, stamp, CanDefect::WrongLength, concerned, flow, sink);
            }
            _ => match assembler.advance(role, || flow.stamp(place, frame.time), frame.data) {
                Progress::Waiting => {}
                Progress::Row(row) => {
                    *is_proven = true;
                    tally.row(row, index, is_chosen, choice, flow, sink);
                }
                Progress::Irregular => self.irregular(index, role, place, frame, sink),
            },
        }
    }

    /// Reads a frame that [`Assembler::advance`] found irregular.
    #[cold]
    fn irregular(&mut self, index: usize, role: Role, place: RecordPosition, frame: &Frame, sink: &mut impl Sink) {
        let Decoder { buses, choice, flow, .. } = self;
        let Bus { assembler, tally, is_proven, .. } = &mut buses[index];
        let stamp = flow.stamp(place, frame.time);
        assembler.irregular(role, stamp, frame.data, &mut |assembled| {
            *is_proven |= matches!(assembled, AssemblerEvent::Row(_));
            tally.assembled(assembled, index, choice, flow, sink);
        });
    }

    /// Updates the choice by a frame of the unit, if it is still open in an input after the first.
    #[cold]
    fn follow(&mut self, before: usize, index: usize, role: Role, sink: &mut impl Sink) {
        if index == before {
            self.choice = InterfaceSelection::Made(index);
            let Decoder { buses, flow, .. } = self;
            buses[index].tally.report_early(flow, sink);
        } else if index >= self.known
            && matches!(role, Role::Status | Role::Clock)
            && self.buses[index].tally.frames == 0
            && self.buses[before].assembler.is_waiting()
        {
            // The interface has another name here: the sample that began in the input before continues.
            self.buses[index].assembler = std::mem::take(&mut self.buses[before].assembler);
            self.choice = InterfaceSelection::Made(index);
        }
    }

    /// Chooses another interface than in the inputs before, after the pending sample of that one.
    #[cold]
    fn leave(&mut self, before: usize, index: usize, sink: &mut impl Sink) {
        let Decoder { buses, choice, flow, .. } = self;
        *choice = InterfaceSelection::Made(before);
        let Bus { assembler, tally, .. } = &mut buses[before];
        assembler.finish(&mut |assembled| tally.assembled(assembled, before, choice, flow, sink));
        flow.summary.account.decoded += std::mem::take(&mut tally.decoded);
        *choice = InterfaceSelection::Made(index);
        buses[index].tally.report_early(flow, sink);
    }

    /// Ends an input: makes an open choice and adds the frames of each interface to the account.
    fn settle(&mut self, sink: &mut impl Sink) {
        match self.choice {
            InterfaceSelection::First if !self.buses.is_empty() => {
                let index = self.buses.iter().position(|bus| bus.tally.frames > 0).unwrap_or(0);
                self.choice = InterfaceSelection::Made(index);
                self.buses[index].tally.report_early(&mut self.flow, sink);
            }
            InterfaceSelection::Before(before) => {
                let brings = |bus: &Bus| (bus.tally.rows.len(), bus.tally.frames > 0);
                let most = (0..self.buses.len()).rev().max_by_key(|&index| brings(&self.buses[index]));
                if let Some(index) = most.filter(|&index| index != before && self.buses[index].tally.frames > 0) {
                    self.leave(before, index, sink);
                }
            }
            _ => {}
        }
        let Decoder { buses, choice, flow, .. } = self;
        let mut next = InterfaceSelection::First;
        for (index, Bus { name, assembler, tally, is_proven }) in buses.iter_mut().enumerate() {
            let tally = std::mem::take(tally);
            let (account, name) = (&mut flow.summary.account, excerpt_of_name(name));
            let is_before = matches!(choice, InterfaceSelection::Before(before) if *before == index);
            if choice.is(index) || is_before {
                account.decoded += tally.decoded;
                account.commands += tally.commands;
                account.replies += tally.replies;
                if tally.frames > 0 {
                    flow.summary.use_interface(&name);
                }
                if *is_proven || assembler.is_waiting() {
                    next = InterfaceSelection::Before(index);
                }
            } else {
                *assembler = Assembler::default();
                account.elsewhere += tally.frames;
                flow.summary.leave_out(&name, tally.frames);
            }
        }
        let beyond = std::mem::take(&mut self.beyond);
        flow.summary.account.elsewhere += beyond;
        flow.summary.leave_out("further interfaces:", beyond);
        self.known = self.buses.len();
        self.choice = next;
    }

    /// Keeps the identifiers of frames before the first row.
    #[inline]
    fn note_before_rows(&mut self, frame: &Frame) {
        if self.flow.summary.rows == 0 {
            self.flow.summary.others.push(frame);
        }
    }

    /// The bus of that name; frames of one bus mostly follow each other.
    fn bus(&mut self, name: &[u8]) -> Option<usize> {
        if self.buses.get(self.last_bus).is_none_or(|bus| !is_same(&bus.name, name)) {
            self.last_bus = self.find_bus(name)?;
        }
        Some(self.last_bus)
    }

    /// The bus of that name, added if it is new; `None` if there are too many.
    fn find_bus(&mut self, name: &[u8]) -> Option<usize> {
        if let Some(&index) = self.places.get(name) {
            return Some(index);
        }
        let (index, is_wanted) =
            (self.buses.len(), matches!(&self.choice, InterfaceSelection::Named(wanted) if wanted == name));
        if index >= MAX_INTERFACES && !is_wanted {
            return None;
        }
        if is_wanted {
            self.choice = InterfaceSelection::Made(index);
        }
        let (assembler, tally) = Default::default();
        self.places.insert(name.to_vec(), index);
        self.buses.push(Bus { name: name.to_vec(), assembler, tally, is_proven: false });
        Some(index)
    }
}

/// Equality of names; names of four to eight bytes, as interfaces have, are compared without a loop, and no name by a call.
#[inline]
fn is_same(name: &[u8], other: &[u8]) -> bool {
    name.len() == other.len()
        && match name.len() {
            4..=8 => name.first_chunk::<4>() == other.first_chunk() && name.last_chunk::<4>() == other.last_chunk(),
            _ => name.iter().eq(other),
        }
}

impl Decode for Decoder {
    type Row = ReceivedSample;

    fn begin(&mut self, name: &str, sink: &mut impl Sink) {
        if !self.is_named {
            self.settle(sink);
        }
        self.flow.begin(name);
    }

    fn summary(&mut self) -> &mut DecodeSummary {
        &mut self.flow.summary
    }

    fn into_summary(self) -> DecodeSummary {
        self.flow.summary
    }

    #[inline]
    fn event(&mut self, place: RecordPosition, event: &CaptureRecord, sink: &mut impl Sink) {
        let CaptureRecord::Frame(frame) = event else { return self.flow.other_record(place, event, sink) };
        let role = if frame.extended { Role::Other } else { self.plan.role(frame.id) };
        match role {
            Role::Increments => self.increments(place, frame, sink),
            Role::Status => self.status(place, frame, sink),
            Role::Clock => self.clock(place, frame, sink),
            Role::Command | Role::Reply => self.dialogue(role, place, frame, sink),
            Role::Other => {
                self.flow.summary.account.other += 1;
                self.note_before_rows(frame);
            }
        }
    }

    fn dropped(&mut self, place: RecordPosition, count: u64, sink: &mut impl Sink) {
        self.flow.dropped(place, count, sink);
    }

    fn serial(&mut self, bytes: &[u8], time: Option<Timestamp>, sink: &mut impl Sink) {
        self.serial.read(bytes, time, &mut self.flow, sink);
    }

    fn archive(&self) -> ArchiveUnit {
        ArchiveUnit::iras()
    }

    #[inline]
    fn archived(
        &mut self,
        place: RecordPosition,
        rows: &ArchiveRows,
        row: usize,
        sink: &mut impl Sink,
    ) -> Result<(), String> {
        let sample = rows.sample(row)?;
        let Decoder { flow, clock, .. } = self;
        flow.summary.account.records += 1;
        flow.summary.account.decoded += 1;
        let stamp = flow.stamp(place, sample.time.filter(|_| sample.is_received));
        let follows = !sample.has_clock || clock.accepts(sample.sample.sequence, sample.sample.clock_count);
        flow.row(&stamp, &sample, follows, sink);
        if !follows {
            flow.defect(stamp, DefectKind::ClockInconsistent, &[], 0, sink);
        }
        Ok(())
    }

    fn stop(&mut self) {
        self.is_stopped = true;
    }

    fn finish(&mut self, sink: &mut impl Sink) {
        let Decoder { buses, choice, is_stopped, flow, serial, .. } = self;
        serial.finish(*is_stopped, flow, sink);
        for (index, Bus { assembler, tally, .. }) in buses.iter_mut().enumerate() {
            // If the interface of the inputs before is not in the last one, its pending sample is still reported.
            let mut own = InterfaceSelection::Made(index);
            let is_before = matches!(choice, InterfaceSelection::Before(before) if *before == index);
            let choice = if is_before { &mut own } else { &mut *choice };
            assembler.finish(&mut |assembled| match assembled {
                AssemblerEvent::Defect(..) if *is_stopped && choice.is(index) => flow.summary.account.unfinished += 1,
                assembled => tally.assembled(assembled, index, choice, flow, sink),
            });
        }
        self.settle(sink);
        self.flow.finish();
    }
}
