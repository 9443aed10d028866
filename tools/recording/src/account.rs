//! Where every record and every byte went.

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
    /// INCREMENTS whose STATUS was under way when reading was left off.
    pub unfinished: u64,

    /// Serial bytes, counted where they are read.
    pub bytes: u64,
    /// Bytes of DATA frames that became rows.
    pub decoded_bytes: u64,
    /// Bytes of COMMAND frames.
    pub command_bytes: u64,
    /// Bytes of REPLY frames.
    pub reply_bytes: u64,
    /// Bytes that belong to no frame, skipped in hunting for the next sync.
    pub resynchronised_bytes: u64,
    /// Bytes of a frame that was under way when reading was left off.
    pub unfinished_bytes: u64,

    pub defects: BTreeMap<DefectKind, u64>,
}

impl DecodeAccount {
    /// Records and bytes that no count explains; both 0 if the account adds up.
    pub fn missing(&self) -> (i64, i64) {
        let defective: u64 = self.defects.iter().map(|(kind, count)| kind.records() * count).sum();
        let records = self.decoded
            + self.commands
            + self.replies
            + self.other
            + self.remote
            + self.fd
            + self.error
            + self.remarks
            + self.elsewhere
            + self.unfinished
            + defective;
        let bytes = self.decoded_bytes
            + self.command_bytes
            + self.reply_bytes
            + self.resynchronised_bytes
            + self.unfinished_bytes;
        (self.records as i64 - records as i64, self.bytes as i64 - bytes as i64)
    }

    /// Whether every record and byte is accounted for.
    pub fn adds_up(&self) -> bool {
        self.missing() == (0, 0)
    }

    pub fn defect_count(&self) -> u64 {
        self.defects.values().sum()
    }
}
