//! A Parquet file as lines of text: line 1 has the names of its columns, line n + 1 its row n.
//!
//! Columns that are nested are left out. Rows are decoded in batches, so that memory does not grow with the file.

use std::cell::Cell;
use std::fs::File;
use std::io::{self, Cursor, Read, Write};
use std::os::unix::fs::FileExt;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Once;

use parquet::basic::{ConvertedType, LogicalType, TimeUnit};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::{AsBytes, DataType};
use parquet::errors::ParquetError;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::schema::types::ColumnDescriptor;

use crate::input::{Unpacked, unpack};

/// Separates the cells of a line; no cell has it.
pub const SEPARATOR: char = '\u{1f}';
/// First bytes of a file, and of an encrypted file, which the decoder refuses.
const BEGINNINGS: [&[u8; 4]; 2] = [b"PAR1", b"PARE"];
const BATCH_ROWS: usize = 1024;
/// Largest number of decimals: a decimal of 128 bits has no more.
const MAX_SCALE: i32 = 38;

/// Opens rows of text: of Parquet, compressed or plain.
///
/// # Errors
/// A file that cannot be read, or is no complete Parquet file though it begins as one.
pub fn open_table(file: File) -> io::Result<Unpacked<'static>> {
    let mut head = [0; 4];
    let has_head = file.metadata()?.is_file() && file.read_exact_at(&mut head, 0).is_ok();
    if !has_head || !BEGINNINGS.contains(&&head) {
        return unpack(file);
    }
    Ok(Unpacked { reader: Box::new(ParquetText::new(file)?), container: Some("Parquet") })
}

struct ParquetText {
    file: SerializedFileReader<File>,
    /// Places of the columns that are read.
    places: Vec<usize>,
    next_group: usize,
    /// Rows of the present row group that are not yet read.
    rows: usize,
    columns: Vec<Box<dyn Cells>>,
    text: Cursor<Vec<u8>>,
}

impl ParquetText {
    fn new(file: File) -> io::Result<ParquetText> {
        let file = guarded(|| Ok(SerializedFileReader::new(file)?))?;
        let columns = file.metadata().file_metadata().schema_descr().columns();
        let is_plain = |column: &ColumnDescriptor| column.path().parts().len() == 1 && column.max_rep_level() == 0;
        let places: Vec<usize> = (0..columns.len()).filter(|&place| is_plain(&columns[place])).collect();
        if places.is_empty() {
            return Err(invalid("expected columns that are not nested, got none".to_owned()));
        }
        let mut text = Vec::new();
        for &place in &places {
            print_text(columns[place].name().as_bytes(), &mut text)?;
            text.push(SEPARATOR as u8);
        }
        end_line(&mut text);
        Ok(ParquetText { file, places, next_group: 0, rows: 0, columns: Vec::new(), text: Cursor::new(text) })
    }

    /// Reads rows of one row group; false at the end of the file.
    fn next_batch(&mut self) -> io::Result<bool> {
        if self.rows == 0 {
            if self.next_group == self.file.num_row_groups() {
                return Ok(false);
            }
            let group = self.file.get_row_group(self.next_group)?;
            let columns = self.places.iter().map(|&place| {
                let reader = group.get_column_reader(place)?;
                cells(reader, group.metadata().column(place).column_descr())
            });
            self.columns = columns.collect::<io::Result<_>>()?;
            self.rows = usize::try_from(group.metadata().num_rows()).map_err(io::Error::other)?;
            self.next_group += 1;
        }
        let expected = self.rows.min(BATCH_ROWS);
        for column in &mut self.columns {
            let got = column.read(expected)?;
            if got != expected {
                return Err(invalid(format!("expected {expected} more rows of a column, got {got}")));
            }
        }
        self.rows -= expected;
        self.text.set_position(0);
        let text = self.text.get_mut();
        text.clear();
        for _ in 0..expected {
            for column in &mut self.columns {
                column.print(text)?;
                text.push(SEPARATOR as u8);
            }
            end_line(text);
        }
        Ok(true)
    }
}

