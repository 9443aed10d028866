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
pub use columns::{Columns, UnitColumns};
pub use described::DeviceColumns;
pub use file::{BatchFile, FileFormat, Partition};
pub use truth::TruthColumns;

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, Int8Array, Int16Array, TimestampMicrosecondArray};
use arrow_buffer::NullBuffer;
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

/// The columns of times: an instant in UTC to the microsecond, the same in seconds, the nanoseconds between both, and the decimals of the
/// source.
#[derive(Debug, Default)]
struct Times {
    time_us: Vec<i64>,
    t_s: Vec<f64>,
    rest_ns: Vec<i16>,
    digits: Vec<i8>,
    is_known: Vec<bool>,
}

impl Times {
    fn fields([time, t_s, rest_ns, decimals]: [&str; 4]) -> [Field; 4] {
        let utc = DataType::Timestamp(TimeUnit::Microsecond, Some("UTC".into()));
        [
            field(time, utc, "", true),
            field(t_s, DataType::Float64, "s", true),
            field(rest_ns, DataType::Int16, "ns", true),
            field(decimals, DataType::Int8, "", true),
        ]
    }

    #[inline]
    fn push(&mut self, time: Option<Timestamp>) {
        let t_ns = time.map_or(0, |time| time.t_ns);
        let time_us = t_ns.div_euclid(1000) + i64::from(t_ns.rem_euclid(1000) >= 500);
        self.time_us.push(time_us);
        self.t_s.push(seconds(t_ns));
        self.rest_ns.push((i128::from(t_ns) - i128::from(time_us) * 1000) as i16);
        self.digits.push(time.map_or(0, |time| time.digits as i8));
        self.is_known.push(time.is_some());
    }

    fn take_batch(&mut self) -> [ArrayRef; 4] {
        let known = nulls(&mut self.is_known);
        let time =
            TimestampMicrosecondArray::new(emptied(&mut self.time_us).into(), known.clone()).with_timezone("UTC");
        let t_s = Float64Array::new(emptied(&mut self.t_s).into(), known.clone());
        let rest_ns = Int16Array::new(emptied(&mut self.rest_ns).into(), known.clone());
        let digits = Int8Array::new(emptied(&mut self.digits).into(), known);
        [Arc::new(time), Arc::new(t_s), Arc::new(rest_ns), Arc::new(digits)]
    }
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

/// The values; the vector is empty afterwards, with the same capacity.
fn emptied<T>(values: &mut Vec<T>) -> Vec<T> {
    let capacity = values.capacity();
    std::mem::replace(values, Vec::with_capacity(capacity))
}

/// `None` if all are known.
fn nulls(is_known: &mut Vec<bool>) -> Option<NullBuffer> {
    let is_known = emptied(is_known);
    is_known.contains(&false).then(|| NullBuffer::from(is_known))
}
