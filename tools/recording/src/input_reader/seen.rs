//! Account of the records of a capture.

use geu_protocol::capture::{CaptureRecord, RecordPosition};
use geu_protocol::hex::spaced_hex;

use super::{Decode, MAX_EXCERPT};
use crate::row::Sink;

/// Records of a capture up to now.
#[derive(Default)]
pub struct Seen {
    pub remarks: u64,
    /// First record of a binary capture that is damaged or cut: its offset and first bytes.
    pub cut: Option<(u64, String)>,
}

impl Seen {
    #[inline]
    pub fn event<D: Decode>(
        &mut self,
        place: RecordPosition,
        event: &CaptureRecord,
        decoder: &mut D,
        sink: &mut impl Sink<D::Row>,
    ) {
        if !matches!(event, CaptureRecord::Frame(_)) {
            self.note(place, event);
        }
        sink.record(event);
        decoder.event(place, event, sink);
    }

    #[cold]
    fn note(&mut self, place: RecordPosition, event: &CaptureRecord) {
        if let (RecordPosition::Offset(at), CaptureRecord::Broken { cut: true, bytes }) = (place, event) {
            self.cut.get_or_insert_with(|| (at, spaced_hex(&bytes[..bytes.len().min(MAX_EXCERPT)])));
        }
        self.remarks += u64::from(matches!(event, CaptureRecord::Remark));
    }
}
