//! `truth.csv`: true angle, contribution of each effect, and count; one row per gyro and sample.
//!
//! A run starts without the column of operator-injected faults, so that it has the files of a simulated run if no fault is
//! injected. The first injected fault rewrites the previous rows with 0 in that column: at any time the file has the rows of
//! the same run simulated.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Write};
use std::path::Path;

use geu_model::device::Device;
use geu_model::effect::{FAULT_COLUMN, columns};
use geu_model::{CompletedSample, Trace};
use geu_protocol::capture::Timestamp;

use crate::output::{Output, RecordError};

/// Name of the file.
pub(crate) const NAME: &str = "truth.csv";
/// Temporary name while a column is added.
pub(crate) const WIDER: &str = "truth.csv.wider";
/// Columns of a row before those of the changes: time, sequence, gyro, true angle.
const LEADING: usize = 4;
/// Buffer size, bytes.
const CHUNK: usize = 1 << 18;

/// The file, and the columns of a trace in it.
pub(crate) struct TruthCsv {
    pub output: Output,
    columns: Vec<usize>,
}

impl TruthCsv {
    /// Creates the file with its header.
    pub fn create(directory: &Path, columns: Vec<usize>) -> Result<TruthCsv, RecordError> {
        let mut truth = TruthCsv { output: Output::create(directory, NAME)?, columns };
        let header = truth.header();
        truth.output.write(|file| writeln!(file, "{header}"))?;
        Ok(truth)
    }

    fn header(&self) -> String {
        let codes = columns();
        let changes: String = self.columns.iter().map(|&column| format!(",{}_counts", codes[column])).collect();
        format!("t_s,sequence,gyro,true_arcsec{changes},unquantised,count")
    }

    /// Writes the rows of a sample with its time stamp.
    pub fn rows(
        &mut self,
        device: &Device,
        stamp: Timestamp,
        ended: &CompletedSample,
        traces: &[Trace],
    ) -> Result<(), RecordError> {
        let sample = &ended.sample;
        let row_start = format!("{stamp},{},", sample.sequence);
        let columns = &self.columns;
        // Shortest digits that read back exactly, so that the columns add up; `write!` is too slow for this.
        let (mut digits, mut whole) = (zmij::Buffer::new(), itoa::Buffer::new());
        self.output.write(|file| {
            for ((head, counts), trace) in device.heads.iter().zip(ended.outputs.counts).zip(traces) {
                file.write_all(row_start.as_bytes())?;
                file.write_all(head.gyro.name().as_bytes())?;
                let changes = columns.iter().map(|&column| match column {
                    FAULT_COLUMN => trace.changes[FAULT_COLUMN] + without_column(trace, columns),
                    column => trace.changes[column],
                });
                for number in std::iter::once(trace.true_arcsec).chain(changes).chain([trace.unquantised]) {
                    file.write_all(b",")?;
                    file.write_all(digits.format(number).as_bytes())?;
                }
                file.write_all(b",")?;
                match head.is_rounded {
                    true => file.write_all(whole.format(counts as i64).as_bytes())?,
                    false => file.write_all(digits.format(counts).as_bytes())?,
                }
                file.write_all(b"\n")?;
            }
            Ok(())
        })
    }

    /// True if the file has the column of operator-injected faults.
    pub fn has_fault_column(&self) -> bool {
        self.columns.binary_search(&FAULT_COLUMN).is_ok()
    }

    /// Adds that column, with 0 in the previous rows.
    pub fn add_fault_column(&mut self, directory: &Path) -> Result<(), RecordError> {
        let Err(place) = self.columns.binary_search(&FAULT_COLUMN) else { return Ok(()) };
        self.columns.insert(place, FAULT_COLUMN);
        self.output.flush()?;
        let path = self.output.path.clone();
        let failed = |source| RecordError::Write { path: path.clone(), source };
        let mut wider = Output::create(directory, WIDER)?;
        let header = self.header();
        wider.write(|file| writeln!(file, "{header}"))?;
        for line in BufReader::with_capacity(CHUNK, File::open(&path).map_err(failed)?).lines().skip(1) {
            let line = line.map_err(failed)?;
            let comma = line.match_indices(',').nth(LEADING - 1 + place).map_or(line.len(), |(at, _)| at);
            wider.write(|file| writeln!(file, "{},0.0{}", &line[..comma], &line[comma..]))?;
            if wider.buffered() > CHUNK {
                wider.flush()?;
            }
        }
        wider.put_in_place(NAME)?;
        self.output = wider;
        Ok(())
    }
}

/// Number of samples with at least part of a row, of a unit with this number of heads.
pub(crate) fn samples(file: File, heads: usize) -> io::Result<u64> {
    let (mut file, mut rows, mut is_within_row) = (BufReader::with_capacity(CHUNK, file), 0, false);
    loop {
        let bytes = file.fill_buf()?;
        let (Some(last), length) = (bytes.last(), bytes.len()) else { break };
        rows += bytes.iter().filter(|&&byte| byte == b'\n').count() as u64;
        is_within_row = *last != b'\n';
        file.consume(length);
    }
    // Minus the header.
    Ok((rows + u64::from(is_within_row)).saturating_sub(1).div_ceil(heads as u64))
}

/// Sum of the contributions without a column: of effects that only a fault enables.
fn without_column(trace: &Trace, columns: &[usize]) -> f64 {
    let others = trace.changes.iter().enumerate().filter(|(column, _)| columns.binary_search(column).is_err());
    others.map(|(_, change)| change).sum()
}
