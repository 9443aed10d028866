//! Samples as columns: Arrow batches of any unit, and Parquet and Arrow files of them.
//!
//! A column has the name of its CSV column and its unit in its metadata; each flag is also a boolean column. The metadata of the schema
//! and of the file has the unit with its description, so that a file states by itself what it contains. `geu_recording::archive` reads
//! the rows back.

pub use arrow_array::RecordBatch;
pub use arrow_schema::SchemaRef;

mod cells;
mod columns;
mod described;
mod file;
mod truth;

pub use cells::CellColumns;
pub use columns::UnitColumns;
pub use described::DeviceColumns;
pub use file::{BatchFile, FileFormat, Partition};
pub use truth::TruthColumns;

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, Int8Array, Int16Array, TimestampMicrosecondArray};
use arrow_buffer::{BooleanBuffer, Buffer, NullBuffer};
use arrow_schema::{DataType, Field, TimeUnit};
use geu_protocol::capture::Timestamp;

/// Key of the unit of a column, in its metadata.
pub const UNIT: &str = "unit";
/// Beginning of the keys of files that the description names, with their texts.
pub const FILE: &str = "geu.file.";
/// Key of the version of geu that made the columns.
const VERSION: &str = "geu.version";

/// A column with the unit of its values.
fn field(name: &str, kind: DataType, unit: &str, is_nullable: bool) -> Field {
    let field = Field::new(name, kind, is_nullable);
    match unit {
        "" => field,
        unit => field.with_metadata(HashMap::from([(UNIT.to_owned(), unit.to_owned())])),
    }
}

/// Rows as columns.
pub trait Columns: Clone + Send + 'static {
    type Row: Clone + Send + 'static;

    /// Names, types and units of the columns; the unit in the metadata.
    fn schema(&self) -> SchemaRef;

    /// The columns of these rows.
    fn batch(&self, rows: &[Self::Row]) -> RecordBatch;
}

/// The columns of times: an instant in UTC to the microsecond, the same in seconds, the nanoseconds between both, and the decimals of the
/// source.
fn time_fields([time, t_s, rest_ns, decimals]: [&str; 4]) -> [Field; 4] {
    let utc = DataType::Timestamp(TimeUnit::Microsecond, Some("UTC".into()));
    [
        field(time, utc, "", true),
        field(t_s, DataType::Float64, "s", true),
        field(rest_ns, DataType::Int16, "ns", true),
        field(decimals, DataType::Int8, "", true),
    ]
}

fn time_columns(times: impl Iterator<Item = Option<Timestamp>> + Clone) -> [ArrayRef; 4] {
    let known = nulls(times.clone().map(|time| time.is_some()));
    let t_ns = times.clone().map(|time| time.map_or(0, |time| time.t_ns));
    let time_us = t_ns.clone().map(rounded_us).collect::<Vec<i64>>();
    let t_s = t_ns.clone().map(seconds).collect::<Vec<f64>>();
    let rest_ns = |t_ns: i64| (i128::from(t_ns) - i128::from(rounded_us(t_ns)) * 1000) as i16;
    let rest_ns = t_ns.map(rest_ns).collect::<Vec<i16>>();
    let digits = times.map(|time| time.map_or(0, |time| time.digits as i8)).collect::<Vec<i8>>();
    [
        Arc::new(TimestampMicrosecondArray::new(time_us.into(), known.clone()).with_timezone("UTC")),
        Arc::new(Float64Array::new(t_s.into(), known.clone())),
        Arc::new(Int16Array::new(rest_ns.into(), known.clone())),
        Arc::new(Int8Array::new(digits.into(), known)),
    ]
}

#[inline]
fn rounded_us(t_ns: i64) -> i64 {
    t_ns.div_euclid(1000) + i64::from(t_ns.rem_euclid(1000) >= 500)
}

/// The nearest number of seconds, which the decimals of the time read as.
#[inline]
fn seconds(t_ns: i64) -> f64 {
    const EXACT: u64 = 1 << 53;
    match (t_ns.unsigned_abs() < EXACT, t_ns % 1000) {
        (true, _) => t_ns as f64 / 1e9,
        // Exact, and divided with one rounding.
        (false, 0) => (t_ns / 1000) as f64 / 1e6,
        (false, _) => format!("{t_ns}e-9").parse().unwrap_or(f64::NAN),
    }
}

/// `None` if all are known.
fn nulls(is_known: impl Iterator<Item = bool>) -> Option<NullBuffer> {
    let is_known = booleans(&is_known.map(u8::from).collect::<Vec<u8>>(), 0);
    (is_known.count_set_bits() < is_known.len()).then(|| NullBuffer::new(is_known))
}

/// This bit of each byte.
fn booleans(bytes: &[u8], bit: u8) -> BooleanBuffer {
    let of_eight = |bytes: &[u8]| {
        let mut eight = [0; 8];
        eight[..bytes.len()].copy_from_slice(bytes);
        lowest_bits(u64::from_le_bytes(eight) >> bit)
    };
    let bits = bytes.chunks(8).map(of_eight).collect::<Vec<u8>>();
    BooleanBuffer::new(Buffer::from_vec(bits), 0, bytes.len())
}

/// The lowest bit of each byte, that of the first byte first.
fn lowest_bits(bytes: u64) -> u8 {
    // The product moves the bit of byte i from 8 i to 56 + i; no two of its terms meet.
    ((bytes & 0x0101_0101_0101_0101).wrapping_mul(0x0102_0408_1020_4080) >> 56) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_bit_of_bytes_is_a_boolean() {
        let bytes: Vec<u8> = (0..=255).chain([0x5a; 3]).collect();
        for (length, bit) in [(0, 0), (1, 7), (7, 3), (8, 4), (9, 0), (259, 0), (259, 5), (259, 7)] {
            let expected: Vec<bool> = bytes[..length].iter().map(|byte| byte >> bit & 1 == 1).collect();
            assert_eq!(
                booleans(&bytes[..length], bit).iter().collect::<Vec<bool>>(),
                expected,
                "{length} bytes, bit {bit}"
            );
        }
    }

    #[test]
    fn unknown_values_are_nulls() {
        assert_eq!(nulls([true; 9].into_iter()), None);
        let nulls = nulls([true, false, true].into_iter()).unwrap();
        assert_eq!(nulls.iter().collect::<Vec<bool>>(), [true, false, true]);
    }
}
