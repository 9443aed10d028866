//! The format of a capture, from its content.

use super::{CaptureRecord, Foreign, Format, serial};

/// Recognition of a format.
#[derive(Debug, Clone, Copy)]
pub enum Detection {
    /// Binary: the capture begins with a signature.
    Signature(fn(&[u8]) -> bool),
    /// Text: the format that reads most lines as frames.
    Lines,
    /// Text as [`Detection::Lines`]; the function then selects a variant. Its arguments are the first bytes and true if they are
    /// all.
    Variants(fn(&[u8], bool) -> Option<&'static Format>),
    /// Selected by the function of another format.
    Variant,
    /// Binary, if nothing else was recognised: the bytes hold a frame.
    Frames(fn(&[u8]) -> bool),
}

impl Detection {
    pub fn is_text(&self) -> bool {
        !matches!(self, Detection::Signature(_) | Detection::Frames(_))
    }
}

/// Result of a detection.
#[derive(Debug, Clone, Copy)]
pub enum Detected {
    Format(&'static Format),
    /// More bytes are needed, or the end.
    Undecided,
    /// A known format that has no reader.
    Foreign(&'static Foreign),
    /// Text in no known format.
    UnknownText,
}

/// Detects the format from the first bytes of a capture; `is_complete` if no more bytes are available for it.
pub fn detect(head: &[u8], is_complete: bool) -> Detected {
    let is_signed = |format: &&Format| matches!(format.detection, Detection::Signature(is_signed) if is_signed(head));
    if let Some(format) = Format::all().find(is_signed) {
        return Detected::Format(format);
    }
    if let Some(foreign) = Foreign::from_head(head) {
        return Detected::Foreign(foreign);
    }
    if let Some(format) = text_format(head, is_complete) {
        return match format.detection {
            Detection::Variants(select) => select(head, is_complete).map_or(Detected::Undecided, Detected::Format),
            _ => Detected::Format(format),
        };
    }
    let has_frame = |format: &&Format| matches!(format.detection, Detection::Frames(has_frame) if has_frame(head));
    match Format::all().find(has_frame) {
        Some(format) => Detected::Format(format),
        None if !is_complete => Detected::Undecided,
        None if is_text(head) => Detected::UnknownText,
        None => Detected::Format(&serial::FORMATS[0]),
    }
}

/// The text format that reads most lines as frames, the first of several; `None` without such a line.
fn text_format(head: &[u8], is_complete: bool) -> Option<&'static Format> {
    let is_text = |format: &&Format| matches!(format.detection, Detection::Lines | Detection::Variants(_));
    let mut most = (0, None);
    for format in Format::all().filter(is_text) {
        let (frames, lines) = frames(format, head, is_complete);
        if frames > most.0 {
            most = (frames, Some(format));
        }
        // No later format can read more.
        if frames == lines {
            break;
        }
    }
    most.1
}

/// Number of lines of `head` that are frames, and of all lines.
fn frames(format: &Format, head: &[u8], is_complete: bool) -> (u64, u64) {
    let mut count = 0;
    let mut reader = format.reader().expect("a text format has a reader");
    reader.read(head, is_complete, &mut |_, record| {
        count += u64::from(matches!(
            record,
            CaptureRecord::Frame(_) | CaptureRecord::Remote | CaptureRecord::Fd | CaptureRecord::Error
        ));
    });
    (count, reader.records())
}

/// True for UTF-8 (its last character may be cut) without control characters, except white space and escape.
fn is_text(head: &[u8]) -> bool {
    let control = head.iter().any(|byte| matches!(byte, 0..=8 | 14..=26 | 28..=31 | 127));
    let utf8 = std::str::from_utf8(head).map_or_else(|error| error.error_len().is_none(), |_| true);
    !control && utf8
}
