//! The truth of a recording: true angle, contribution of each effect, and count; one row per gyro and sample.

use std::io;
use std::path::Path;

use geu_model::device::Device;
use geu_model::effect::{FAULT_COLUMN, columns};
use geu_model::{CompletedSample, Configuration, Trace};
use geu_protocol::capture::Timestamp;

use crate::output::RecordError;
use crate::truth_csv::TruthCsv;

/// A row of a gyro.
pub struct TruthRow<'a> {
    /// Number of the gyro among the heads of the unit, and its name.
    pub head: usize,
    pub gyro: &'a str,
    /// By [`number_names`].
    pub numbers: &'a [f64],
    pub count: f64,
    /// True if the count is a whole number.
    pub is_rounded: bool,
}

/// A file of the truth in another format than CSV, which exists only once it is complete.
pub trait TruthTable {
    fn path(&self) -> &Path;

    /// Appends a row with the end of its sample and the sequence number.
    ///
    /// # Errors
    /// The file cannot be written.
    fn row(&mut self, time: Timestamp, sequence: u16, row: &TruthRow) -> io::Result<()>;

    /// Completes the file.
    ///
    /// # Errors
    /// The file cannot be written.
    fn finish(&mut self) -> io::Result<()>;
}

/// Names of the numbers of a row: the true angle, the columns of a trace, and the count before it is rounded.
pub fn number_names(trace_columns: &[usize]) -> Vec<String> {
    let codes = columns();
    let changes = trace_columns.iter().map(|&column| format!("{}_counts", codes[column]));
    ["true_arcsec".to_owned()].into_iter().chain(changes).chain(["unquantised".to_owned()]).collect()
}

/// The file, and the columns of a trace in it.
pub(crate) struct TruthFile {
    pub kind: TruthFileKind,
    columns: Vec<usize>,
    /// Numbers of a row, kept for their memory.
    numbers: Vec<f64>,
}

pub(crate) enum TruthFileKind {
    Csv(TruthCsv),
    Table(Box<dyn TruthTable>),
}

impl TruthFile {
    /// Creates the file with its header.
    pub fn create(
        directory: &Path,
        configuration: &Configuration,
        table: Option<Box<dyn TruthTable>>,
    ) -> Result<TruthFile, RecordError> {
        let columns = configuration.columns();
        let kind = match table {
            Some(table) => TruthFileKind::Table(table),
            None => TruthFileKind::Csv(TruthCsv::create(directory, &columns)?),
        };
        Ok(TruthFile { kind, columns, numbers: Vec::new() })
    }

    /// Writes the rows of a sample with its time stamp.
    pub fn rows(
        &mut self,
        device: &Device,
        time: Timestamp,
        ended: &CompletedSample,
        traces: &[Trace],
    ) -> Result<(), RecordError> {
        let TruthFile { kind, columns, numbers } = self;
        let sequence = ended.sample.sequence;
        let row_start = match kind {
            TruthFileKind::Csv(_) => format!("{time},{sequence},"),
            TruthFileKind::Table(_) => String::new(),
        };
        for (index, ((head, count), trace)) in device.heads.iter().zip(ended.outputs.counts).zip(traces).enumerate() {
            numbers.clear();
            numbers.push(trace.true_arcsec);
            numbers.extend(columns.iter().map(|&column| match column {
                FAULT_COLUMN => trace.changes[FAULT_COLUMN] + without_column(trace, columns),
                column => trace.changes[column],
            }));
            numbers.push(trace.unquantised);
            let row = TruthRow { head: index, gyro: head.gyro.name(), numbers, count, is_rounded: head.is_rounded };
            match kind {
                TruthFileKind::Csv(csv) => csv.row(&row_start, &row)?,
                TruthFileKind::Table(table) => {
                    table.row(time, sequence, &row).map_err(|source| failed(&**table, source))?;
                }
            }
        }
        Ok(())
    }

    /// True if the file has the column of operator-injected faults.
    pub fn has_fault_column(&self) -> bool {
        self.columns.binary_search(&FAULT_COLUMN).is_ok()
    }

    /// Adds the column of operator-injected faults, with 0 in the previous rows.
    pub fn add_fault_column(&mut self, directory: &Path) -> Result<(), RecordError> {
        let Err(place) = self.columns.binary_search(&FAULT_COLUMN) else { return Ok(()) };
        self.columns.insert(place, FAULT_COLUMN);
        match &mut self.kind {
            TruthFileKind::Csv(csv) => csv.add_column(directory, &self.columns, place),
            TruthFileKind::Table(table) => {
                let message = "a fault was injected; expected a truth as CSV, to which a column can be added";
                Err(failed(&**table, io::Error::other(message)))
            }
        }
    }

    /// Number of buffered bytes.
    pub fn buffered(&self) -> usize {
        match &self.kind {
            TruthFileKind::Csv(csv) => csv.output.buffered(),
            TruthFileKind::Table(_) => 0,
        }
    }

    /// Writes the buffer to the file.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        match &mut self.kind {
            TruthFileKind::Csv(csv) => csv.output.flush(),
            TruthFileKind::Table(_) => Ok(()),
        }
    }

    /// Completes a table.
    pub fn finish(&mut self) -> Result<(), RecordError> {
        match &mut self.kind {
            TruthFileKind::Csv(_) => Ok(()),
            TruthFileKind::Table(table) => table.finish().map_err(|source| failed(&**table, source)),
        }
    }
}

fn failed(table: &dyn TruthTable, source: io::Error) -> RecordError {
    RecordError::Write { path: table.path().to_owned(), source }
}

/// Sum of the contributions without a column: of effects that only a fault enables.
fn without_column(trace: &Trace, columns: &[usize]) -> f64 {
    let others = trace.changes.iter().enumerate().filter(|(column, _)| columns.binary_search(column).is_err());
    others.map(|(_, change)| change).sum()
}
