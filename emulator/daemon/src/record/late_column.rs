//! The column of `truth.csv` for what live faults changed.
//!
//! It is not there from the start, so that a run into which nobody injects has the files of a simulated one; and it stands
//! beside `truth.csv` until the end, because rows that are written cannot grow. A process that is killed leaves both: a
//! truth that can be read, whose rows lack what live faults did.

use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, Write};
use std::path::Path;

use super::output::{Output, RecordError};

/// Its values, until it is a column.
const VALUES: &str = "truth.csv.faults";
/// The truth on its way to have it.
const WIDER: &str = "truth.csv.wider";
/// Files that a run which was killed leaves.
pub(super) const LEFT: [&str; 2] = [VALUES, WIDER];
/// Columns of a row before those of the changes: time, sequence, gyro, true angle.
const LEADING: usize = 4;

/// A column that began while the unit ran.
pub(super) struct LateColumn {
    /// A value for each row since.
    output: Output,
    /// Its place among the columns of changes.
    place: usize,
    /// Rows before, which have 0 there.
    rows_before: u64,
}

impl LateColumn {
    /// Begins it behind so many rows.
    pub fn begin(directory: &Path, place: usize, rows_before: u64) -> Result<LateColumn, RecordError> {
        Ok(LateColumn { output: Output::create(directory, VALUES)?, place, rows_before })
    }

    /// Adds the value of a row.
    pub fn add(&mut self, value: f64) -> Result<(), RecordError> {
        let mut digits = zmij::Buffer::new();
        self.output.write(|file| writeln!(file, "{}", digits.format(value)))
    }

    /// Hands what is buffered to the system.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.output.write(|file| file.flush())
    }

    /// Puts it into the truth, whose rows are all written, under this name.
    pub fn put_into(mut self, directory: &Path, truth: &Path, name: &str) -> Result<(), RecordError> {
        self.flush()?;
        let mut wider = Output::create(directory, WIDER)?;
        let fail = |source| RecordError { path: truth.to_owned(), source };
        let mut values = BufReader::new(File::open(&self.output.path).map_err(fail)?).lines();
        let rows = BufReader::new(File::open(truth).map_err(fail)?);
        for (index, line) in rows.lines().enumerate() {
            let line = line.map_err(fail)?;
            let comma = line.match_indices(',').nth(LEADING - 1 + self.place).map_or(line.len(), |(at, _)| at);
            let value = match index as u64 {
                0 => name.to_owned(),
                row if row <= self.rows_before => "0.0".to_owned(),
                _ => values.next().unwrap_or_else(|| Err(io::ErrorKind::UnexpectedEof.into())).map_err(fail)?,
            };
            wider.write(|file| writeln!(file, "{},{value}{}", &line[..comma], &line[comma..]))?;
        }
        wider.write(|file| file.flush())?;
        fs::rename(&wider.path, truth).map_err(fail)?;
        fs::remove_file(&self.output.path).map_err(fail)
    }
}
