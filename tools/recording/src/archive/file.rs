//! A Parquet file of an archive: its unit, and its rows in batches. Row groups outside of a range of times are not read.

use std::fs::File;
use std::io;
use std::path::Path;

use geu_protocol::excerpt::excerpt;
use parquet::basic::{ConvertedType, Type};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::{ByteArray, DataType};
use parquet::file::metadata::RowGroupMetaData;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::statistics::Statistics;
use parquet::schema::types::ColumnDescriptor;

use super::{ArchiveUnit, ColumnKind, DEVICE, TimeRange};
use crate::input::claim;
use crate::parquet_text::{guarded, invalid};

const BATCH_ROWS: usize = 8192;
/// First bytes of a file.
const BEGINNING: &[u8; 4] = b"PAR1";

/// A file of an archive.
pub struct Archive {
    file: SerializedFileReader<File>,
    /// Places of the columns of the unit.
    places: Vec<usize>,
    rows: ArchiveRows,
    range: Option<TimeRange>,
    next_group: usize,
    /// Rows of the present row group that are not yet read.
    left: usize,
    readers: Vec<ColumnReader>,
    /// Number of the last row before the batch.
    before: u64,
}

/// Rows of some columns.
pub struct ArchiveRows {
    columns: Vec<(String, ColumnKind)>,
    cells: Vec<Cells>,
}

/// The cells of a column.
enum Cells {
    Whole(Vec<Option<i64>>),
    /// `NaN` for null.
    Real(Vec<f64>),
    Text(Vec<Option<ByteArray>>),
}

impl Archive {
    /// Opens a file; `None` if it is no archive.
    ///
    /// # Errors
    /// It cannot be read, or not as an archive of this unit.
    pub fn open(path: &Path, unit: &ArchiveUnit, range: Option<TimeRange>) -> io::Result<Option<Archive>> {
        use std::os::unix::fs::FileExt;
        let (file, mut head) = (File::open(path)?, [0; 4]);
        if !file.metadata()?.is_file() || file.read_exact_at(&mut head, 0).is_err() || head != *BEGINNING {
            return Ok(None);
        }
        claim(&path.display().to_string(), &file)?;
        // A damaged file has no name of a unit.
        let Ok(file) = guarded(|| Ok(SerializedFileReader::new(file)?)) else { return Ok(None) };
        let schema = file.metadata().file_metadata();
        let value = |key: &str| {
            let found = schema.key_value_metadata().and_then(|own| own.iter().find(|own| own.key == key));
            found.and_then(|own| own.value.clone())
        };
        let Some(name) = value(DEVICE) else { return Ok(None) };
        if let Some(content) = value(super::CONTENT) {
            let content = excerpt(&content);
            return Err(invalid(format!(
                "expected samples, got a {content}; give the link or its archive of geu decode"
            )));
        }
        if name != unit.name && value(super::DESCRIPTION).is_none_or(|text| text != unit.description) {
            let (own, name) = (&unit.name, excerpt(&name));
            return Err(invalid(format!("expected an archive of {own}, got {name}; give --device {name}")));
        }
        let columns = schema.schema_descr().columns();
        let place = |(name, kind): &(String, ColumnKind)| {
            let own = columns.iter().position(|column| column.path().parts() == [name.clone()]);
            let own = own.filter(|&own| columns[own].max_rep_level() == 0 && is_of_kind(&columns[own], *kind));
            own.ok_or_else(|| {
                invalid(format!(
                    "column {name}: expected {} for {}, got another type or no such column; decode the recording again",
                    kind.in_words(),
                    unit.name
                ))
            })
        };
        let places = unit.columns.iter().map(place).collect::<io::Result<Vec<_>>>()?;
        let cells = unit.columns.iter().map(|(_, kind)| Cells::of_kind(*kind)).collect();
        let rows = ArchiveRows { columns: unit.columns.clone(), cells };
        Ok(Some(Archive { file, places, rows, range, next_group: 0, left: 0, readers: Vec::new(), before: 0 }))
    }

