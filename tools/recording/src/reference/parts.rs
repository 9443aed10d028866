//! A reference of the default unit by parts, in memory that its length does not change.

use std::io::Read;
use std::path::Path;

use super::trial_table::TrialTable;
use super::{Gaps, REFERENCE, ReferenceAttitude, is_ephemeris};
use crate::aem;
use crate::csv_table::{CsvTable, TableError};
use crate::text::open_rows;

/// A reference attitude of which one part after the other is read.
pub struct ReferenceParts {
    source: Source,
    start_ns: i64,
    /// End of the rows that were read, ns.
    end_ns: i64,
    is_end: bool,
}

enum Source {
    Rows(Box<TrialTable<Box<dyn Read>>>),
    /// An attitude ephemeris is one part.
    Whole(ReferenceAttitude),
}

impl ReferenceParts {
    /// Opens a file of which the quaternions may leave gaps, and reads its start.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn open(name: &str) -> Result<ReferenceParts, TableError> {
        let mut rows = open_rows(Path::new(name)).map_err(TableError::read(name, REFERENCE))?;
        if is_ephemeris(name, &mut rows)? {
            let whole = aem::parse(name, rows.lines())?;
            let start_ns = whole.start_ns;
            return Ok(ReferenceParts { source: Source::Whole(whole), start_ns, end_ns: start_ns, is_end: true });
        }
        let table = TrialTable::new(name, CsvTable::new(name, rows)?, Gaps::OfAttitudes)?;
        let mut parts =
            ReferenceParts { source: Source::Rows(Box::new(table)), start_ns: 0, end_ns: i64::MIN, is_end: false };
        parts.start_ns = parts.read_to(i64::MIN)?.start_ns;
        Ok(parts)
    }

    /// Start of the first row's interval on the file's time scale, ns.
    pub fn start_ns(&self) -> i64 {
        self.start_ns
    }

    /// Time system of an attitude ephemeris.
    pub fn time_system(&self) -> Option<&str> {
        match &self.source {
            Source::Rows(_) => None,
            Source::Whole(whole) => whole.time_system.as_deref(),
        }
    }

    /// The part from the end of the one before to `end_ns`. Its motion equals that of the whole reference there.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn read_to(&mut self, end_ns: i64) -> Result<ReferenceAttitude, TableError> {
        match &mut self.source {
            Source::Rows(table) => {
                let (part, is_end) = table.read_to(end_ns)?;
                self.end_ns = part.start_ns.saturating_add((part.truth.end_s() * 1e9) as i64);
                self.is_end = is_end;
                Ok(part)
            }
            Source::Whole(whole) => Ok(whole.clone()),
        }
    }

    /// Reads the rest: its rows are checked and not kept.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn finish(mut self) -> Result<(), TableError> {
        while !self.is_end {
            self.read_to(self.end_ns)?;
        }
        Ok(())
    }
}
