//! Messages of a described unit on CAN, on the interface that has them.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use geu_protocol::can::CanDefect;
use geu_protocol::capture::Frame;
use geu_protocol::excerpt::excerpt_of_name;
use geu_protocol::layout::{Assembled, Assembly, FrameSet, Sequence};

use super::Samples;
use crate::defect::DefectKind;
use crate::flow::Stamp;
use crate::row::{DeviceSample, Sink};

/// Interfaces that are decoded; a bench has a handful.
const MAX_INTERFACES: usize = 256;

/// Defects kept of an interface before it is chosen; further ones are counted.
const MAX_EARLY: usize = 1000;

/// Messages on CAN.
#[derive(Debug)]
pub struct Can {
    frames: Arc<FrameSet>,
    sequence: Sequence,
    /// Identifiers, with the frames that have them.
    ids: HashMap<(u32, bool), Vec<usize>>,
    /// Interfaces in the order of their first frames, and their places.
    buses: Vec<Bus>,
    places: HashMap<Vec<u8>, usize>,
    /// The interface of the rows in the present input: named, or the first with a sample.
    chosen: Option<usize>,
    named: Option<Vec<u8>>,
    /// Frames of the unit on interfaces beyond [`MAX_INTERFACES`].
    beyond: u64,
    /// Place of the first message in the summary's frames.
    names: usize,
}

/// One interface.
#[derive(Debug)]
struct Bus {
    name: Vec<u8>,
    assembly: Assembly,
    /// Time and place of the first frame of the sample.
    stamp: Option<Stamp>,
    /// Frames in the present input.
    frames: u64,
    /// Frames read in the present input, and defects before the choice.
    decoded: u64,
    early: Vec<(Stamp, DefectKind, Vec<u8>)>,
    /// Further defects before the choice.
    more: BTreeMap<DefectKind, u64>,
}

impl Can {
    pub fn new(frames: Arc<FrameSet>, interface: Option<&str>, names: usize) -> Can {
        let mut ids: HashMap<(u32, bool), Vec<usize>> = HashMap::new();
        for (index, frame) in frames.frames.iter().enumerate() {
            if let Some(id) = frame.id {
                ids.entry(id).or_default().push(index);
            }
        }
        Can {
            sequence: Sequence::new(&frames),
            frames,
            ids,
            buses: Vec::new(),
            places: HashMap::new(),
            chosen: None,
            named: interface.map(|name| name.as_bytes().to_vec()),
            beyond: 0,
            names,
        }
    }

    /// Place of the interface of that name; `None` if there are too many.
    fn bus(&mut self, name: &[u8]) -> Option<usize> {
        if let Some(&place) = self.places.get(name) {
            return Some(place);
        }
        let is_named = self.named.as_deref() == Some(name);
        if self.buses.len() >= MAX_INTERFACES && !is_named {
            return None;
        }
        let place = self.buses.len();
        self.places.insert(name.to_vec(), place);
        self.buses.push(Bus {
            name: name.to_vec(),
            assembly: Assembly::new(self.frames.clone()),
            stamp: None,
            frames: 0,
            decoded: 0,
            early: Vec::new(),
            more: BTreeMap::new(),
        });
        if is_named {
            self.chosen = Some(place);
        }
        Some(place)
    }

