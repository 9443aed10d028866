//! Samples as columns: Arrow batches of any unit, and Parquet and Arrow files of them.
//!
//! A column has the name of its CSV column and its unit in its metadata; each flag is a boolean column. The metadata of the schema
//! has the unit with its description, so that a file says by itself what it contains.

pub use arrow_array::RecordBatch;
pub use arrow_schema::SchemaRef;

mod columns;
mod described;
mod file;

pub use columns::{Columns, UnitColumns};
pub use described::DeviceColumns;
pub use file::{BatchFile, FileFormat, Partition};

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::ArrayRef;
use arrow_buffer::NullBuffer;
use arrow_schema::{DataType, Field, TimeUnit};
use geu_protocol::capture::Timestamp;

/// Key of the unit of a column, in its metadata.
const UNIT: &str = "unit";
/// Key of the name of the gyro unit in the metadata of a schema.
pub const DEVICE: &str = "geu.device";
/// Key of its description; absent for the default unit.
pub const DESCRIPTION: &str = "geu.description";
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

/// The columns of times: an instant in UTC, to the microsecond, and the same in seconds, to the resolution of the source.
#[derive(Debug, Default)]
struct Times {
    time_us: Vec<i64>,
    t_s: Vec<f64>,
    is_known: Vec<bool>,
}

impl Times {
    fn fields() -> [Field; 2] {
        let utc = DataType::Timestamp(TimeUnit::Microsecond, Some("UTC".into()));
        [field("time", utc, "", true), field("t_s", DataType::Float64, "s", true)]
    }

    #[inline]
    fn push(&mut self, time: Option<Timestamp>) {
        let t_ns = time.map_or(0, |time| time.t_ns);
        self.time_us.push(t_ns.div_euclid(1000) + i64::from(t_ns.rem_euclid(1000) >= 500));
        self.t_s.push(seconds(t_ns));
        self.is_known.push(time.is_some());
    }

    fn take(&mut self) -> [ArrayRef; 2] {
        let known = nulls(&mut self.is_known);
        let time_us = std::mem::take(&mut self.time_us).into();
        let time = arrow_array::TimestampMicrosecondArray::new(time_us, known.clone()).with_timezone("UTC");
        let t_s = arrow_array::Float64Array::new(std::mem::take(&mut self.t_s).into(), known);
        [Arc::new(time), Arc::new(t_s)]
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

/// `None` if all are known.
fn nulls(is_known: &mut Vec<bool>) -> Option<NullBuffer> {
    let is_known = std::mem::take(is_known);
    is_known.contains(&false).then(|| NullBuffer::from(is_known))
}
