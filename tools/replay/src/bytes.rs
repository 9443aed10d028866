//! Serial bytes of a recording: frames, and bytes outside of frames.

use geu_daemon::replay::{ReplayItemKind, TrafficOrigin};
use geu_model::units::SAMPLE_INTERVAL_NS;
use geu_protocol::Sample;
use geu_protocol::serial::{
    BITS_PER_BYTE, DEFAULT_BAUD, Deframer, DeframerEvent, FrameType, MAX_FRAME, OVERHEAD, read_data,
};
use geu_recorder::link_model::WireData;

use crate::source::ReplaySource;

/// Largest number of bytes without a frame that wait for the time of the next frame.
const MAX_STRAY: usize = 4096;

impl ReplaySource {
    pub(super) fn push_bytes(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
        let (mut frames, start) = (Vec::new(), (self.deframer.offset() - self.offset) as usize);
        self.deframer.consume(&self.bytes[start..], &mut |found| {
            if let DeframerEvent::Frame { at, kind, payload } = found {
                let sample = (kind == FrameType::Data).then(|| read_data(payload));
                frames.push((at, kind, OVERHEAD + payload.len(), sample));
            }
        });
        self.has_frame |= !frames.is_empty();
        self.send_frames(frames);
        // Bytes without a frame are timed by the rate of the line.
        let end = |source: &ReplaySource| (source.deframer.offset() - source.offset) as usize;
        while !self.is_over() && end(self) > MAX_STRAY {
            let line_ns = MAX_STRAY as i64 * i64::from(BITS_PER_BYTE) * 1_000_000_000 / i64::from(DEFAULT_BAUD);
            self.send_stray(MAX_STRAY, line_ns);
        }
    }

    /// Sends bytes outside of frames before a sample that follows after `until_next_ns`; returns the rest of that time.
    ///
    /// If samples are missing, the bytes are divided among them, with the length of a frame each.
    fn send_stray(&mut self, end: usize, until_next_ns: i64) -> i64 {
        let stray: Vec<u8> = self.bytes[..end].to_vec();
        let missing =
            (until_next_ns / SAMPLE_INTERVAL_NS - 1).clamp(0, stray.len().div_ceil(MAX_FRAME) as i64) as usize;
        let (mut rest, mut left_ns) = (&stray[..], until_next_ns);
        for index in 0..missing {
            let length = if index + 1 == missing { rest.len() } else { MAX_FRAME.min(rest.len()) };
            let (now, later) = rest.split_at(length);
            (rest, left_ns) = (later, left_ns - SAMPLE_INTERVAL_NS);
            let note = self.clock.step(SAMPLE_INTERVAL_NS);
            self.note(note);
            self.send(ReplayItemKind::Content(WireData::Bytes(now.to_vec()), TrafficOrigin::Unit));
        }
        if missing == 0 && !stray.is_empty() {
            let note = self.clock.step(left_ns);
            self.note(note);
            left_ns = 0;
            self.send(ReplayItemKind::Content(WireData::Bytes(stray), TrafficOrigin::Unit));
        }
        self.bytes.drain(..end);
        self.offset += end as u64;
        left_ns
    }

    fn send_frames(&mut self, frames: Vec<(u64, FrameType, usize, Option<Sample>)>) {
        // Taken once: removing frame by frame would move the rest each time.
        let all = std::mem::take(&mut self.bytes);
        let (start, mut used) = (self.offset, 0);
        for (at, kind, length, sample) in frames {
            let begin = (at - start) as usize;
            self.bytes = all[used..begin].to_vec();
            let step_ns = sample.as_ref().map_or(0, |sample| self.clock.by_clock(sample));
            let left_ns = self.send_stray(begin - used, step_ns);
            let note = self.clock.step(left_ns);
            self.note(note);
            let origin = match (kind, sample) {
                (_, Some(sample)) => {
                    self.clock.update(&sample);
                    self.send(ReplayItemKind::Sample { sample, is_can: false });
                    TrafficOrigin::Sample
                }
                (FrameType::Command, _) => TrafficOrigin::Command,
                _ => TrafficOrigin::Unit,
            };
            used = begin + length;
            self.send(ReplayItemKind::Content(WireData::Bytes(all[begin..used].to_vec()), origin));
            self.offset = start + used as u64;
            if self.is_over() {
                break;
            }
        }
        self.bytes = all[used..].to_vec();
    }

    /// Sends the remaining bytes at the time of a next sample.
    pub(super) fn end_bytes(&mut self) {
        if !self.is_over() {
            self.send_stray(self.bytes.len(), SAMPLE_INTERVAL_NS);
        }
        self.bytes.clear();
        (self.deframer, self.offset) = (Deframer::default(), 0);
    }
}
