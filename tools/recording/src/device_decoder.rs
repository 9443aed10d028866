//! Decodes capture records and serial bytes of a described unit to samples and defects.

use std::collections::HashMap;
use std::sync::Arc;

use geu_model::device::Device;
use geu_protocol::capture::{CaptureRecord, Frame, RecordPosition, Timestamp};
use geu_protocol::continuity::SequenceStep;
use geu_protocol::deframer::{FrameEvent, FrameFinder};
use geu_protocol::layout::{Assembled, Assembly, FrameSet, Quantity, Sequence, SerialFrames};

use crate::decoder::DecoderOptions;
use crate::defect::DefectKind;
use crate::input_reader::Decode;
use crate::row::{DeviceSample, Sink};
use crate::summary::{DecodeSummary, Flow, Stamp};

/// Interfaces that are decoded; a bench has a handful.
const MAX_INTERFACES: usize = 256;

/// Decodes inputs, one after the other, to samples and defects.
#[derive(Debug)]
pub struct DeviceDecoder {
    can: Option<Can>,
    serial: Option<Serial>,
    samples: Samples,
    is_stopped: bool,
}

/// Samples of one stream of frames.
#[derive(Debug)]
struct Samples {
    flow: Flow,
    sequence: Sequence,
    /// Values of validity and saturation, with the head and the value that is counted.
    flags: Vec<(usize, usize, bool)>,
    row: DeviceSample,
}

impl Samples {
    fn new(device: &Device, frames: &FrameSet) -> Samples {
        let names = device.heads.iter().map(|head| head.name.clone());
        let flag = |(slot, value): (usize, &geu_protocol::layout::ValueSpec)| match value.quantity {
            Quantity::Valid(head) => Some((slot, head, false)),
            Quantity::Saturated(head) => Some((slot, head, true)),
            _ => None,
        };
        Samples {
            flow: Flow::new(names, Some(device.name.clone())),
            sequence: Sequence::new(frames),
            flags: frames.values.iter().enumerate().filter_map(flag).collect(),
            row: DeviceSample::default(),
        }
    }

    #[inline]
    fn push(&mut self, stamp: Stamp, values: &[f64], sink: &mut impl Sink<DeviceSample>) {
        let step = self.sequence.step(values);
        let row = &mut self.row;
        row.number += match step {
            SequenceStep::First | SequenceStep::Repeat => 0,
            SequenceStep::Gap(missing) => missing + 1,
            _ => 1,
        };
        row.time = stamp.time;
        row.values.clear();
        row.values.extend_from_slice(values);
        for &(slot, head, is_saturated) in &self.flags {
            let (_, invalid, saturated) = &mut self.flow.summary.heads[head];
            match is_saturated {
                true => *saturated += u64::from(values[slot] > 0.0),
                false => *invalid += u64::from(values[slot] == 0.0),
            }
        }
        self.flow.sample(stamp, step, &self.row, sink);
    }
}

/// Messages on CAN.
#[derive(Debug)]
struct Can {
    frames: Arc<FrameSet>,
    /// Identifiers, with the frames that have them.
    ids: HashMap<(u32, bool), Vec<usize>>,
    /// Interfaces by their names.
    buses: HashMap<Vec<u8>, Bus>,
    /// The interface of the rows: named, or the first with a sample.
    chosen: Option<Vec<u8>>,
}

/// One interface.
#[derive(Debug)]
struct Bus {
    assembly: Assembly,
    /// Time and place of the first frame of the sample.
    stamp: Option<Stamp>,
    frames: u64,
}

impl Can {
    fn new(frames: Arc<FrameSet>, interface: Option<&str>) -> Can {
        let mut ids: HashMap<(u32, bool), Vec<usize>> = HashMap::new();
        for (index, frame) in frames.frames.iter().enumerate() {
            if let Some(id) = frame.id {
                ids.entry(id).or_default().push(index);
            }
        }
        Can { frames, ids, buses: HashMap::new(), chosen: interface.map(|name| name.as_bytes().to_vec()) }
    }

