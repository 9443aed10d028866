//! Parquet and Arrow files of batches, one file or one for each day of a unit.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use arrow_array::cast::AsArray;
use arrow_array::types::TimestampMicrosecondType;
use arrow_array::{Array, RecordBatch};
use arrow_ipc::writer::FileWriter;
use arrow_schema::{ArrowError, SchemaRef};
use geu_files::Output;
use geu_recording::archive::{ARROW, DEVICE, PARQUET};
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, ZstdLevel};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;

/// A format of columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileFormat {
    Parquet,
    /// Arrow IPC file, also known as Feather 2.
    Arrow,
}

impl FileFormat {
    /// End of the name of a file in a partition.
    pub const fn suffix(self) -> &'static str {
        match self {
            FileFormat::Parquet => PARQUET,
            FileFormat::Arrow => ARROW,
        }
    }
}

/// Rows of a row group: readers skip row groups outside of a range of times.
const GROUP_ROWS: usize = 1 << 18;

/// A file of batches that is written.
pub enum BatchFile {
    Parquet(Box<ArrowWriter<Output>>),
    Arrow(Box<FileWriter<Output>>),
}

impl BatchFile {
    /// Starts a file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn new(output: Output, format: FileFormat, schema: &SchemaRef) -> io::Result<BatchFile> {
        match format {
            FileFormat::Parquet => {
                let level = ZstdLevel::try_new(3).map_err(from_parquet)?;
                // DuckDB and Spark read the metadata of the file, not that of the Arrow schema in it.
                let metadata = schema.metadata().iter().map(|(key, value)| KeyValue::new(key.clone(), value.clone()));
                let mut metadata: Vec<KeyValue> = metadata.collect();
                metadata.sort_unstable_by(|one, other| one.key.cmp(&other.key));
                let properties = WriterProperties::builder()
                    .set_compression(Compression::ZSTD(level))
                    .set_max_row_group_row_count(Some(GROUP_ROWS))
                    .set_key_value_metadata(Some(metadata))
                    .build();
                let writer = ArrowWriter::try_new(output, schema.clone(), Some(properties)).map_err(from_parquet)?;
                Ok(BatchFile::Parquet(Box::new(writer)))
            }
            FileFormat::Arrow => {
                Ok(BatchFile::Arrow(Box::new(FileWriter::try_new(output, schema).map_err(from_arrow)?)))
            }
        }
    }

    /// Appends rows.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&mut self, batch: &RecordBatch) -> io::Result<()> {
        match self {
            BatchFile::Parquet(file) => file.write(batch).map_err(from_parquet),
            BatchFile::Arrow(file) => file.write(batch).map_err(from_arrow),
        }
    }

    /// The complete file, still beside its final path.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(self) -> io::Result<Output> {
        let mut output = match self {
            BatchFile::Parquet(file) => file.into_inner().map_err(from_parquet)?,
            BatchFile::Arrow(mut file) => {
                file.finish().map_err(from_arrow)?;
                file.into_inner().map_err(from_arrow)?
            }
        };
        output.flush()?;
        Ok(output)
    }
}

fn from_parquet(error: ParquetError) -> io::Error {
    match error {
        ParquetError::External(error) => match error.downcast::<io::Error>() {
            Ok(error) => *error,
            Err(error) => io::Error::other(error),
        },
        error => io::Error::other(error),
    }
}

fn from_arrow(error: ArrowError) -> io::Error {
    match error {
        ArrowError::IoError(_, error) => error,
        error => io::Error::other(error),
    }
}

/// Files of an archive: `device=NAME/day=YYYY-MM-DD/HHMMSS.ffffff.SUFFIX`, named by their first sample.
///
/// DuckDB, Polars and Spark read the names of such directories as columns.
pub struct Partition {
    directory: PathBuf,
    format: FileFormat,
    schema: SchemaRef,
    replaces: bool,
    /// Day since 1970 and file of the rows last written.
    open: Option<(i64, BatchFile)>,
    /// Files of other days, complete, still beside their final paths.
    complete: Vec<Output>,
    /// Dropped after the files.
    made: MadeDirectories,
}

/// Directories that were made, removed again if they are empty.
#[derive(Default)]
struct MadeDirectories(Vec<PathBuf>);

