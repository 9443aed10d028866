//! Decoded rows and their receiver.

use geu_protocol::Sample;
use geu_protocol::capture::{CaptureRecord, Timestamp};

use crate::defect::Defect;

/// One sample as it was received.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReceivedSample {
    /// Receive time (of INCREMENTS, or of the last byte of a live serial frame); without it the clock count as seconds;
    /// `None` without both.
    pub time: Option<Timestamp>,
    /// True if `time` is a receive time.
    pub is_received: bool,
    /// The fields; clock count and sensor temperature only if `has_clock`.
    pub sample: Sample,
    pub has_clock: bool,
}

impl ReceivedSample {
    /// A row with its receive time, or else the time of its clock count.
    #[inline]
    pub(crate) fn new(sample: Sample, has_clock: bool, received: Option<Timestamp>) -> ReceivedSample {
        let clock = || has_clock.then(|| Timestamp { t_ns: sample.clock_count as i64 * 1_000, digits: 6 });
        ReceivedSample { time: received.or_else(clock), is_received: received.is_some(), sample, has_clock }
    }
}

/// One sample of a described unit as it was received.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DeviceSample {
    /// Receive time, if known; in a table the end of the sample's interval.
    pub time: Option<Timestamp>,
    /// Start of the interval, if a table states it.
    pub start: Option<Timestamp>,
    /// Trial, if a table has several; their times are independent.
    pub group: String,
    /// Number of the sample, missing ones counted, from 0.
    pub number: u64,
    /// Values in the order of [`geu_protocol::layout::FrameSet::values`]; `NaN` where no frame had it.
    pub values: Vec<f64>,
}

impl DeviceSample {
    /// The time, else that of the number at this interval.
    #[inline]
    pub fn time_or_number(&self, interval_s: f64) -> Timestamp {
        let t_ns = || (self.number as f64 * interval_s * 1e9).round() as i64;
        self.time.unwrap_or_else(|| Timestamp { t_ns: t_ns(), digits: 9 })
    }
}

/// Receives rows and defects in their order.
pub trait Sink<R = ReceivedSample> {
    /// Called once, when the first input is open, before its first record.
    fn opened(&mut self) {}
    /// Called with every record of a capture, before its row or defect.
    #[inline]
    fn record(&mut self, _event: &CaptureRecord) {}
    /// Called with the bytes of a serial recording, before their rows and defects.
    fn bytes(&mut self, _bytes: &[u8]) {}
    fn row(&mut self, row: &R);
    /// Samples that a defect lost are a gap between rows too, and the summary counts the defects.
    fn defect(&mut self, _defect: &Defect) {}
    /// Called when a live input has nothing more for now.
    fn flush(&mut self) {}
    fn is_closed(&self) -> bool {
        false
    }
}