    fn frame(&mut self, frame: &Frame, stamp: Stamp, samples: &mut Samples, sink: &mut impl Sink<DeviceSample>) {
        let Can { frames, ids, buses, chosen } = self;
        let Some(own) = ids.get(&(frame.id, frame.extended)) else {
            samples.flow.summary.account.other += 1;
            return;
        };
        let is_other = chosen.as_ref().is_some_and(|chosen| chosen != frame.interface);
        let is_many = buses.len() >= MAX_INTERFACES && !buses.contains_key(frame.interface);
        if is_other || is_many {
            samples.flow.summary.account.elsewhere += 1;
            samples.flow.summary.leave_out(&String::from_utf8_lossy(frame.interface), 1);
            return;
        }
        let bus = match buses.get_mut(frame.interface) {
            Some(bus) => bus,
            None => buses.entry(frame.interface.to_vec()).or_insert_with(|| Bus {
                assembly: Assembly::new(frames.clone()),
                stamp: None,
                frames: 0,
            }),
        };
        let length = frames.frames[own[0]].length();
        if frame.data.len() != length {
            let kind = DefectKind::Can(geu_protocol::can::CanDefect::WrongLength);
            return samples.flow.defect(stamp, kind, frame.data, 0, sink);
        }
        // A frame with another number of its selector carries nothing.
        let Some(&kind) = own.iter().find(|kind| frames.frames[**kind].has_constants(frame.data)) else {
            samples.flow.summary.account.other += 1;
            return;
        };
        if !frames.frames[kind].checks_hold(frame.data) {
            return samples.flow.defect(stamp, DefectKind::MessageCheck, frame.data, 0, sink);
        }
        samples.flow.summary.account.decoded += 1;
        bus.frames += 1;
        let first = *bus.stamp.get_or_insert(stamp);
        match bus.assembly.push(kind, frame.data) {
            Assembled::Waiting => {}
            Assembled::Restarted => {
                bus.stamp = Some(stamp);
                samples.flow.defect(first, DefectKind::IncompleteSample, frame.data, 0, sink);
            }
            Assembled::Complete => {
                bus.stamp = None;
                samples.push(first, bus.assembly.values(), sink);
                if chosen.is_none() {
                    *chosen = Some(frame.interface.to_vec());
                    samples.flow.summary.use_interface(&String::from_utf8_lossy(frame.interface));
                }
            }
        }
    }

    /// Moves the frames of the interfaces that were not chosen.
    fn finish(&mut self, flow: &mut Flow) {
        for (name, bus) in &self.buses {
            if self.chosen.as_ref().is_some_and(|chosen| chosen != name) {
                flow.summary.account.decoded -= bus.frames;
                flow.summary.account.elsewhere += bus.frames;
                flow.summary.leave_out(&String::from_utf8_lossy(name), bus.frames);
            }
        }
    }
}

/// Frames on a serial line.
#[derive(Debug)]
struct Serial {
    finder: FrameFinder<SerialFrames>,
    assembly: Assembly,
    /// Bytes not consumed, shorter than a frame.
    carry: Vec<u8>,
    /// Offset in the stream at which the input began.
    start: u64,
    /// Time and place of the first frame of the sample.
    first: Option<Stamp>,
    /// True if a start was rejected inside the run of bytes that is being skipped.
    is_rejected: bool,
}

impl Serial {
    fn new(frames: Arc<FrameSet>) -> Serial {
        Serial {
            finder: FrameFinder::new(SerialFrames::new(frames.clone())),
            assembly: Assembly::new(frames),
            carry: Vec::new(),
            start: 0,
            first: None,
            is_rejected: false,
        }
    }

