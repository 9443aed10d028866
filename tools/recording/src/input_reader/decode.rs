//! Decoders of inputs.

use geu_protocol::capture::{CaptureRecord, Detected, Format, RecordPosition, Timestamp, detect};

use crate::archive::{ArchiveRows, ArchiveUnit};
use crate::row::Sink;
use crate::summary::DecodeSummary;

/// Decodes records and bytes to rows and defects.
pub trait Decode {
    /// A row.
    type Row;

    /// Starts an input.
    fn begin(&mut self, name: &str, sink: &mut impl Sink<Self::Row>);
    /// The summary up to now.
    fn summary(&mut self) -> &mut DecodeSummary;
    /// Reads a record of a capture, or a live CAN frame.
    fn event(&mut self, place: RecordPosition, event: &CaptureRecord, sink: &mut impl Sink<Self::Row>);
    /// Reports that the receiver lost `count` frames.
    fn dropped(&mut self, place: RecordPosition, count: u64, sink: &mut impl Sink<Self::Row>);
    /// Reads serial bytes, with their receive time if it is known.
    fn serial(&mut self, bytes: &[u8], time: Option<Timestamp>, sink: &mut impl Sink<Self::Row>);
    /// Notes that the inputs were not read to their end: an incomplete frame is then unfinished, no defect.
    fn stop(&mut self);
    /// Ends the inputs: reports what waits.
    fn finish(&mut self, sink: &mut impl Sink<Self::Row>);
    fn into_summary(self) -> DecodeSummary;

    /// The unit and the columns of its archives.
    fn archive(&self) -> ArchiveUnit;
    /// Reads a row of an archive.
    ///
    /// # Errors
    /// A cell that no row has: column, expected and got.
    fn archived(
        &mut self,
        place: RecordPosition,
        rows: &ArchiveRows,
        row: usize,
        sink: &mut impl Sink<Self::Row>,
    ) -> Result<(), String>;

    /// The format of an input, from its first bytes; `is_complete` if no more are available for it.
    fn detect(&self, head: &[u8], is_complete: bool) -> Detected {
        detect(head, is_complete)
    }

    /// True if tables of samples are read, which may be Parquet.
    fn reads_tables(&self) -> bool {
        false
    }

    /// Columns that a table must have, in words, if the unit has nothing else.
    fn columns(&self) -> Option<String> {
        None
    }

    /// Serial frames or captures that are expected, in words.
    fn expected(&self) -> String {
        format!("{} with a matching CRC", Format::titles(false))
    }

    /// Sets the format of the present input.
    fn describe(&mut self, kind: &str) {
        if let Some((_, known)) = self.summary().inputs.last_mut() {
            kind.clone_into(known);
        }
    }

    /// Counts records as their reader counts them; they must equal the events.
    fn count_records(&mut self, records: u64) {
        self.summary().account.records += records;
    }
}
