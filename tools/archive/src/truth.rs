//! The truth of a simulated run as columns.

use std::collections::HashMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::{
    ArrayRef, DictionaryArray, Float64Array, Int32Array, Int64Array, RecordBatch, StringArray, UInt8Array,
};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use geu_files::{Output, persist_all};
use geu_model::Configuration;
use geu_model::device::columns::TIME;
use geu_protocol::capture::Timestamp;
use geu_recorder::{TruthRow, TruthTable, number_names};
use geu_recording::archive::{CONTENT, DEVICE};

use crate::{BatchFile, FileFormat, VERSION, field, time_columns, time_fields};

/// Rows of a batch.
const BATCH_ROWS: usize = 1 << 16;

/// `truth.parquet` or `truth.arrow`: the columns of `truth.csv`, with the columns of times of samples.
pub struct TruthColumns {
    path: PathBuf,
    format: FileFormat,
    schema: SchemaRef,
    gyro_names: Arc<StringArray>,
    /// True if every count is a whole number.
    is_rounded: bool,
    times: Vec<Timestamp>,
    sequence: Vec<i32>,
    gyro: Vec<u8>,
    numbers: Vec<Vec<f64>>,
    count: Vec<f64>,
    file: Option<BatchFile>,
}

impl TruthColumns {
    /// The file of a run in `directory`, which is created with the first batch.
    pub fn new(directory: &Path, format: FileFormat, configuration: &Configuration) -> TruthColumns {
        let device = &configuration.device;
        let names = number_names(&configuration.columns());
        let is_rounded = device.heads.iter().all(|head| head.is_rounded);
        let kind_of_gyro = DataType::Dictionary(DataType::UInt8.into(), DataType::Utf8.into());
        let kind_of_count = if is_rounded { DataType::Int64 } else { DataType::Float64 };
        let mut fields = time_fields(TIME).to_vec();
        fields.push(field("sequence", DataType::Int32, "", false));
        fields.push(Field::new("gyro", kind_of_gyro, false));
        let unit = |name: &str| if name == "true_arcsec" { "arcsec" } else { "count" };
        fields.extend(names.iter().map(|name| field(name, DataType::Float64, unit(name), false)));
        fields.push(field("count", kind_of_count, "count", false));
        let metadata = [(CONTENT, "truth"), (DEVICE, device.unit_name()), (VERSION, env!("CARGO_PKG_VERSION"))];
        let metadata: HashMap<String, String> = metadata.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
        TruthColumns {
            path: directory.join(format!("truth.{}", format.suffix())),
            format,
            schema: Arc::new(Schema::new_with_metadata(fields, metadata)),
            gyro_names: Arc::new(device.heads.iter().map(|head| Some(head.gyro.name())).collect()),
            is_rounded,
            times: Vec::new(),
            sequence: Vec::new(),
            gyro: Vec::new(),
            numbers: vec![Vec::new(); names.len()],
            count: Vec::new(),
            file: None,
        }
    }

    fn take_batch(&mut self) -> RecordBatch {
        let mut columns: Vec<ArrayRef> = time_columns(emptied(&mut self.times).iter().copied().map(Some)).to_vec();
        columns.push(Arc::new(Int32Array::from(emptied(&mut self.sequence))));
        let gyro = UInt8Array::from(emptied(&mut self.gyro));
        columns.push(Arc::new(DictionaryArray::new(gyro, self.gyro_names.clone())));
        columns.extend(self.numbers.iter_mut().map(|own| Arc::new(Float64Array::from(emptied(own))) as ArrayRef));
        let count = emptied(&mut self.count);
        columns.push(match self.is_rounded {
            true => Arc::new(count.into_iter().map(|count| count as i64).collect::<Int64Array>()),
            false => Arc::new(Float64Array::from(count)),
        });
        RecordBatch::try_new(self.schema.clone(), columns).expect("columns as the schema has them")
    }

    /// The file with the rows until now.
    fn write_batch(&mut self) -> io::Result<BatchFile> {
        let mut file = match self.file.take() {
            Some(file) => file,
            None => BatchFile::new(Output::create(&self.path)?, self.format, &self.schema)?,
        };
        file.write(&self.take_batch())?;
        Ok(file)
    }
}

impl TruthTable for TruthColumns {
    fn path(&self) -> &Path {
        &self.path
    }

    fn row(&mut self, time: Timestamp, sequence: u16, row: &TruthRow) -> io::Result<()> {
        self.times.push(time);
        self.sequence.push(sequence.into());
        self.gyro.push(row.head as u8);
        self.numbers.iter_mut().zip(row.numbers).for_each(|(column, number)| column.push(*number));
        self.count.push(row.count);
        if self.count.len() >= BATCH_ROWS {
            self.file = Some(self.write_batch()?);
        }
        Ok(())
    }

    fn finish(&mut self) -> io::Result<()> {
        persist_all(vec![self.write_batch()?.finish()?])
    }
}

/// The values; the vector is empty afterwards, with the same capacity.
fn emptied<T>(values: &mut Vec<T>) -> Vec<T> {
    let capacity = values.capacity();
    std::mem::replace(values, Vec::with_capacity(capacity))
}
