//! From events and serial bytes to rows and defects.

use std::collections::HashMap;

use geu_protocol::can::{AssembledSample, Assembler, AssemblerEvent, CanDefect, DefectBytes, Role};
use geu_protocol::capture::{CaptureRecord, Format, Frame, RecordPosition, Timestamp};
use geu_protocol::command::{COMMAND_LENGTHS, REPLY_LENGTHS};
use geu_protocol::continuity::ClockCheck;
use geu_protocol::excerpt::excerpt;
use geu_protocol::serial::{Deframer, DeframerEvent, FrameType, MAX_FRAME, read_data};
use geu_protocol::{CanIdMap, Sample};

use crate::defect::DefectKind;
use crate::row::{ReceivedSample, Sink};
use crate::summary::{DecodeSummary, Flow};

#[derive(Debug, Clone, Default)]
pub struct DecoderOptions {
    pub plan: CanIdMap,
    /// The interface whose rows are wanted, where several carry the unit; otherwise the first that does.
    pub interface: Option<String>,
    /// Format of the inputs; otherwise told from their content.
    pub format: Option<Format>,
    pub baud: Option<u32>,
}

/// What is known of a frame: when and where.
#[derive(Debug, Clone, Copy)]
struct Stamp {
    time: Option<Timestamp>,
    place: RecordPosition,
    input: u32,
}

/// Turns the content of inputs, one after the other, into rows and defects.
#[derive(Debug)]
pub struct Decoder {
    plan: CanIdMap,
    buses: Vec<Bus>,
    places: HashMap<Vec<u8>, usize>,
    /// Frames of the unit on interfaces beyond [`MAX_INTERFACES`].
    beyond: u64,
    /// The bus of the frame before; frames of one bus mostly follow each other.
    last_bus: usize,
    choice: InterfaceSelection,
    /// Whether the user named the interface.
    is_named: bool,
    /// How many of the buses the inputs before had.
    known: usize,
    serial: Serial,
    /// Whether the inputs were not read to their end.
    is_stopped: bool,
    flow: Flow,
}

#[derive(Debug)]
enum InterfaceSelection {
    /// The one of this name, in every input.
    Named(Vec<u8>),
    /// The first that gives a row.
    First,
    /// The one of the inputs before; another only where this one is not in the present input.
    Before(usize),
    Made(usize),
}

/// Rows that an interface known beside the chosen one must give, without a frame of the chosen one, to take its place.
const ROWS_TO_TAKE_OVER: usize = 3;

/// Defects told of a bus before it is chosen are kept; no more than so many.
const MAX_EARLY: usize = 1000;

/// Interfaces that are told apart; a bench has a handful. Frames on more are counted together.
const MAX_INTERFACES: usize = 256;

/// An interface that carries the unit's identifiers.
#[derive(Debug)]
struct Bus {
    name: Vec<u8>,
    assembler: Assembler<Stamp>,
    tally: Tally,
    /// Whether it ever gave a row.
    is_proven: bool,
}

/// What one interface brought in the present input.
#[derive(Debug, Default)]
struct Tally {
    frames: u64,
    decoded: u64,
    commands: u64,
    replies: u64,
    /// Rows before the choice.
    rows: Vec<AssembledSample<Stamp>>,
    defects: Vec<(Stamp, CanDefect, DefectBytes)>,
    /// Defects beyond those kept, by the order of [`CanDefect::ALL`].
    more: [u64; CanDefect::ALL.len()],
}

