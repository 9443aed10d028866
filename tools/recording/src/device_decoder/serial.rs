//! Frames of a described unit in serial bytes.

use std::sync::Arc;

use geu_protocol::capture::{RecordPosition, Timestamp};
use geu_protocol::deframer::{FrameEvent, FrameFinder};
use geu_protocol::layout::{Assembled, Assembly, FrameSet, Sequence, SerialFrames};

use super::Samples;
use crate::defect::DefectKind;
use crate::row::{DeviceSample, Sink};
use crate::summary::Stamp;

/// Frames on a serial line.
#[derive(Debug)]
pub struct Serial {
    finder: FrameFinder<SerialFrames>,
    assembly: Assembly,
    sequence: Sequence,
    /// Bytes not consumed, shorter than a frame.
    carry: Vec<u8>,
    /// Offset in the stream at which each input begins.
    starts: Vec<(u64, u32)>,
    /// Time and place of the first frame of the sample.
    first: Option<Stamp>,
    /// True if a start was rejected inside the run of bytes that is being skipped.
    is_rejected: bool,
}

impl Serial {
    pub fn new(frames: Arc<FrameSet>) -> Serial {
        Serial {
            finder: FrameFinder::new(SerialFrames::new(frames.clone())),
            sequence: Sequence::new(&frames),
            assembly: Assembly::new(frames),
            carry: Vec::new(),
            starts: Vec::new(),
            first: None,
            is_rejected: false,
        }
    }

    pub fn read(
        &mut self,
        bytes: &[u8],
        time: Option<Timestamp>,
        is_last: bool,
        samples: &mut Samples,
        sink: &mut impl Sink<DeviceSample>,
    ) {
        let Serial { finder, assembly, sequence, carry, starts, first, is_rejected } = self;
        if starts.last().is_none_or(|(_, input)| *input != samples.flow.input()) {
            starts.push((finder.offset() + carry.len() as u64, samples.flow.input()));
        }
        let mut report = |event: FrameEvent<usize>| {
            let (FrameEvent::Frame { at, .. } | FrameEvent::Rejected { at, .. } | FrameEvent::Skipped { at, .. }) =
                event;
            let (start, input) = starts.iter().rev().find(|(start, _)| *start <= at).copied().unwrap_or_default();
            let stamp = Stamp { place: RecordPosition::Offset(at - start), input, time };
            let flow = &mut samples.flow;
            match event {
                FrameEvent::Frame { kind, payload, .. } => {
                    flow.summary.account.decoded_bytes += payload.len() as u64;
                    flow.summary.serial_frames += 1;
                    flow.summary.frames[kind].1 += 1;
                    let begun = *first.get_or_insert(stamp);
                    match assembly.push(kind, payload) {
                        Assembled::Waiting => {}
                        Assembled::Orphan => {
                            *first = None;
                            flow.defect(stamp, DefectKind::IncompleteSample, payload, 0, sink);
                        }
                        Assembled::Restarted => {
                            *first = Some(stamp);
                            flow.defect(begun, DefectKind::IncompleteSample, &[], 0, sink);
                        }
                        Assembled::Complete => {
                            *first = None;
                            samples.push(begun, false, sequence, assembly.values(), sink);
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

    /// Ends the stream; if `is_stopped`, an incomplete frame is unfinished, else cut.
    pub fn finish(&mut self, is_stopped: bool, samples: &mut Samples, sink: &mut impl Sink<DeviceSample>) {
        if is_stopped {
            samples.flow.summary.account.unfinished_bytes += self.carry.len() as u64;
            self.carry.clear();
        }
        if !self.starts.is_empty() {
            self.read(&[], None, true, samples, sink);
        }
    }

    /// Time and place of the first frame of a sample that waits.
    pub fn waiting(&self) -> Option<Stamp> {
        self.first.filter(|_| self.assembly.is_waiting())
    }
}
