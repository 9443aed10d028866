//! Frames of a described unit in serial bytes.

use std::sync::Arc;

use geu_protocol::capture::Timestamp;
use geu_protocol::deframer::{FrameEvent, FrameStream};
use geu_protocol::layout::{Assembled, Assembly, FrameSet, Sequence, SerialFrames};

use super::Samples;
use crate::decoder::InputStarts;
use crate::defect::DefectKind;
use crate::flow::Stamp;
use crate::row::{DeviceSample, Sink};

/// Frames on a serial line.
#[derive(Debug)]
pub struct Serial {
    stream: FrameStream<SerialFrames>,
    frames: Frames,
}

/// Samples from the frames.
#[derive(Debug)]
struct Frames {
    assembly: Assembly,
    sequence: Sequence,
    starts: InputStarts,
    /// Time and place of the first frame of the sample.
    first: Option<Stamp>,
    /// True if a start was rejected inside the run of bytes that is being skipped.
    is_rejected: bool,
}

impl Serial {
    pub fn new(frames: Arc<FrameSet>) -> Serial {
        let stream = FrameStream::new(SerialFrames::new(frames.clone()));
        let frames = Frames {
            sequence: Sequence::new(&frames),
            assembly: Assembly::new(frames),
            starts: InputStarts::default(),
            first: None,
            is_rejected: false,
        };
        Serial { stream, frames }
    }

    pub fn read(
        &mut self,
        bytes: &[u8],
        time: Option<Timestamp>,
        samples: &mut Samples,
        sink: &mut impl Sink<DeviceSample>,
    ) {
        let Serial { stream, frames } = self;
        frames.starts.note(stream.offset(), &samples.flow);
        stream.push(bytes, &mut |event| frames.report(event, time, samples, sink));
    }

    /// Ends the stream; if `is_stopped`, an incomplete frame is unfinished, else cut.
    pub fn finish(&mut self, is_stopped: bool, samples: &mut Samples, sink: &mut impl Sink<DeviceSample>) {
        let Serial { stream, frames } = self;
        let unfinished = stream.finish(is_stopped, &mut |event| frames.report(event, None, samples, sink));
        samples.flow.summary.account.unfinished_bytes += unfinished as u64;
    }

    /// Time and place of the first frame of a sample that waits.
    pub fn waiting(&self) -> Option<Stamp> {
        self.frames.first.filter(|_| self.frames.assembly.is_waiting())
    }
}

impl Frames {
    #[inline]
    fn report(
        &mut self,
        event: FrameEvent<usize>,
        time: Option<Timestamp>,
        samples: &mut Samples,
        sink: &mut impl Sink<DeviceSample>,
    ) {
        let (FrameEvent::Frame { at, .. } | FrameEvent::Rejected { at, .. } | FrameEvent::Skipped { at, .. }) = event;
        let stamp = self.starts.stamp(at, time);
        let flow = &mut samples.flow;
        match event {
            FrameEvent::Frame { kind, payload, .. } => {
                flow.summary.account.decoded_bytes += payload.len() as u64;
                flow.summary.serial_frames += 1;
                flow.summary.frames[kind].1 += 1;
                let begun = *self.first.get_or_insert(stamp);
                match self.assembly.push(kind, payload) {
                    Assembled::Waiting => {}
                    Assembled::Orphan => {
                        self.first = None;
                        flow.defect(stamp, DefectKind::IncompleteSample, payload, 0, sink);
                    }
                    Assembled::Restarted => {
                        self.first = Some(stamp);
                        flow.defect(begun, DefectKind::IncompleteSample, &[], 0, sink);
                    }
                    Assembled::Complete => {
                        self.first = None;
                        samples.push(begun, false, &mut self.sequence, self.assembly.values(), sink);
                    }
                }
            }
            FrameEvent::Rejected { defect, bytes, .. } => {
                self.is_rejected = true;
                flow.defect(stamp, DefectKind::Serial(defect), bytes, 0, sink);
            }
            FrameEvent::Skipped { length, first, .. } => {
                flow.summary.account.resynchronised_bytes += length;
                if !std::mem::take(&mut self.is_rejected) {
                    flow.defect(stamp, DefectKind::Noise, first, 0, sink);
                }
            }
        }
    }
}
