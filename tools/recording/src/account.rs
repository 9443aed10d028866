//! Account of every record and every byte.

use std::collections::BTreeMap;

use crate::defect::DefectKind;

/// Counts that must add up: records (lines, packets, frames) of CAN captures, bytes of serial streams.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct DecodeAccount {
    /// Lines, packets or live frames, counted where they are read.
    pub records: u64,
    /// Records that became rows: INCREMENTS, STATUS, CLOCK.
    pub decoded: u64,
    /// COMMAND frames.
    pub commands: u64,
    /// REPLY frames.
    pub replies: u64,
    pub other: u64,
    /// Remote frames.
    pub remote: u64,
    /// CAN FD and CAN XL frames.
    pub fd: u64,
    /// Error frames.
    pub error: u64,
    /// Comments, blank lines, headers, packets of other links, notes of the recorder.
    pub remarks: u64,
    /// Frames of the unit on interfaces that were not chosen.
    pub elsewhere: u64,
    /// INCREMENTS without the STATUS, at the stop of reading.
    pub unfinished: u64,

    /// Serial bytes, counted where they are read.
    pub bytes: u64,
    /// Bytes of DATA frames that became rows.
    pub decoded_bytes: u64,
    /// Bytes of COMMAND frames.
    pub command_bytes: u64,
    /// Bytes of REPLY frames.
    pub reply_bytes: u64,
    /// Bytes outside of frames, skipped up to the next sync.
    pub resynchronised_bytes: u64,
    /// Bytes of an incomplete frame at the stop of reading.
    pub unfinished_bytes: u64,

    pub defects: BTreeMap<DefectKind, u64>,
}

impl DecodeAccount {
    /// Each count of records, with its name.
    pub fn record_counts(&self) -> [(&'static str, u64); 11] {
        [
            ("decoded", self.decoded),
            ("command", self.commands),
            ("reply", self.replies),
            ("other-traffic", self.other),
            ("other-interface", self.elsewhere),
            ("remote", self.remote),
            ("fd", self.fd),
            ("error", self.error),
            ("remark", self.remarks),
            ("unfinished", self.unfinished),
            ("defective", self.defects.iter().map(|(kind, count)| kind.records() * count).sum()),
        ]
    }

    /// Each count of bytes, with its name.
    pub fn byte_counts(&self) -> [(&'static str, u64); 5] {
        [
            ("decoded", self.decoded_bytes),
            ("command", self.command_bytes),
            ("reply", self.reply_bytes),
            ("resynchronised", self.resynchronised_bytes),
            ("unfinished", self.unfinished_bytes),
        ]
    }

    /// Records and bytes that no count explains; both 0 if the account adds up.
    pub fn missing(&self) -> (i64, i64) {
        let sum = |counts: &[(&str, u64)]| counts.iter().map(|(_, count)| count).sum::<u64>() as i64;
        (self.records as i64 - sum(&self.record_counts()), self.bytes as i64 - sum(&self.byte_counts()))
    }

    /// True if every record and byte is accounted for.
    pub fn adds_up(&self) -> bool {
        self.missing() == (0, 0)
    }

    pub fn defect_count(&self) -> u64 {
        self.defects.values().sum()
    }
}