    /// Reads the next rows, and returns the number of the last row before them, and theirs; `None` at the end.
    ///
    /// # Errors
    /// The file is damaged.
    pub fn next_batch(&mut self) -> io::Result<Option<(u64, usize)>> {
        let group = self.next_group + usize::from(self.left == 0);
        let batch = guarded(|| self.read_batch());
        batch.map_err(|error| invalid(format!("row group {group}, damaged or encrypted: {error}")))
    }

    fn read_batch(&mut self) -> io::Result<Option<(u64, usize)>> {
        while self.left == 0 {
            if self.next_group == self.file.num_row_groups() {
                return Ok(None);
            }
            let group = self.file.get_row_group(self.next_group)?;
            let count = usize::try_from(group.metadata().num_rows()).map_err(io::Error::other)?;
            self.next_group += 1;
            if self.range.is_some_and(|range| !range.may_have(group.metadata(), self.places[0])) {
                self.before += count as u64;
                continue;
            }
            let readers = self.places.iter().map(|&place| group.get_column_reader(place));
            self.readers = readers.collect::<Result<_, _>>()?;
            self.left = count;
        }
        let (count, before) = (self.left.min(BATCH_ROWS), self.before);
        for (reader, cells) in self.readers.iter_mut().zip(&mut self.rows.cells) {
            cells.read(reader, count)?;
        }
        self.left -= count;
        self.before += count as u64;
        Ok(Some((before, count)))
    }

    /// The rows of the last batch.
    pub fn rows(&self) -> &ArchiveRows {
        &self.rows
    }

    /// True if a row of the last batch is in the range.
    ///
    /// # Errors
    /// A time that no row has.
    pub fn has_row(&self, row: usize) -> Result<bool, String> {
        let Some(range) = self.range else { return Ok(true) };
        let time = self.rows.instant(0, row)?;
        Ok(time.is_some_and(|time| range.from_ns <= time.t_ns && time.t_ns < range.to_ns))
    }
}

impl TimeRange {
    /// False if the statistics of a row group show that all its times are outside.
    fn may_have(self, group: &RowGroupMetaData, time: usize) -> bool {
        let Some(Statistics::Int64(times)) = group.column(time).statistics() else { return true };
        // The instant is up to a microsecond from the time in its column.
        let is_before = times.max_opt().is_some_and(|max| max.saturating_add(1).saturating_mul(1000) < self.from_ns);
        let is_after = times.min_opt().is_some_and(|min| min.saturating_sub(1).saturating_mul(1000) >= self.to_ns);
        !is_before && !is_after
    }
}

impl ColumnKind {
    const fn in_words(self) -> &'static str {
        match self {
            ColumnKind::Time => "times in microseconds",
            ColumnKind::Whole => "whole numbers",
            ColumnKind::Real => "real numbers",
            ColumnKind::Flag => "true and false",
            ColumnKind::Text => "text",
        }
    }
}

fn is_of_kind(column: &ColumnDescriptor, kind: ColumnKind) -> bool {
    match (kind, column.physical_type()) {
        (ColumnKind::Time, Type::INT64) => column.converted_type() == ConvertedType::TIMESTAMP_MICROS,
        (ColumnKind::Whole, Type::INT32 | Type::INT64) => !matches!(column.converted_type(), ConvertedType::DECIMAL),
        (ColumnKind::Real, Type::DOUBLE) | (ColumnKind::Flag, Type::BOOLEAN) | (ColumnKind::Text, Type::BYTE_ARRAY) => {
            true
        }
        _ => false,
    }
}

impl Cells {
    fn of_kind(kind: ColumnKind) -> Cells {
        match kind {
            ColumnKind::Real => Cells::Real(Vec::new()),
            ColumnKind::Text => Cells::Text(Vec::new()),
            ColumnKind::Time | ColumnKind::Whole | ColumnKind::Flag => Cells::Whole(Vec::new()),
        }
    }