#[derive(Debug, Default)]
struct Serial {
    deframer: Deframer,
    carry: Vec<u8>,
    clock: ClockCheck,
    /// Which input begins at which offset of the stream.
    starts: Vec<(u64, u32)>,
    total: u64,
    /// Whether a sync was rejected inside the run of bytes that is being skipped.
    rejected: bool,
}

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
            flow: Flow::default(),
        }
    }

    /// Says that what comes now is from this input.
    pub fn begin(&mut self, name: &str, sink: &mut impl Sink) {
        if !self.is_named {
            self.settle(sink);
        }
        self.flow.begin(name);
    }

    /// What has been found so far.
    pub fn summary(&self) -> &DecodeSummary {
        &self.flow.summary
    }

    /// Says what the present input is.
    pub fn describe(&mut self, kind: &str) {
        if let Some((_, known)) = self.flow.summary.inputs.last_mut() {
            kind.clone_into(known);
        }
    }

    pub fn into_summary(self) -> DecodeSummary {
        self.flow.summary
    }

    /// Counts records as their reader counts them; they must equal the events.
    pub fn count_records(&mut self, records: u64) {
        self.flow.summary.account.records += records;
    }

    /// Takes a record of a capture, or a live CAN frame.
    #[inline]
    pub fn event(&mut self, place: RecordPosition, event: CaptureRecord, sink: &mut impl Sink) {
        let DecodeSummary { account, others, rows, .. } = &mut self.flow.summary;
        match event {
            CaptureRecord::Frame(frame) => {
                if *rows == 0 && !frame.extended {
                    others.push(frame.id, frame.data);
                }
                let role = if frame.extended { Role::Other } else { self.plan.role(frame.id) };
                if role == Role::Other { account.other += 1 } else { self.unit_frame(role, place, &frame, sink) }
            }
            CaptureRecord::Remote => account.remote += 1,
            CaptureRecord::Fd => account.fd += 1,
            CaptureRecord::Error => account.error += 1,
            CaptureRecord::Remark => account.remarks += 1,
            CaptureRecord::Dropped(count) => {
                account.remarks += 1;
                self.dropped(place, count, sink);
            }
            CaptureRecord::Broken { bytes, cut } => {
                let kind = if cut { DefectKind::CutRecord } else { DefectKind::BrokenRecord };
                self.flow.defect(self.flow.stamp(place, None), kind, bytes, 0, sink);
            }
        }
    }

    /// Takes the news that the receiver lost `count` frames.
    pub fn dropped(&mut self, place: RecordPosition, count: u64, sink: &mut impl Sink) {
        self.flow.defect(self.flow.stamp(place, None), DefectKind::ReceiverDropped, &[], count, sink);
    }

    #[inline]
    fn unit_frame(&mut self, role: Role, place: RecordPosition, frame: &Frame, sink: &mut impl Sink) {
        let Some(index) = self.bus(frame.interface) else {
            self.beyond += 1;
            return;
        };
        let stamp = Stamp { time: frame.time, place, input: self.flow.input() };
        if let InterfaceSelection::Before(before) = self.choice {
            self.follow(before, index, role, sink);
        }
        let Decoder { buses, choice, flow, known, .. } = self;
        let Bus { assembler, tally, is_proven, .. } = &mut buses[index];
        let enough = if index < *known { ROWS_TO_TAKE_OVER } else { 1 };
        tally.frames += 1;
        match role {
            Role::Command | Role::Reply => {
                let (lengths, count) = match role {
                    Role::Command => (COMMAND_LENGTHS, &mut tally.commands),
                    _ => (REPLY_LENGTHS, &mut tally.replies),
                };
                if lengths.contains(&frame.data.len()) {
                    *count += 1;
                } else {
                    let concerned = DefectBytes::new([frame.data, &[]]);
                    tally.defect(choice.is(index), stamp, CanDefect::WrongLength, concerned, flow, sink);
                }
            }
            _ => assembler.push(role, stamp, frame.data, &mut |assembled| {
                *is_proven |= matches!(assembled, AssemblerEvent::Row(_));
                tally.assembled(assembled, index, choice, flow, sink);
            }),
        }
        if let InterfaceSelection::Before(before) = self.choice
            && self.buses[index].tally.rows.len() >= enough
        {
            self.leave(before, index, sink);
        }
    }

    /// Takes notice of a frame of the unit before the choice is made in an input that is not the first.
    #[cold]
    fn follow(&mut self, before: usize, index: usize, role: Role, sink: &mut impl Sink) {
        if index == before {
            self.choice = InterfaceSelection::Made(index);
            let Decoder { buses, flow, .. } = self;
            buses[index].tally.tell_early(flow, sink);
        } else if index >= self.known
            && matches!(role, Role::Status | Role::Clock)
            && self.buses[index].tally.frames == 0
            && self.buses[before].assembler.is_waiting()
        {
            // The interface has another name here: the sample that began in the input before goes on.
            self.buses[index].assembler = std::mem::take(&mut self.buses[before].assembler);
            self.choice = InterfaceSelection::Made(index);
        }
    }

    /// Chooses another interface than in the inputs before; what waits of that one comes first.
    #[cold]
    fn leave(&mut self, before: usize, index: usize, sink: &mut impl Sink) {
        let Decoder { buses, choice, flow, .. } = self;
        *choice = InterfaceSelection::Made(before);
        let Bus { assembler, tally, .. } = &mut buses[before];
        assembler.finish(&mut |assembled| tally.assembled(assembled, before, choice, flow, sink));
        flow.summary.account.decoded += std::mem::take(&mut tally.decoded);
        *choice = InterfaceSelection::Made(index);
        buses[index].tally.tell_early(flow, sink);
    }

    /// Ends an input: makes the choice if it is still to be made, and puts what each interface brought on the account.
    fn settle(&mut self, sink: &mut impl Sink) {
        match self.choice {
            InterfaceSelection::First if !self.buses.is_empty() => {
                let index = self.buses.iter().position(|bus| bus.tally.frames > 0).unwrap_or(0);
                self.choice = InterfaceSelection::Made(index);
                self.buses[index].tally.tell_early(&mut self.flow, sink);
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
            let (account, name) = (&mut flow.summary.account, String::from_utf8_lossy(name));
            let name = excerpt(&name);
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

    #[inline]
    fn bus(&mut self, name: &[u8]) -> Option<usize> {
        if self.buses.get(self.last_bus).is_none_or(|bus| bus.name != name) {
            self.last_bus = self.find_bus(name)?;
        }
        Some(self.last_bus)
    }

    /// The bus of that name, a new one where there is none yet; nothing where there are too many.
    #[cold]
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

    /// Takes serial bytes, with their receive time where it is known.
    pub fn serial(&mut self, bytes: &[u8], time: Option<Timestamp>, sink: &mut impl Sink) {
        let Decoder { serial, flow, .. } = self;
        let Serial { deframer, carry, clock, starts, total, rejected } = serial;
        if starts.last().is_none_or(|(_, input)| *input != flow.input()) {
            starts.push((*total, flow.input()));
        }
        *total += bytes.len() as u64;
        flow.summary.account.bytes += bytes.len() as u64;
        let mut found = |found: DeframerEvent| serial_found(found, time, clock, starts, rejected, flow, sink);
        // What is left of the bytes before is shorter than a frame: it is completed with as much as settles it.
        let left = carry.len();
        let joined = if left == 0 { 0 } else { bytes.len().min(2 * MAX_FRAME) };
        if left > 0 {
            carry.extend_from_slice(&bytes[..joined]);
            let used = deframer.consume(carry, &mut found);
            if used < left || joined == bytes.len() {
                carry.drain(..used);
                return;
            }
            carry.clear();
            let rest = &bytes[used - left..];
            let used = deframer.consume(rest, &mut found);
            carry.extend_from_slice(&rest[used..]);
            return;
        }
        let used = deframer.consume(bytes, &mut found);
        carry.extend_from_slice(&bytes[used..]);
    }

    /// Says that the inputs were not read to their end: a frame that was under way then is unfinished, no defect.
    pub fn stop(&mut self) {
        self.is_stopped = true;
    }

    /// Ends the inputs: what waits is given out or told as cut.
    pub fn finish(&mut self, sink: &mut impl Sink) -> &DecodeSummary {
        let Decoder { buses, choice, is_stopped, flow, serial, .. } = self;
        let Serial { deframer, carry, clock, starts, rejected, .. } = serial;
        if *is_stopped {
            flow.summary.account.unfinished_bytes += carry.len() as u64;
            carry.clear();
        }
        deframer.finish(carry, &mut |found| serial_found(found, None, clock, starts, rejected, flow, sink));
        carry.clear();
        for (index, Bus { assembler, tally, .. }) in buses.iter_mut().enumerate() {
            // Where the interface of the inputs before is not in the last one, what waits of it is still its own.
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
        &self.flow.summary
    }
}

impl InterfaceSelection {
    #[inline]
    fn is(&self, index: usize) -> bool {
        matches!(self, InterfaceSelection::Made(made) if *made == index)
    }
}

impl Tally {
    #[inline]
    fn assembled(
        &mut self,
        assembled: AssemblerEvent<Stamp>,
        index: usize,
        choice: &mut InterfaceSelection,
        flow: &mut Flow,
        sink: &mut impl Sink,
    ) {
        match assembled {
            AssemblerEvent::Row(received) => {
                if matches!(choice, InterfaceSelection::First) {
                    *choice = InterfaceSelection::Made(index);
                    self.tell_early(flow, sink);
                }
                self.decoded += if received.has_clock { 3 } else { 2 };
                if choice.is(index) {
                    let Stamp { time, place, input } = received.stamp;
                    let row = row(received.sample, received.has_clock, time);
                    flow.row((place, input), &row, true, sink);
                } else if matches!(choice, InterfaceSelection::Before(_)) {
                    self.rows.push(received);
                }
            }
            AssemblerEvent::Defect(stamp, defect, concerned) => {
                self.defect(choice.is(index), stamp, defect, concerned, flow, sink);
            }
        }
    }

    #[cold]
    fn defect(
        &mut self,
        is_chosen: bool,
        stamp: Stamp,
        defect: CanDefect,
        concerned: DefectBytes,
        flow: &mut Flow,
        sink: &mut impl Sink,
    ) {
        if is_chosen {
            flow.defect(stamp.into(), DefectKind::Can(defect), concerned.bytes(), 0, sink);
        } else if self.defects.len() < MAX_EARLY {
            self.defects.push((stamp, defect, concerned));
        } else {
            self.more[defect as usize] += 1;
        }
    }

    #[cold]
    fn tell_early(&mut self, flow: &mut Flow, sink: &mut impl Sink) {
        for AssembledSample { stamp: Stamp { time, place, input }, sample, has_clock } in std::mem::take(&mut self.rows)
        {
            flow.row((place, input), &row(sample, has_clock, time), true, sink);
        }
        for (stamp, defect, concerned) in std::mem::take(&mut self.defects) {
            flow.defect(stamp.into(), DefectKind::Can(defect), concerned.bytes(), 0, sink);
        }
        for (defect, more) in CanDefect::ALL.into_iter().zip(std::mem::take(&mut self.more)) {
            flow.count_defects(DefectKind::Can(defect), more);
        }
    }
}

impl From<Stamp> for crate::summary::At {
    fn from(stamp: Stamp) -> crate::summary::At {
        crate::summary::At { place: stamp.place, input: stamp.input, time: stamp.time }
    }
}

/// A row with its receive time, or with the clock count in its place.
#[inline]
fn row(sample: Sample, has_clock: bool, received: Option<Timestamp>) -> ReceivedSample {
    let clock = || has_clock.then(|| Timestamp { t_ns: sample.clock_count as i64 * 1_000, digits: 6 });
    ReceivedSample { time: received.or_else(clock), is_received: received.is_some(), sample, has_clock }
}

#[inline]
fn serial_found(
    found: DeframerEvent,
    time: Option<Timestamp>,
    clock: &mut ClockCheck,
    starts: &[(u64, u32)],
    rejected: &mut bool,
    flow: &mut Flow,
    sink: &mut impl Sink,
) {
    let place = |at: u64| {
        let (start, input) = starts.iter().rev().find(|(start, _)| *start <= at).copied().unwrap_or_default();
        (RecordPosition::Offset(at - start), input)
    };
    let at = |at: u64| {
        let (place, input) = place(at);
        crate::summary::At { place, input, time }
    };
    match found {
        DeframerEvent::Frame { at: offset, kind, payload } => {
            let length = geu_protocol::serial::OVERHEAD as u64 + payload.len() as u64;
            let account = &mut flow.summary.account;
            match kind {
                FrameType::Data => {
                    account.decoded_bytes += length;
                    flow.summary.serial_frames += 1;
                    let sample = read_data(payload);
                    let follows = clock.accepts(sample.sequence, sample.clock_count);
                    flow.row(place(offset), &row(sample, true, time), follows, sink);
                    if !follows {
                        flow.defect(at(offset), DefectKind::ClockInconsistent, payload, 0, sink);
                    }
                }
                FrameType::Command => {
                    account.command_bytes += length;
                    flow.summary.serial_frames += 1;
                }
                FrameType::Reply => {
                    account.reply_bytes += length;
                    flow.summary.serial_frames += 1;
                }
            }
        }
        DeframerEvent::Rejected { at: offset, defect, bytes } => {
            *rejected = true;
            flow.defect(at(offset), DefectKind::Serial(defect), bytes, 0, sink);
        }
        DeframerEvent::Skipped { at: offset, length, first } => {
            flow.summary.account.resynchronised_bytes += length;
            if !std::mem::take(rejected) {
                flow.defect(at(offset), DefectKind::Noise, first, 0, sink);
            }
        }
    }
}
