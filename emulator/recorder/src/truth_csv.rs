//! The truth as CSV.
//!
//! A run starts without the column of operator-injected faults, so that it has the files of a simulated run if no fault is
//! injected. The first injected fault rewrites the previous rows with 0 in that column: at any time the file has the rows of
//! the same run simulated.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Write};
use std::path::Path;

use crate::output::{Output, RecordError};
use crate::truth::{TruthRow, number_names};

/// Name of the file.
pub(crate) const NAME: &str = "truth.csv";
/// Temporary name while a column is added.
pub(crate) const WIDER: &str = "truth.csv.wider";
/// Columns of a row before those of the changes: time, sequence, gyro, true angle.
const LEADING: usize = 4;
/// Buffer size, bytes.
const CHUNK: usize = 1 << 18;

/// The file.
pub(crate) struct TruthCsv {
    pub output: Output,
}

impl TruthCsv {
    /// Creates the file with its header.
    pub fn create(directory: &Path, trace_columns: &[usize]) -> Result<TruthCsv, RecordError> {
        let mut output = Output::create(directory, NAME)?;
        output.write(|file| write_header(file, trace_columns))?;
        Ok(TruthCsv { output })
    }

    /// Writes a row; `start`: the cells of its sample.
    pub fn row(&mut self, start: &str, row: &TruthRow) -> Result<(), RecordError> {
        // Shortest digits that read back exactly, so that the columns add up; `write!` is too slow for this.
        let (mut digits, mut whole) = (zmij::Buffer::new(), itoa::Buffer::new());
        self.output.write(|file| {
            file.write_all(start.as_bytes())?;
            file.write_all(row.gyro.as_bytes())?;
            for number in row.numbers {
                file.write_all(b",")?;
                file.write_all(digits.format(*number).as_bytes())?;
            }
            file.write_all(b",")?;
            match row.is_rounded {
                true => file.write_all(whole.format(row.count as i64).as_bytes())?,
                false => file.write_all(digits.format(row.count).as_bytes())?,
            }
            file.write_all(b"\n")
        })
    }

    /// Adds the column at `place` of the columns of a trace, with 0 in the previous rows.
    pub fn add_column(&mut self, directory: &Path, trace_columns: &[usize], place: usize) -> Result<(), RecordError> {
        self.output.flush()?;
        let path = self.output.path.clone();
        let failed = |source| RecordError::Write { path: path.clone(), source };
        let mut wider = Output::create(directory, WIDER)?;
        wider.write(|file| write_header(file, trace_columns))?;
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

fn write_header(file: &mut Vec<u8>, trace_columns: &[usize]) -> io::Result<()> {
    writeln!(file, "t_s,sequence,gyro,{},count", number_names(trace_columns).join(","))
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
