//! Serial bytes of a recording: frames, and bytes outside of frames.

use geu_daemon::replay::{ReplayItemKind, TrafficOrigin};
use geu_protocol::serial::{BITS_PER_BYTE, DEFAULT_BAUD, MAX_FRAME};
use geu_recorder::link_model::WireData;

use crate::frames::{Finder, UnitFrame};
use crate::source::ReplaySource;

/// Largest number of bytes without a frame that wait for the time of the next frame.
const MAX_STRAY: usize = 4096;

impl ReplaySource {
    pub(super) fn push_bytes(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
        let start = (self.finder.offset() - self.offset) as usize;
        let frames = self.finder.consume(&self.bytes[start..]);
        self.has_frame |= !frames.is_empty();
        self.send_frames(frames);
        // Bytes without a frame are timed by the rate of the line.
        let end = |source: &ReplaySource| (source.finder.offset() - source.offset) as usize;
        while !self.is_over() && end(self) > MAX_STRAY {
            let baud = self.device.serial.as_ref().map_or(DEFAULT_BAUD, |serial| serial.baud);
            let line_ns = MAX_STRAY as i64 * i64::from(BITS_PER_BYTE) * 1_000_000_000 / i64::from(baud);
            self.send_stray(MAX_STRAY, line_ns);
        }
    }

    /// Sends bytes outside of frames before a sample that follows after `until_next_ns`; returns the rest of that time.
    ///
    /// If samples are missing, the bytes are divided among them, with the length of a frame each.
    fn send_stray(&mut self, end: usize, until_next_ns: i64) -> i64 {
        let stray: Vec<u8> = self.bytes[..end].to_vec();
        let interval_ns = self.device.interval_ns();
        let missing = (until_next_ns / interval_ns - 1).clamp(0, stray.len().div_ceil(MAX_FRAME) as i64) as usize;
        let (mut rest, mut left_ns) = (&stray[..], until_next_ns);
        for index in 0..missing {
            let length = if index + 1 == missing { rest.len() } else { MAX_FRAME.min(rest.len()) };
            let (now, later) = rest.split_at(length);
            (rest, left_ns) = (later, left_ns - interval_ns);
            let note = self.clock.step(interval_ns);
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

    fn send_frames(&mut self, frames: Vec<UnitFrame>) {
        // Taken once: removing frame by frame would move the rest each time.
        let all = std::mem::take(&mut self.bytes);
        let (start, mut used) = (self.offset, 0);
        for UnitFrame { at, length, origin, sample } in frames {
            let end = (at + length as u64 - start) as usize;
            let begin = (at.saturating_sub(start) as usize).max(used);
            self.bytes = all[used..begin].to_vec();
            let step_ns = sample.as_ref().map_or(0, |sample| self.clock.by_clock(sample));
            let left_ns = self.send_stray(begin - used, step_ns);
            let note = self.clock.step(left_ns);
            self.note(note);
            if let Some(sample) = sample {
                self.clock.update(&sample);
                self.send(ReplayItemKind::Sample { sample, is_can: false });
            }
            used = end;
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
            self.send_stray(self.bytes.len(), self.device.interval_ns());
        }
        self.bytes.clear();
        (self.finder, self.offset) = (Finder::new(&self.device), 0);
    }
}
