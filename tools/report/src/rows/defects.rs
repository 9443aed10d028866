//! Defects as JSON lines; repetitions are one line with a count.

use geu_protocol::capture::{RecordPosition, Timestamp};
use geu_protocol::hex::hex;
use geu_recording::{Defect, DefectKind, place_text};

use super::{quote, write_seconds};

/// Writes defects; the last waits for its repetitions. Two hundred megabytes of `EB 90` are one line.
#[derive(Default)]
pub struct DefectLines {
    waiting: Option<Waiting>,
}

struct Waiting {
    input: String,
    first: RecordPosition,
    last: RecordPosition,
    kind: DefectKind,
    bytes: Vec<u8>,
    time: Option<Timestamp>,
    lost: u64,
    count: u64,
}

impl Waiting {
    fn is_repeated_by(&self, defect: &Defect) -> bool {
        self.kind == defect.kind
            && self.bytes == defect.bytes
            && self.time == defect.time
            && self.lost == defect.lost
            && self.input == defect.input
    }
}

impl DefectLines {
    /// Adds a defect: place, kind, bytes in hexadecimal; time and lost samples if they are known.
    pub fn push(&mut self, defect: &Defect, out: &mut Vec<u8>) {
        match &mut self.waiting {
            Some(waiting) if waiting.is_repeated_by(defect) => {
                waiting.count += 1;
                waiting.last = defect.place;
            }
            _ => {
                self.end(out);
                self.waiting = Some(Waiting {
                    input: defect.input.to_owned(),
                    first: defect.place,
                    last: defect.place,
                    kind: defect.kind,
                    bytes: defect.bytes.to_vec(),
                    time: defect.time,
                    lost: defect.lost,
                    count: 1,
                });
            }
        }
    }

    /// Writes the waiting defect: a row or the end of the input follows.
    pub fn end(&mut self, out: &mut Vec<u8>) {
        if let Some(waiting) = self.waiting.take() {
            waiting.write(out);
        }
    }
}

impl Waiting {
    fn write(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(b"{\"place\":");
        quote(&place_text(&self.input, self.first), out);
        out.extend_from_slice(b",\"kind\":");
        quote(self.kind.name(), out);
        out.extend_from_slice(b",\"bytes\":\"");
        out.extend_from_slice(hex(&self.bytes).as_bytes());
        out.extend_from_slice(b"\"");
        if let Some(text) = readable(&self.bytes) {
            out.extend_from_slice(b",\"text\":");
            quote(text, out);
        }
        if let Some(time) = self.time {
            out.extend_from_slice(b",\"t_s\":");
            write_seconds(time, out);
        }
        if self.lost > 0 {
            out.extend_from_slice(format!(",\"lost\":{}", self.lost).as_bytes());
        }
        if self.count > 1 {
            out.extend_from_slice(format!(",\"count\":{},\"last_place\":", self.count).as_bytes());
            quote(&place_text(&self.input, self.last), out);
        }
        out.extend_from_slice(b"}\n");
    }
}

/// The bytes as text if they are printable.
fn readable(bytes: &[u8]) -> Option<&str> {
    let text = std::str::from_utf8(bytes).ok()?;
    (text.len() > 2 && text.chars().all(|letter| letter == '\t' || !letter.is_control())).then_some(text)
}
