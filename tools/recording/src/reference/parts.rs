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
            return Ok(ReferenceParts { source: Source::Whole(whole), start_ns });
        }
        let mut table = TrialTable::new(name, CsvTable::new(name, rows)?, Gaps::OfAttitudes)?;
        let start_ns = table.start_ns()?;
        Ok(ReferenceParts { source: Source::Rows(Box::new(table)), start_ns })
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
            Source::Rows(table) => table.read_to(end_ns),
            Source::Whole(whole) => Ok(whole.clone()),
        }
    }

    /// Reads the rest: its rows are checked and not kept.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn finish(self) -> Result<(), TableError> {
        match self.source {
            Source::Rows(table) => table.finish(),
            Source::Whole(_) => Ok(()),
        }
    }
}