impl MadeDirectories {
    fn make(&mut self, directory: &Path) -> io::Result<()> {
        let missing: Vec<&Path> =
            directory.ancestors().take_while(|own| !own.as_os_str().is_empty() && !own.exists()).collect();
        for own in missing.into_iter().rev() {
            match std::fs::create_dir(own) {
                Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
                Err(_) => {}
                Ok(()) => self.0.push(own.to_owned()),
            }
        }
        Ok(())
    }
}

impl Drop for MadeDirectories {
    fn drop(&mut self) {
        for directory in self.0.iter().rev() {
            // One with a file is kept.
            let _ = std::fs::remove_dir(directory);
        }
    }
}

const MICROSECONDS_A_DAY: i64 = 86_400_000_000;
/// Files of a call, which stay open until all are complete: a year, and fewer than a process may have.
const MAX_FILES: usize = 400;

impl Partition {
    /// Files in `directory`, for the unit of the schema.
    pub fn new(directory: &Path, format: FileFormat, schema: &SchemaRef, replaces: bool) -> Partition {
        let device = schema.metadata().get(DEVICE).map_or("", |name| name);
        let directory = directory.join(format!("device={}", escaped(device)));
        let (open, complete, made) = Default::default();
        Partition { directory, format, schema: schema.clone(), replaces, open, complete, made }
    }

    /// Appends rows to the files of their days; a row without a time is in that of 1970-01-01.
    ///
    /// # Errors
    /// A file exists, unless files are replaced, or cannot be written.
    pub fn write(&mut self, batch: &RecordBatch) -> io::Result<()> {
        let time = batch.column(0).as_primitive::<TimestampMicrosecondType>();
        let at = |row: usize| if time.is_valid(row) { time.value(row) } else { 0 };
        let mut from = 0;
        while from < batch.num_rows() {
            let day = at(from).div_euclid(MICROSECONDS_A_DAY);
            let same = (from..batch.num_rows()).take_while(|row| at(*row).div_euclid(MICROSECONDS_A_DAY) == day);
            let count = same.count();
            let rows = batch.slice(from, count);
            if self.open.as_ref().is_none_or(|(own, _)| *own != day) {
                self.close()?;
                self.open = Some((day, self.open(day, at(from).rem_euclid(MICROSECONDS_A_DAY))?));
            }
            if let Some((_, file)) = &mut self.open {
                file.write(&rows)?;
            }
            from += count;
        }
        Ok(())
    }

    /// Completes the file of the present day.
    fn close(&mut self) -> io::Result<()> {
        if let Some((_, file)) = self.open.take() {
            self.complete.push(file.finish()?);
        }
        if self.complete.len() < MAX_FILES {
            return Ok(());
        }
        let text = format!(
            "{}: expected samples of at most {MAX_FILES} days in one call, in the order of time, got more; decode parts",
            self.directory.display()
        );
        Err(io::Error::new(io::ErrorKind::InvalidInput, text))
    }

    fn open(&mut self, day: i64, of_day_us: i64) -> io::Result<BatchFile> {
        let (year, month, of_month) = geu_protocol::calendar::date(day);
        let directory = self.directory.join(format!("day={year:04}-{month:02}-{of_month:02}"));
        let (seconds, fraction) = (of_day_us / 1_000_000, of_day_us % 1_000_000);
        let (hours, minutes, seconds) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
        let name = format!("{hours:02}{minutes:02}{seconds:02}.{fraction:06}.{}", self.format.suffix());
        let path = directory.join(name);
        if !self.replaces && path.exists() {
            let text = format!(
                "{}: expected no file with this first sample, got one; it is this recording, or one without receive times: --force replaces the file, --out FILE keeps both",
                path.display()
            );
            return Err(io::Error::new(io::ErrorKind::AlreadyExists, text));
        }
        self.made.make(&directory)?;
        geu_files::claim_output("--partition", &path)
            .map_err(|error| io::Error::new(io::ErrorKind::InvalidInput, error))?;
        let create = if self.replaces { Output::create } else { Output::create_new };
        BatchFile::new(create(&path)?, self.format, &self.schema)
    }

    /// The complete files, still beside their final paths.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn finish(mut self) -> io::Result<Vec<Output>> {
        let last = self.open.take().map(|(_, file)| file.finish()).transpose()?;
        Ok(std::mem::take(&mut self.complete).into_iter().chain(last).collect())
    }
}

/// A name as the directory of a partition has it.
fn escaped(name: &str) -> String {
    let is_plain = |letter: char| letter.is_alphanumeric() || "._-".contains(letter);
    name.chars().map(|letter| if is_plain(letter) { letter } else { '_' }).collect()
}