    fn read(
        &mut self,
        bytes: &[u8],
        time: Option<Timestamp>,
        is_last: bool,
        samples: &mut Samples,
        sink: &mut impl Sink<DeviceSample>,
    ) {
        let Serial { finder, assembly, carry, start, first, is_rejected } = self;
        let input = samples.flow.input();
        let mut report = |event: FrameEvent<usize>| {
            let (FrameEvent::Frame { at, .. } | FrameEvent::Rejected { at, .. } | FrameEvent::Skipped { at, .. }) =
                event;
            let stamp = Stamp { place: RecordPosition::Offset(at.saturating_sub(*start)), input, time };
            let flow = &mut samples.flow;
            match event {
                FrameEvent::Frame { kind, payload, .. } => {
                    flow.summary.account.decoded_bytes += payload.len() as u64;
                    flow.summary.serial_frames += 1;
                    let begun = *first.get_or_insert(stamp);
                    match assembly.push(kind, payload) {
                        Assembled::Waiting => {}
                        Assembled::Restarted => {
                            *first = Some(stamp);
                            flow.defect(begun, DefectKind::IncompleteSample, payload, 0, sink);
                        }
                        Assembled::Complete => {
                            *first = None;
                            samples.push(begun, assembly.values(), sink);
                        }
                    }
                }
                FrameEvent::Rejected { defect, bytes, .. } => {
                    *is_rejected = true;
                    flow.defect(stamp, DefectKind::Serial(defect), bytes, 0, sink);
                }
                FrameEvent::Skipped { length, first, .. } => {
                    flow.summary.account.resynchronised_bytes += length;
                    if !std::mem::take(is_rejected) {
                        flow.defect(stamp, DefectKind::Noise, first, 0, sink);
                    }
                }
            }
        };
        // The carried bytes are completed with as many as settle them, so that only these are copied.
        let (carried, mut rest) = (carry.len(), bytes);
        if carried > 0 {
            let joined = bytes.len().min(2 * finder.framing().max_length);
            carry.extend_from_slice(&bytes[..joined]);
            let used = finder.consume(carry, &mut report);
            if used < carried || joined == bytes.len() {
                carry.drain(..used);
                rest = &[];
            } else {
                carry.clear();
                rest = &bytes[used - carried..];
            }
        }
        let used = if rest.is_empty() { 0 } else { finder.consume(rest, &mut report) };
        carry.extend_from_slice(&rest[used..]);
        if is_last {
            finder.finish(carry, &mut report);
            carry.clear();
        }
    }
}

impl DeviceDecoder {
    /// A decoder before its first input.
    pub fn new(device: &Device, options: &DecoderOptions) -> DeviceDecoder {
        let (can, serial) = (device.can.as_ref().map(|can| &can.frames), device.serial.as_ref().map(|own| &own.frames));
        // A unit with both links sends the same sequence on each.
        let frames = can.or(serial).cloned().unwrap_or_else(|| unreachable!("a device has a link"));
        DeviceDecoder {
            can: can.map(|frames| Can::new(frames.clone(), options.interface.as_deref())),
            serial: serial.map(|frames| Serial::new(frames.clone())),
            samples: Samples::new(device, &frames),
            is_stopped: false,
        }
    }
}

impl Decode for DeviceDecoder {
    type Row = DeviceSample;

    fn begin(&mut self, name: &str, _sink: &mut impl Sink<DeviceSample>) {
        if let Some(serial) = &mut self.serial {
            serial.start = serial.finder.offset() + serial.carry.len() as u64;
        }
        self.samples.flow.begin(name);
    }

    fn summary(&mut self) -> &mut DecodeSummary {
        &mut self.samples.flow.summary
    }

    #[inline]
    fn event(&mut self, place: RecordPosition, event: CaptureRecord, sink: &mut impl Sink<DeviceSample>) {
        let DeviceDecoder { can, samples, .. } = self;
        let account = &mut samples.flow.summary.account;
        match event {
            CaptureRecord::Frame(frame) => {
                let stamp = samples.flow.stamp(place, frame.time);
                match can {
                    Some(can) => can.frame(&frame, stamp, samples, sink),
                    None => samples.flow.summary.account.other += 1,
                }
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
                samples.flow.defect(samples.flow.stamp(place, None), kind, bytes, 0, sink);
            }
        }
    }

    fn dropped(&mut self, place: RecordPosition, count: u64, sink: &mut impl Sink<DeviceSample>) {
        let flow = &mut self.samples.flow;
        flow.defect(flow.stamp(place, None), DefectKind::ReceiverDropped, &[], count, sink);
    }

    fn serial(&mut self, bytes: &[u8], time: Option<Timestamp>, sink: &mut impl Sink<DeviceSample>) {
        let account = &mut self.samples.flow.summary.account;
        account.bytes += bytes.len() as u64;
        match &mut self.serial {
            Some(serial) => serial.read(bytes, time, false, &mut self.samples, sink),
            None => account.resynchronised_bytes += bytes.len() as u64,
        }
    }

    fn stop(&mut self) {
        self.is_stopped = true;
    }

    fn finish(&mut self, sink: &mut impl Sink<DeviceSample>) {
        if let Some(serial) = &mut self.serial {
            if self.is_stopped {
                self.samples.flow.summary.account.unfinished_bytes += serial.carry.len() as u64;
                serial.carry.clear();
            }
            serial.read(&[], None, true, &mut self.samples, sink);
        }
        if let Some(can) = &mut self.can {
            can.finish(&mut self.samples.flow);
        }
        self.samples.flow.finish();
    }

    fn into_summary(self) -> DecodeSummary {
        self.samples.flow.summary
    }
}