impl Read for ParquetText {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.text.position() == self.text.get_ref().len() as u64 {
            let group = self.next_group + usize::from(self.rows == 0);
            let batch = guarded(|| self.next_batch());
            if !batch.map_err(|error| invalid(format!("row group {group}, damaged or encrypted: {error}")))? {
                return Ok(0);
            }
        }
        self.text.read(buffer)
    }
}

/// The cells of one column.
trait Cells {
    /// Reads up to `rows` rows, and returns their number.
    fn read(&mut self, rows: usize) -> Result<usize, ParquetError>;

    /// Appends the next cell; a null is empty.
    fn print(&mut self, text: &mut Vec<u8>) -> io::Result<()>;
}

struct Column<T: DataType, P> {
    reader: ColumnReaderImpl<T>,
    print: P,
    /// Values of the rows that have one.
    values: Vec<T::T>,
    /// 1 of a row with a value, 0 of null; empty where every row has a value.
    levels: Vec<i16>,
    next_value: usize,
    next_row: usize,
}

impl<T: DataType, P: Fn(&T::T, &mut Vec<u8>) -> io::Result<()>> Cells for Column<T, P> {
    fn read(&mut self, rows: usize) -> Result<usize, ParquetError> {
        self.values.clear();
        self.levels.clear();
        (self.next_value, self.next_row) = (0, 0);
        Ok(self.reader.read_records(rows, Some(&mut self.levels), None, &mut self.values)?.0)
    }

    fn print(&mut self, text: &mut Vec<u8>) -> io::Result<()> {
        let is_null = self.levels.get(self.next_row) == Some(&0);
        self.next_row += 1;
        let Some(value) = self.values.get(self.next_value).filter(|_| !is_null) else { return Ok(()) };
        self.next_value += 1;
        (self.print)(value, text)
    }
}

fn column<T: DataType>(
    reader: ColumnReaderImpl<T>,
    print: impl Fn(&T::T, &mut Vec<u8>) -> io::Result<()> + 'static,
) -> Box<dyn Cells> {
    Box::new(Column { reader, print, values: Vec::new(), levels: Vec::new(), next_value: 0, next_row: 0 })
}

/// The cells of a column by its type.
fn cells(reader: ColumnReader, descriptor: &ColumnDescriptor) -> io::Result<Box<dyn Cells>> {
    let whole = Whole::of_column(descriptor)?;
    Ok(match reader {
        ColumnReader::BoolColumnReader(reader) => column(reader, |value, text| write!(text, "{}", u8::from(*value))),
        ColumnReader::Int32ColumnReader(reader) => column(reader, move |value, text| match whole {
            Whole::Unsigned => write!(text, "{}", value.cast_unsigned()),
            _ => whole.print(i128::from(*value), text),
        }),
        ColumnReader::Int64ColumnReader(reader) => column(reader, move |value, text| match whole {
            Whole::Unsigned => write!(text, "{}", value.cast_unsigned()),
            _ => whole.print(i128::from(*value), text),
        }),
        ColumnReader::Int96ColumnReader(reader) => {
            column(reader, |value, text| Whole::Of("ns").print(i128::from(value.to_nanos()), text))
        }
        ColumnReader::FloatColumnReader(reader) => column(reader, |value, text| write!(text, "{value}")),
        ColumnReader::DoubleColumnReader(reader) => column(reader, |value, text| write!(text, "{value}")),
        ColumnReader::ByteArrayColumnReader(reader) => column(reader, move |value, text| match whole {
            Whole::Decimal(_) => whole.print(big_endian(value.data())?, text),
            _ => print_text(value.data(), text),
        }),
        ColumnReader::FixedLenByteArrayColumnReader(reader) => column(reader, move |value, text| match whole {
            Whole::Decimal(_) => whole.print(big_endian(value.as_bytes())?, text),
            _ => print_text(value.as_bytes(), text),
        }),
    })
}

