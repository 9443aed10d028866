//! CSV tables with a header: columns by name, numbers with positions of errors.
//!
//! Every table of a recording is read through this: reference attitudes, rates, manoeuvres, absolute sensors.

use std::io::{self, Read};

use geu_model::attitude::AttitudeRowsError;
use geu_protocol::excerpt::excerpt;

use crate::parquet_text::SEPARATOR;
use crate::text::{RowReader, Table};

/// Why a table cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The file cannot be read.
    #[error("{name}: cannot be read: {source}; expected {expected}")]
    Read { name: String, expected: &'static str, source: io::Error },
    /// The text is no CSV, or a row has another number of fields.
    #[error("{name}: {source}")]
    Csv { name: String, source: csv::Error },
    /// A field, or the header, has other contents than expected; lines count from 1.
    #[error("{name}: line {line}: {field}: expected {expected}, got {got}")]
    Field { name: String, line: u64, field: String, expected: String, got: String },
    /// The rows are no attitude.
    #[error("{name}: line {line}: {source}")]
    Rows { name: String, line: u64, source: AttitudeRowsError },
}

impl TableError {
    /// The error of a file that cannot be read, made of its cause.
    pub fn read(name: &str, expected: &'static str) -> impl Fn(io::Error) -> TableError {
        move |source| TableError::Read { name: name.to_owned(), expected, source }
    }
}

/// A table at one of its rows; [`CsvTable::read`] moves to the next.
pub struct CsvTable<R> {
    name: String,
    header: csv::StringRecord,
    record: csv::StringRecord,
    table: Table<R>,
}

impl<R: Read> CsvTable<R> {
    /// Reads the header. `name` is the table's in errors.
    ///
    /// # Errors
    /// A header that cannot be read.
    pub fn new(name: &str, rows: RowReader<R>) -> Result<CsvTable<R>, TableError> {
        CsvTable::build(name, rows, csv::ReaderBuilder::new().comment(Some(b'#')))
    }

    /// Reads the header of a table with rows that may end early; the missing fields are empty.
    ///
    /// # Errors
    /// A header that cannot be read.
    pub fn with_short_rows(name: &str, rows: RowReader<R>) -> Result<CsvTable<R>, TableError> {
        CsvTable::build(name, rows, csv::ReaderBuilder::new().comment(Some(b'#')).flexible(true))
    }

    fn build(name: &str, mut rows: RowReader<R>, builder: &mut csv::ReaderBuilder) -> Result<CsvTable<R>, TableError> {
        // The most frequent character of the header, except of Parquet.
        let head =
            rows.first_lines().map_err(|source| TableError::Csv { name: name.to_owned(), source: source.into() })?;
        let header = head.iter().find(|line| !line.trim().is_empty() && !line.starts_with('#'));
        let count = |delimiter: &char| header.map_or(0, |header| header.matches(*delimiter).count());
        let delimiter = Some(SEPARATOR).filter(|own| count(own) > 0);
        let delimiter = delimiter.or_else(|| ['\t', ';', ','].into_iter().max_by_key(count)).unwrap_or(',');
        let mut table = rows.table(builder.trim(csv::Trim::Headers).delimiter(delimiter as u8));
        let header = table.header().map_err(|source| TableError::Csv { name: name.to_owned(), source })?;
        Ok(CsvTable { name: name.to_owned(), header, record: csv::StringRecord::new(), table })
    }

    /// Place of the column with this title.
    pub fn column(&self, title: &str) -> Option<usize> {
        self.header.iter().position(|column| column == title)
    }

    pub fn titles(&self) -> impl Iterator<Item = &str> {
        self.header.iter()
    }

    /// True for an empty field and for NaN.
    pub fn is_missing(&self, column: usize) -> bool {
        self.text(column).is_empty() || self.text(column).parse().is_ok_and(f64::is_nan)
    }

    /// Places of all these columns.
    ///
    /// # Errors
    /// A missing column.
    pub fn columns<const N: usize>(&self, titles: [&str; N]) -> Result<[usize; N], TableError> {
        let mut places = [0; N];
        for (place, title) in places.iter_mut().zip(titles) {
            *place = self.column(title).ok_or_else(|| self.without_columns(&titles.join(", ")))?;
        }
        Ok(places)
    }

    /// The error of a header without the expected columns.
    pub fn without_columns(&self, expected: &str) -> TableError {
        let columns = self.header.iter().collect::<Vec<_>>().join(", ");
        TableError::Field {
            name: self.name.clone(),
            line: 1,
            field: "header".to_owned(),
            expected: format!("the columns {expected}"),
            got: if columns.is_empty() { "none".to_owned() } else { excerpt(&columns).into_owned() },
        }
    }

    /// Moves to the next row; false at the end.
    ///
    /// # Errors
    /// A row that cannot be read, is too long or has another number of fields.
    pub fn read(&mut self) -> Result<bool, TableError> {
        self.table.read(&mut self.record).map_err(|source| TableError::Csv { name: self.name.clone(), source })
    }

    /// Line of the row, from 1.
    pub fn line(&self) -> u64 {
        self.record.position().map_or(0, csv::Position::line)
    }

    /// A field without the blanks around it.
    pub fn text(&self, column: usize) -> &str {
        // csv, asked to remove them, builds every record twice.
        self.record.get(column).unwrap_or_default().trim()
    }

    /// A finite number of the row.
    ///
    /// # Errors
    /// Other contents.
    pub fn number(&self, column: usize) -> Result<f64, TableError> {
        let number = self.text(column).parse::<f64>().ok().filter(|number| number.is_finite());
        number.ok_or_else(|| self.unexpected(column, "a number"))
    }

    /// The error of a field with other contents than expected.
    pub fn unexpected(&self, column: usize, expected: &str) -> TableError {
        TableError::Field {
            name: self.name.clone(),
            line: self.line(),
            field: self.header.get(column).unwrap_or_default().to_owned(),
            expected: expected.to_owned(),
            got: format!("{:?}", excerpt(self.text(column))),
        }
    }
}
