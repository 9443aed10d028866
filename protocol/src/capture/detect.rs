//! The format of a capture, from its content.

use super::text::Lines;
use super::{CaptureRecord, Foreign, Format, Reader, RecordPosition, console, pcap, pcapng};
use crate::serial::{Deframer, DeframerEvent};

/// What the beginning of a capture tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Detected {
    Format(Format),
    /// More bytes are needed, or the end.
    Undecided,
    /// It is in one that is not read.
    Foreign(&'static Foreign),
    /// Text in no format that is known.
    UnknownText,
}

/// Timed lines after which differences to the line before have shown themselves by running backwards.
const LINES_FOR_DELTA: usize = 8;
/// Times above this are no differences.
const MAX_DELTA_NS: i64 = 100_000_000 * 1_000_000_000;

/// Looks at the first bytes of a capture; `complete` where no more will come (or where no more will be looked at).
pub fn detect(head: &[u8], complete: bool) -> Detected {
    if pcap::magic(head).is_some() {
        return Detected::Format(Format::Pcap);
    }
    if pcapng::magic(head) {
        return Detected::Format(Format::Pcapng);
    }
    if let Some(foreign) = Foreign::of(head) {
        return Detected::Foreign(foreign);
    }
    // Formats of text: the one that reads most lines as frames.
    let scores = [Format::Candump, Format::Asc, Format::Console { delta: false }]
        .map(|format| (frames(format, head, complete), format));
    let (score, format) = scores.into_iter().rev().max_by_key(|(score, _)| *score).unwrap_or((0, Format::Candump));
    if score > 0 {
        return match format {
            Format::Console { .. } => console_times(head, complete),
            format => Detected::Format(format),
        };
    }
    let mut serial = false;
    Deframer::default().consume(head, &mut |found| serial |= matches!(found, DeframerEvent::Frame { .. }));
    if serial {
        return Detected::Format(Format::Serial);
    }
    match complete {
        false => Detected::Undecided,
        true if is_text(head) => Detected::UnknownText,
        true => Detected::Format(Format::Serial),
    }
}

/// How many lines of `head` are frames.
fn frames(format: Format, head: &[u8], complete: bool) -> usize {
    let mut count = 0;
    let mut sink = |_: RecordPosition, event: CaptureRecord| {
        count += usize::from(matches!(
            event,
            CaptureRecord::Frame(_) | CaptureRecord::Remote | CaptureRecord::Fd | CaptureRecord::Error
        ));
    };
    let mut reader = Reader::new(format);
    let used = reader.consume(head, &mut sink);
    if complete {
        reader.finish(&head[used..], &mut sink);
    }
    count
}

/// Whether the times of console output are differences (`-t d`): small, and running backwards.
fn console_times(head: &[u8], complete: bool) -> Detected {
    let (mut timed, mut before_ns, mut backwards, mut absolute) = (0, i64::MIN, false, false);
    let (mut lines, mut at) = (Lines::default(), 0);
    while let Some(line) = lines.next(&head[at..], complete) {
        if let Some((Some(time), _)) = console::time(&head[at..at + line.used]) {
            backwards |= time.t_ns < before_ns;
            absolute |= time.t_ns > MAX_DELTA_NS;
            (timed, before_ns) = (timed + 1, time.t_ns);
        }
        at += line.used;
    }
    if timed > 0 && !absolute && !backwards && timed < LINES_FOR_DELTA && !complete {
        return Detected::Undecided;
    }
    Detected::Format(Format::Console { delta: backwards && !absolute })
}

/// Whether a person could read it: UTF-8 (its last character perhaps cut) without other control characters than a
/// text's.
fn is_text(head: &[u8]) -> bool {
    let control = head.iter().any(|byte| matches!(byte, 0..=8 | 14..=26 | 28..=31 | 127));
    let utf8 = std::str::from_utf8(head).map_or_else(|error| error.error_len().is_none(), |_| true);
    !control && utf8
}
