//! What comes out: rows, to whoever wants them.

use geu_protocol::Sample;
use geu_protocol::capture::{CaptureRecord, Timestamp};

use crate::defect::Defect;

/// One sample as it was received.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReceivedSample {
    /// Receive time (of INCREMENTS, or of the last byte of a live serial frame); where there is none, the clock count as
    /// seconds; nothing where the row has neither.
    pub time: Option<Timestamp>,
    /// Whether `time` is a receive time.
    pub is_received: bool,
    /// The fields; clock count and sensor temperature only where `has_clock`.
    pub sample: Sample,
    /// Whether clock count and sensor temperature are known.
    pub has_clock: bool,
}

/// Who takes rows and defects, in the order in which they are found.
pub trait Sink {
    /// Called when an input could be opened, before anything of it.
    fn opened(&mut self) {}
    /// Called with every record of a capture, before what is made of it.
    #[inline]
    fn record(&mut self, _event: &CaptureRecord) {}
    /// Called with the bytes of a serial recording, before what is made of them.
    fn bytes(&mut self, _bytes: &[u8]) {}
    fn row(&mut self, row: &ReceivedSample);
    fn defect(&mut self, defect: &Defect);
    /// Called when a live input has nothing more for now.
    fn flush(&mut self) {}
    fn is_closed(&self) -> bool {
        false
    }
}
