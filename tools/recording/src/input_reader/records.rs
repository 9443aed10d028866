//! Records of a capture, kept by one thread for another.

use geu_protocol::capture::{CaptureRecord, Frame, RecordPosition, Timestamp};

/// Records of lines that follow each other.
#[derive(Default)]
pub struct Records {
    kept: Vec<Kept>,
    /// Names of interfaces, a new one with each change; lines and bytes of broken records.
    texts: Vec<Vec<u8>>,
    /// Index of the last name.
    name: usize,
}

/// Small, as there is one for every line.
#[derive(Clone, Copy)]
struct Kept {
    /// Time, or number of lost frames.
    value: i64,
    data: [u8; 8],
    id: u32,
    text: u32,
    digits: u8,
    length: u8,
    kind: RecordKind,
}

#[derive(Clone, Copy)]
enum RecordKind {
    Frame { timed: bool, extended: bool },
    Remote,
    Fd,
    Error,
    Remark,
    Line,
    Dropped,
    Broken { cut: bool },
}

impl Kept {
    fn new(kind: RecordKind) -> Kept {
        Kept { value: 0, data: [0; 8], id: 0, text: 0, digits: 0, length: 0, kind }
    }
}

impl Records {
    pub fn clear(&mut self) {
        self.kept.clear();
        self.texts.clear();
    }

    pub fn count(&self) -> u64 {
        self.kept.len() as u64
    }

    #[inline]
    pub fn push(&mut self, record: &CaptureRecord) {
        let kept = match record {
            CaptureRecord::Frame(frame) => self.frame(frame),
            CaptureRecord::Remote => Kept::new(RecordKind::Remote),
            CaptureRecord::Fd => Kept::new(RecordKind::Fd),
            CaptureRecord::Error => Kept::new(RecordKind::Error),
            CaptureRecord::Remark => Kept::new(RecordKind::Remark),
            CaptureRecord::Line(bytes) => Kept { text: self.text(bytes), ..Kept::new(RecordKind::Line) },
            CaptureRecord::Dropped(count) => Kept { value: *count as i64, ..Kept::new(RecordKind::Dropped) },
            CaptureRecord::Broken { bytes, cut } => {
                Kept { text: self.text(bytes), ..Kept::new(RecordKind::Broken { cut: *cut }) }
            }
        };
        self.kept.push(kept);
    }

    #[inline]
    fn frame(&mut self, frame: &Frame) -> Kept {
        if self.texts.get(self.name).is_none_or(|name| name != frame.interface) {
            self.name = self.text(frame.interface) as usize;
        }
        let mut data = [0; 8];
        match frame.data.first_chunk() {
            Some(eight) => data = *eight,
            None => data[..frame.data.len()].copy_from_slice(frame.data),
        }
        let time = frame.time.unwrap_or(Timestamp { t_ns: 0, digits: 0 });
        Kept {
            value: time.t_ns,
            data,
            id: frame.id,
            text: self.name as u32,
            digits: time.digits as u8,
            length: frame.data.len().min(data.len()) as u8,
            kind: RecordKind::Frame { timed: frame.time.is_some(), extended: frame.extended },
        }
    }

    #[cold]
    fn text(&mut self, bytes: &[u8]) -> u32 {
        self.texts.push(bytes.to_vec());
        self.texts.len() as u32 - 1
    }

    /// Gives out the records with their lines, from this one on.
    #[inline]
    pub fn replay(&self, first: u64, mut sink: impl FnMut(RecordPosition, CaptureRecord)) {
        for (line, kept) in (first..).zip(&self.kept) {
            let text = || &*self.texts[kept.text as usize];
            let record = match kept.kind {
                RecordKind::Frame { timed, extended } => CaptureRecord::Frame(Frame {
                    time: timed.then_some(Timestamp { t_ns: kept.value, digits: kept.digits.into() }),
                    interface: text(),
                    id: kept.id,
                    extended,
                    data: &kept.data[..usize::from(kept.length)],
                }),
                RecordKind::Remote => CaptureRecord::Remote,
                RecordKind::Fd => CaptureRecord::Fd,
                RecordKind::Error => CaptureRecord::Error,
                RecordKind::Remark => CaptureRecord::Remark,
                RecordKind::Line => CaptureRecord::Line(text()),
                RecordKind::Dropped => CaptureRecord::Dropped(kept.value as u64),
                RecordKind::Broken { cut } => CaptureRecord::Broken { bytes: text(), cut },
            };
            sink(RecordPosition::Line(line), record);
        }
    }
}
