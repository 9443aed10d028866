//! Serial bytes to rows and defects.

use geu_protocol::capture::{RecordPosition, Timestamp};
use geu_protocol::continuity::ClockCheck;
use geu_protocol::serial::{Deframer, DeframerEvent, FrameType, MAX_FRAME, OVERHEAD, read_data};

use crate::defect::DefectKind;
use crate::row::{ReceivedSample, Sink};
use crate::summary::{Flow, Stamp};

#[derive(Debug, Default)]
pub struct Serial {
    deframer: Deframer,
    /// Bytes not consumed, shorter than a frame.
    carry: Vec<u8>,
    total: u64,
    events: Events,
}

#[derive(Debug, Default)]
struct Events {
    clock: ClockCheck,
    /// Offset in the stream at which each input begins.
    starts: Vec<(u64, u32)>,
    /// True if a sync was rejected inside the run of bytes that is being skipped.
    is_rejected: bool,
}

impl Serial {
    pub fn read(&mut self, bytes: &[u8], time: Option<Timestamp>, flow: &mut Flow, sink: &mut impl Sink) {
        let Serial { deframer, carry, total, events } = self;
        if events.starts.last().is_none_or(|(_, input)| *input != flow.input()) {
            events.starts.push((*total, flow.input()));
        }
        *total += bytes.len() as u64;
        flow.summary.account.bytes += bytes.len() as u64;
        let mut report = |event: DeframerEvent| events.report(event, time, flow, sink);
        // The carried bytes are completed with as many as settle them, so that only these are copied.
        let carried = carry.len();
        let mut rest = bytes;
        if carried > 0 {
            let joined = bytes.len().min(2 * MAX_FRAME);
            carry.extend_from_slice(&bytes[..joined]);
            let used = deframer.consume(carry, &mut report);
            if used < carried || joined == bytes.len() {
                carry.drain(..used);
                return;
            }
            carry.clear();
            rest = &bytes[used - carried..];
        }
        let used = deframer.consume(rest, &mut report);
        carry.extend_from_slice(&rest[used..]);
    }

    /// Ends the stream; if `is_stopped`, an incomplete frame is unfinished, else cut.
    pub fn finish(&mut self, is_stopped: bool, flow: &mut Flow, sink: &mut impl Sink) {
        let Serial { deframer, carry, events, .. } = self;
        if is_stopped {
            flow.summary.account.unfinished_bytes += carry.len() as u64;
            carry.clear();
        }
        deframer.finish(carry, &mut |event| events.report(event, None, flow, sink));
        carry.clear();
    }
}

impl Events {
    #[inline]
    fn report(&mut self, event: DeframerEvent, time: Option<Timestamp>, flow: &mut Flow, sink: &mut impl Sink) {
        let (DeframerEvent::Frame { at, .. } | DeframerEvent::Rejected { at, .. } | DeframerEvent::Skipped { at, .. }) =
            event;
        let (start, input) = self.starts.iter().rev().find(|(start, _)| *start <= at).copied().unwrap_or_default();
        let stamp = Stamp { place: RecordPosition::Offset(at - start), input, time };
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
                    flow.row(stamp, &ReceivedSample::new(sample, true, time), follows, sink);
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