    pub fn frame(&mut self, frame: &Frame, stamp: Stamp, samples: &mut Samples, sink: &mut impl Sink<DeviceSample>) {
        if !self.ids.contains_key(&(frame.id, frame.extended)) {
            samples.flow.summary.account.other += 1;
            return;
        }
        let Some(place) = self.bus(frame.interface) else {
            self.beyond += 1;
            return;
        };
        let is_open = self.chosen.is_none() && self.named.is_none();
        let Can { frames, ids, buses, chosen, sequence, names, .. } = self;
        let (bus, own) = (&mut buses[place], &ids[&(frame.id, frame.extended)]);
        bus.frames += 1;
        if !is_open && *chosen != Some(place) {
            return;
        }
        if frame.data.len() != frames.frames[own[0]].length() {
            return bus.defect(is_open, stamp, DefectKind::Can(CanDefect::WrongLength), frame.data, samples, sink);
        }
        // A frame with another number of its selector carries nothing.
        let Some(&kind) = own.iter().find(|kind| frames.frames[**kind].has_constants(frame.data)) else {
            bus.frames -= 1;
            samples.flow.summary.account.other += 1;
            return;
        };
        if !frames.frames[kind].checks_hold(frame.data) {
            return bus.defect(is_open, stamp, DefectKind::MessageCheck, frame.data, samples, sink);
        }
        bus.decoded += 1;
        samples.flow.summary.frames[*names + kind].1 += 1;
        let first = *bus.stamp.get_or_insert(stamp);
        match bus.assembly.push(kind, frame.data) {
            Assembled::Waiting => {}
            Assembled::Orphan => {
                bus.stamp = None;
                bus.defect(is_open, stamp, DefectKind::IncompleteSample, frame.data, samples, sink);
            }
            Assembled::Restarted => {
                bus.stamp = Some(stamp);
                bus.defect(is_open, first, DefectKind::IncompleteSample, &[], samples, sink);
            }
            Assembled::Complete => {
                bus.stamp = None;
                if is_open {
                    *chosen = Some(place);
                    bus.report_early(samples, sink);
                }
                samples.push(first, true, sequence, buses[place].assembly.values(), sink);
            }
        }
    }

    /// Ends an input: the frames of the interface that was not chosen are of another interface.
    pub fn settle(&mut self, samples: &mut Samples, sink: &mut impl Sink<DeviceSample>) {
        if self.chosen.is_none() && self.named.is_none() {
            self.chosen = self.buses.iter().position(|bus| bus.frames > 0);
            if let Some(place) = self.chosen {
                self.buses[place].report_early(samples, sink);
            }
        }
        for (place, bus) in self.buses.iter_mut().enumerate() {
            let (frames, decoded) = (std::mem::take(&mut bus.frames), std::mem::take(&mut bus.decoded));
            bus.early.clear();
            bus.more.clear();
            let (summary, name) = (&mut samples.flow.summary, excerpt_of_name(&bus.name));
            if self.chosen == Some(place) {
                summary.account.decoded += decoded;
                if frames > 0 {
                    summary.use_interface(&name);
                }
            } else {
                summary.account.elsewhere += frames;
                summary.leave_out(&name, frames);
            }
        }
        let beyond = std::mem::take(&mut self.beyond);
        samples.flow.summary.account.elsewhere += beyond;
        samples.flow.summary.leave_out("further interfaces:", beyond);
        if self.named.is_none() {
            self.chosen = None;
        }
    }
}

impl Bus {
    /// Reports a defect, or keeps it while no interface is chosen.
    fn defect(
        &mut self,
        is_open: bool,
        stamp: Stamp,
        kind: DefectKind,
        bytes: &[u8],
        samples: &mut Samples,
        sink: &mut impl Sink<DeviceSample>,
    ) {
        match is_open {
            false => samples.flow.defect(stamp, kind, bytes, 0, sink),
            true if self.early.len() < MAX_EARLY => self.early.push((stamp, kind, bytes.to_vec())),
            true => *self.more.entry(kind).or_default() += 1,
        }
    }

    /// Reports the defects before the choice.
    fn report_early(&mut self, samples: &mut Samples, sink: &mut impl Sink<DeviceSample>) {
        for (stamp, kind, bytes) in std::mem::take(&mut self.early) {
            samples.flow.defect(stamp, kind, &bytes, 0, sink);
        }
        for (kind, count) in std::mem::take(&mut self.more) {
            samples.flow.count_defects(kind, count);
        }
    }
}

impl Can {
    /// Time and place of the first frame of a sample that waits.
    pub fn waiting(&self) -> Option<Stamp> {
        let bus = &self.buses[self.chosen?];
        bus.stamp.filter(|_| bus.assembly.is_waiting())
    }
}
