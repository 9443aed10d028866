//! Serial bytes to rows and defects.

use geu_protocol::capture::{RecordPosition, Timestamp};
use geu_protocol::continuity::ClockCheck;
use geu_protocol::deframer::FrameStream;
use geu_protocol::serial::{DeframerEvent, FrameType, OVERHEAD, UnitFrames, read_data};

use crate::defect::DefectKind;
use crate::flow::{Flow, Stamp};
use crate::row::{ReceivedSample, Sink};

#[derive(Debug, Default)]
pub struct Serial {
    stream: FrameStream<UnitFrames>,
    events: Events,
}

#[derive(Debug, Default)]
struct Events {
    clock: ClockCheck,
    starts: InputStarts,
    /// True if a sync was rejected inside the run of bytes that is being skipped.
    is_rejected: bool,
}

/// Offset in the stream at which each input begins.
#[derive(Debug, Default)]
pub struct InputStarts(Vec<(u64, u32)>);

impl InputStarts {
    /// Notes the offset at which a new input of `flow` begins.
    pub fn note(&mut self, offset: u64, flow: &Flow) {
        if self.0.last().is_none_or(|(_, input)| *input != flow.input()) {
            self.0.push((offset, flow.input()));
        }
    }

    /// Input and place in it of an offset.
    pub fn stamp(&self, at: u64, time: Option<Timestamp>) -> Stamp {
        let (start, input) = self.0.iter().rev().find(|(start, _)| *start <= at).copied().unwrap_or_default();
        Stamp { place: RecordPosition::Offset(at - start), input, time }
    }
}

impl Serial {
    pub fn read(&mut self, bytes: &[u8], time: Option<Timestamp>, flow: &mut Flow, sink: &mut impl Sink) {
        let Serial { stream, events } = self;
        events.starts.note(stream.offset(), flow);
        flow.summary.account.bytes += bytes.len() as u64;
        stream.push(bytes, &mut |event| events.report(event, time, flow, sink));
    }

    /// Ends the stream; if `is_stopped`, an incomplete frame is unfinished, else cut.
    pub fn finish(&mut self, is_stopped: bool, flow: &mut Flow, sink: &mut impl Sink) {
        let Serial { stream, events } = self;
        let unfinished = stream.finish(is_stopped, &mut |event| events.report(event, None, flow, sink));
        flow.summary.account.unfinished_bytes += unfinished as u64;
    }
}

impl Events {
    #[inline]
    fn report(&mut self, event: DeframerEvent, time: Option<Timestamp>, flow: &mut Flow, sink: &mut impl Sink) {
        let (DeframerEvent::Frame { at, .. } | DeframerEvent::Rejected { at, .. } | DeframerEvent::Skipped { at, .. }) =
            event;
        let stamp = self.starts.stamp(at, time);
        let account = &mut flow.summary.account;
        match event {
            DeframerEvent::Frame { kind, payload, .. } => {
                let length = (OVERHEAD + payload.len()) as u64;
                match kind {
                    FrameType::Data => account.decoded_bytes += length,
                    FrameType::Command => account.command_bytes += length,
                    FrameType::Reply => account.reply_bytes += length,
                }
                flow.summary.serial_frames += 1;
                if kind == FrameType::Data {
                    let sample = read_data(payload);
                    let follows = self.clock.accepts(sample.sequence, sample.clock_count);
                    flow.row(&stamp, &ReceivedSample::new(sample, true, time), follows, sink);
                    if !follows {
                        flow.defect(stamp, DefectKind::ClockInconsistent, payload, 0, sink);
                    }
                }
            }
            DeframerEvent::Rejected { defect, bytes, .. } => {
                self.is_rejected = true;
                flow.defect(stamp, DefectKind::Serial(defect), bytes, 0, sink);
            }
            DeframerEvent::Skipped { length, first, .. } => {
                account.resynchronised_bytes += length;
                if !std::mem::take(&mut self.is_rejected) {
                    flow.defect(stamp, DefectKind::Noise, first, 0, sink);
                }
            }
        }
    }
}
