//! Columns of a described unit.

use std::collections::HashMap;
use std::mem::take;
use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow_buffer::NullBuffer;
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use geu_model::device::{Device, DeviceText, TableWire};
use geu_recording::DeviceSample;

use crate::{Columns, DESCRIPTION, DEVICE, FILE, Times, VERSION, field, nulls, seconds};

/// Columns of a described unit: time, number of the sample, its values by their names; start and trial if a table has them.
#[derive(Debug)]
pub struct DeviceColumns {
    schema: SchemaRef,
    interval_s: f64,
    times: Times,
    number: Vec<i64>,
    values: Vec<Vec<f64>>,
    start: Option<Starts>,
    group: Option<Vec<String>>,
}

#[derive(Debug, Default)]
struct Starts {
    start_s: Vec<f64>,
    is_known: Vec<bool>,
}

impl DeviceColumns {
    pub fn new(device: &Device) -> DeviceColumns {
        let has = |column: fn(&TableWire) -> bool| device.table.as_ref().is_some_and(column);
        let start = has(|table| table.start.is_some()).then(Starts::default);
        let group = has(|table| table.group.is_some()).then(Vec::new);
        let mut fields = Times::fields().to_vec();
        fields.push(Field::new("number", DataType::Int64, false));
        // The unit of a value is the end of its name.
        fields.extend(device.values().iter().map(|value| field(&value.name, DataType::Float64, "", true)));
        fields.extend(start.iter().map(|_| field("start_s", DataType::Float64, "s", true)));
        fields.extend(group.iter().map(|_| Field::new("group", DataType::Utf8, false)));
        let DeviceText { name, text, files } = &device.description;
        let metadata = [(DEVICE, &name[..]), (DESCRIPTION, text), (VERSION, env!("CARGO_PKG_VERSION"))];
        let metadata = metadata.map(|(key, value)| (key.to_owned(), value.to_owned()));
        let files = files.iter().map(|(name, text)| (format!("{FILE}{name}"), text.clone()));
        let metadata: HashMap<String, String> = metadata.into_iter().chain(files).collect();
        DeviceColumns {
            schema: Arc::new(Schema::new_with_metadata(fields, metadata)),
            interval_s: device.interval_s,
            times: Times::default(),
            number: Vec::new(),
            values: vec![Vec::new(); device.values().len()],
            start,
            group,
        }
    }
}

impl Columns for DeviceColumns {
    type Row = DeviceSample;

    fn schema(&self) -> SchemaRef {
        self.schema.clone()
    }

    #[inline]
    fn push(&mut self, row: &DeviceSample) {
        self.times.push(Some(row.time_or_number(self.interval_s)));
        self.number.push(row.number as i64);
        for (column, &value) in self.values.iter_mut().zip(&row.values) {
            column.push(value);
        }
        if let Some(Starts { start_s, is_known }) = &mut self.start {
            start_s.push(row.start.map_or(0.0, |start| seconds(start.t_ns)));
            is_known.push(row.start.is_some());
        }
        if let Some(group) = &mut self.group {
            group.push(row.group.clone());
        }
    }

    fn len(&self) -> usize {
        self.number.len()
    }

    fn take(&mut self) -> RecordBatch {
        let mut columns: Vec<ArrayRef> = self.times.take().to_vec();
        columns.push(Arc::new(Int64Array::from(take(&mut self.number))));
        columns.extend(self.values.iter_mut().map(|own| Arc::new(real(take(own))) as ArrayRef));
        if let Some(Starts { start_s, is_known }) = &mut self.start {
            columns.push(Arc::new(Float64Array::new(take(start_s).into(), nulls(is_known))));
        }
        if let Some(group) = &mut self.group {
            columns.push(Arc::new(StringArray::from(take(group))));
        }
        RecordBatch::try_new(self.schema.clone(), columns).expect("columns as the schema has them")
    }
}

/// A value that no frame had is null.
fn real(values: Vec<f64>) -> Float64Array {
    let is_missing = values.iter().any(|value| !value.is_finite());
    let nulls = is_missing.then(|| NullBuffer::from_iter(values.iter().map(|value| value.is_finite())));
    Float64Array::new(values.into(), nulls)
}