/// Content of a whole number.
#[derive(Clone, Copy)]
enum Whole {
    Signed,
    Unsigned,
    /// Number of decimals.
    Decimal(usize),
    /// A time in this unit.
    Of(&'static str),
}

impl Whole {
    fn of_column(column: &ColumnDescriptor) -> io::Result<Whole> {
        match column.logical_type_ref() {
            Some(LogicalType::Timestamp(time)) if time.unit == TimeUnit::NANOS => return Ok(Whole::Of("ns")),
            Some(LogicalType::Time(time)) if time.unit == TimeUnit::NANOS => return Ok(Whole::Of("ns")),
            _ => {}
        }
        Ok(match column.converted_type() {
            ConvertedType::TIMESTAMP_MILLIS | ConvertedType::TIME_MILLIS => Whole::Of("ms"),
            ConvertedType::TIMESTAMP_MICROS | ConvertedType::TIME_MICROS => Whole::Of("us"),
            ConvertedType::DATE => Whole::Of("days"),
            ConvertedType::UINT_8 | ConvertedType::UINT_16 | ConvertedType::UINT_32 | ConvertedType::UINT_64 => {
                Whole::Unsigned
            }
            ConvertedType::DECIMAL => match column.type_scale() {
                scale @ 0..=MAX_SCALE => Whole::Decimal(scale as usize),
                scale => return Err(invalid(format!("expected 0 to {MAX_SCALE} decimals, got {scale}"))),
            },
            _ => Whole::Signed,
        })
    }

    fn print(self, value: i128, text: &mut Vec<u8>) -> io::Result<()> {
        match self {
            Whole::Of(unit) => write!(text, "{value} {unit}"),
            Whole::Decimal(scale) => {
                let digits = format!("{:0>1$}", value.unsigned_abs(), scale + 1);
                let (whole, decimals) = digits.split_at(digits.len() - scale);
                write!(text, "{}{whole}.{decimals}", if value < 0 { "-" } else { "" })
            }
            Whole::Signed | Whole::Unsigned => write!(text, "{value}"),
        }
    }
}

/// A number of up to 16 bytes in two's complement.
fn big_endian(bytes: &[u8]) -> io::Result<i128> {
    let is_negative = bytes.first().is_some_and(|first| *first >= 0x80);
    let mut all = [if is_negative { 0xFF } else { 0 }; 16];
    let start = all.len().checked_sub(bytes.len());
    let start = start.ok_or_else(|| invalid(format!("expected a decimal of up to 16 bytes, got {}", bytes.len())))?;
    all[start..].copy_from_slice(bytes);
    Ok(i128::from_be_bytes(all))
}

/// Appends text of one line, without control characters, double quotes and the mark of a remark at its start.
fn print_text(bytes: &[u8], text: &mut Vec<u8>) -> io::Result<()> {
    let is_replaced = |letter: char| letter.is_control() || letter == '"';
    let cell = String::from_utf8_lossy(bytes).replace(is_replaced, " ");
    text.write_all(cell.trim_start_matches('#').as_bytes())
}

/// Ends a line in place of the separator after its last cell.
fn end_line(text: &mut [u8]) {
    if let Some(last) = text.last_mut() {
        *last = b'\n';
    }
}

/// Decodes; a panic of the decoder, which some damaged files cause, is an error and prints no message.
pub(crate) fn guarded<T>(decode: impl FnOnce() -> io::Result<T>) -> io::Result<T> {
    static HOOK: Once = Once::new();
    thread_local!(static IS_DECODING: Cell<bool> = const { Cell::new(false) });
    HOOK.call_once(|| {
        let print = panic::take_hook();
        panic::set_hook(Box::new(move |panic| {
            if !IS_DECODING.get() {
                print(panic)
            }
        }));
    });
    IS_DECODING.set(true);
    let result = panic::catch_unwind(AssertUnwindSafe(decode));
    IS_DECODING.set(false);
    result.unwrap_or_else(|_| Err(invalid("the decoder stopped".to_owned())))
}

pub(crate) fn invalid(message: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, message)
}

#[cfg(test)]
mod tests;
