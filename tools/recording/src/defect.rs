//! Defects of inputs, with position and bytes.

use geu_protocol::can::CanDefect;
use geu_protocol::capture::{RecordPosition, Timestamp};
use geu_protocol::serial::SerialDefect;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum DefectKind {
    /// With a CAN message of the unit.
    Can(CanDefect),
    /// With bytes behind a serial sync.
    Serial(SerialDefect),
    /// Serial bytes without a sync.
    Noise,
    /// Serial DATA with a clock that does not follow: CRC and sync may match by accident.
    ClockInconsistent,
    /// A CAN message of a described unit with a wrong check.
    MessageCheck,
    /// A sample of a described unit of which a frame is missing.
    IncompleteSample,
    /// A line or packet that does not follow its format.
    BrokenRecord,
    /// The input ends inside a line or packet.
    CutRecord,
    SequenceGap,
    /// A cell of a table that is no number; the other values of the sample are.
    BadCell,
    /// A row of a table without a time or an output, or with another number of cells than columns: no sample.
    BadRow,
    /// A row of a table that begins later than the row before ends.
    TimeGap,
    /// A row of a table with the time of the row before.
    TimeRepeated,
    /// A sequence that does not follow.
    SequenceJump,
    /// Received before the row before it.
    TimeBackwards,
    /// The recorder, or the socket, lost frames.
    ReceiverDropped,
}

impl DefectKind {
    pub const fn name(self) -> &'static str {
        match self {
            DefectKind::Can(defect) => defect.name(),
            DefectKind::Serial(defect) => defect.name(),
            DefectKind::Noise => "noise",
            DefectKind::ClockInconsistent => "clock-inconsistent",
            DefectKind::MessageCheck => "check-mismatch",
            DefectKind::IncompleteSample => "incomplete-sample",
            DefectKind::BrokenRecord => "broken-record",
            DefectKind::CutRecord => "cut-record",
            DefectKind::SequenceGap => "sequence-gap",
            DefectKind::BadCell => "bad-cell",
            DefectKind::BadRow => "bad-row",
            DefectKind::TimeGap => "time-gap",
            DefectKind::TimeRepeated => "time-repeated",
            DefectKind::SequenceJump => "sequence-jump",
            DefectKind::TimeBackwards => "time-backwards",
            DefectKind::ReceiverDropped => "receiver-dropped",
        }
    }

    /// Number of records (lines, packets, frames) of a capture in one such defect.
    pub(crate) const fn records(self) -> u64 {
        match self {
            DefectKind::Can(defect) => defect.frames(),
            DefectKind::BrokenRecord | DefectKind::CutRecord | DefectKind::MessageCheck | DefectKind::BadRow => 1,
            _ => 0,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Defect<'a> {
    pub input: &'a str,
    pub place: RecordPosition,
    pub kind: DefectKind,
    /// The bytes concerned: a line, a packet, the data of frames, serial bytes; at most a few hundred.
    pub bytes: &'a [u8],
    pub time: Option<Timestamp>,
    /// Samples (a gap) or frames (dropped) that are missing.
    pub lost: u64,
}

impl Defect<'_> {
    pub fn place_text(&self) -> String {
        place_text(self.input, self.place)
    }
}

pub fn place_text(input: &str, place: RecordPosition) -> String {
    match place {
        RecordPosition::Line(at) | RecordPosition::Offset(at) => format!("{input}:{at}"),
    }
}