    fn read(&mut self, reader: &mut ColumnReader, count: usize) -> io::Result<()> {
        match (self, reader) {
            (Cells::Whole(cells), ColumnReader::BoolColumnReader(reader)) => {
                read(reader, count, cells, |cell| cell.map(i64::from))
            }
            (Cells::Whole(cells), ColumnReader::Int32ColumnReader(reader)) => {
                read(reader, count, cells, |cell| cell.map(i64::from))
            }
            (Cells::Whole(cells), ColumnReader::Int64ColumnReader(reader)) => read(reader, count, cells, |cell| cell),
            (Cells::Real(cells), ColumnReader::DoubleColumnReader(reader)) => {
                read(reader, count, cells, |cell| cell.unwrap_or(f64::NAN))
            }
            (Cells::Text(cells), ColumnReader::ByteArrayColumnReader(reader)) => {
                read(reader, count, cells, |cell| cell)
            }
            _ => Err(invalid("expected columns of one type in all row groups".to_owned())),
        }
    }
}

/// Reads `count` cells in place of those before.
fn read<T: DataType, C>(
    reader: &mut ColumnReaderImpl<T>,
    count: usize,
    cells: &mut Vec<C>,
    cell: impl Fn(Option<T::T>) -> C,
) -> io::Result<()> {
    let (mut levels, mut values) = (Vec::new(), Vec::new());
    let (got, ..) = reader.read_records(count, Some(&mut levels), None, &mut values)?;
    let present = levels.iter().filter(|level| **level > 0).count();
    if got != count || (!levels.is_empty() && (levels.len() != count || present != values.len())) {
        return Err(invalid(format!("expected {count} more rows of a column, got {got}")));
    }
    cells.clear();
    let mut values = values.into_iter();
    if levels.is_empty() {
        cells.extend(values.map(|value| cell(Some(value))));
    } else {
        cells.extend(levels.iter().map(|level| cell(if *level > 0 { values.next() } else { None })));
    }
    match cells.len() == count {
        true => Ok(()),
        false => Err(invalid(format!("expected {count} more rows of a column, got {}", cells.len()))),
    }
}

impl ArchiveRows {
    /// Kind of a column.
    pub fn kind(&self, column: usize) -> Option<ColumnKind> {
        self.columns.get(column).map(|(_, kind)| *kind)
    }

    /// A whole number; a flag is 0 or 1.
    #[inline]
    pub fn whole(&self, column: usize, row: usize) -> Option<i64> {
        match &self.cells[column] {
            Cells::Whole(cells) => cells[row],
            Cells::Real(_) | Cells::Text(_) => None,
        }
    }

    /// A number or flag; `NaN` for null.
    #[inline]
    pub fn number(&self, column: usize, row: usize) -> f64 {
        match &self.cells[column] {
            Cells::Whole(cells) => cells[row].map_or(f64::NAN, |whole| whole as f64),
            Cells::Real(cells) => cells[row],
            Cells::Text(_) => f64::NAN,
        }
    }

    /// A text; empty for null.
    pub fn text(&self, column: usize, row: usize) -> String {
        match &self.cells[column] {
            Cells::Text(cells) => {
                cells[row].as_ref().map_or(String::new(), |text| String::from_utf8_lossy(text.data()).into_owned())
            }
            Cells::Whole(_) | Cells::Real(_) => String::new(),
        }
    }

    /// A whole number of a field.
    ///
    /// # Errors
    /// Null, or a number that the field cannot have.
    #[inline]
    pub fn fitting<T: TryFrom<i64>>(&self, column: usize, row: usize) -> Result<T, String> {
        let fitting = self.whole(column, row).and_then(|whole| T::try_from(whole).ok());
        fitting.ok_or_else(|| {
            self.unexpected(column, &format!("a whole number that fits {}", std::any::type_name::<T>()), row)
        })
    }

    /// Error of a cell: column, expected and got.
    #[cold]
    pub fn unexpected(&self, column: usize, expected: &str, row: usize) -> String {
        let number = self.number(column, row);
        let got = if number.is_nan() { "null".to_owned() } else { number.to_string() };
        format!("column {}: expected {expected}, got {got}", self.columns[column].0)
    }
}
