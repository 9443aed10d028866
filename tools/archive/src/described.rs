//! Columns of a described unit.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::{ArrayRef, BooleanArray, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use geu_model::device::columns::{GROUP, IS_RECEIVED, NUMBER, START, TIME};
use geu_model::device::{Device, TableWire};
use geu_recording::DeviceSample;
use geu_recording::archive::{ColumnKind, DESCRIPTION, DEVICE};

use crate::{Columns, FILE, Times, VERSION, emptied, field};

/// Columns of a described unit: time, number of the sample, its values by their names; start and trial if a table has them.
#[derive(Debug)]
pub struct DeviceColumns {
    schema: SchemaRef,
    interval_s: f64,
    times: Times,
    number: Vec<i64>,
    values: Vec<(ColumnKind, Vec<f64>)>,
    is_received: Vec<bool>,
    start: Option<Times>,
    group: Option<Vec<String>>,
}

impl DeviceColumns {
    pub fn new(device: &Device) -> DeviceColumns {
        let has = |column: fn(&TableWire) -> bool| device.table.as_ref().is_some_and(column);
        let start = has(|table| table.start.is_some()).then(Times::default);
        let group = has(|table| table.group.is_some()).then(Vec::new);
        let mut fields = Times::fields(TIME).to_vec();
        fields.push(Field::new(NUMBER, DataType::Int64, false));
        let kinds: Vec<ColumnKind> =
            (0..device.values().len()).map(|slot| ColumnKind::of_value(device, slot)).collect();
        let values = device.values().iter().zip(&kinds);
        fields.extend(values.map(|(value, kind)| field(&value.name, type_of(*kind), value.unit, true)));
        fields.push(Field::new(IS_RECEIVED, DataType::Boolean, false));
        fields.extend(start.iter().flat_map(|_| Times::fields(START)));
        fields.extend(group.iter().map(|_| Field::new(GROUP, DataType::Utf8, false)));
        let description = &device.description;
        let metadata =
            [(DEVICE, device.unit_name()), (DESCRIPTION, &description.text), (VERSION, env!("CARGO_PKG_VERSION"))];
        let metadata = metadata.map(|(key, value)| (key.to_owned(), value.to_owned()));
        let files = description.files.iter().map(|(name, text)| (format!("{FILE}{name}"), text.clone()));
        let metadata: HashMap<String, String> = metadata.into_iter().chain(files).collect();
        DeviceColumns {
            schema: Arc::new(Schema::new_with_metadata(fields, metadata)),
            interval_s: device.interval_s,
            times: Times::default(),
            number: Vec::new(),
            values: kinds.into_iter().map(|kind| (kind, Vec::new())).collect(),
            is_received: Vec::new(),
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
        for ((_, column), &value) in self.values.iter_mut().zip(&row.values) {
            column.push(value);
        }
        self.is_received.push(row.time.is_some());
        if let Some(start) = &mut self.start {
            start.push(row.start);
        }
        if let Some(group) = &mut self.group {
            group.push(row.group.clone());
        }
    }

    fn len(&self) -> usize {
        self.number.len()
    }

    fn take_batch(&mut self) -> RecordBatch {
        let mut columns: Vec<ArrayRef> = self.times.take_batch().to_vec();
        columns.push(Arc::new(Int64Array::from(emptied(&mut self.number))));
        columns.extend(self.values.iter_mut().map(|(kind, own)| array(*kind, &emptied(own))));
        columns.push(Arc::new(BooleanArray::from(emptied(&mut self.is_received))));
        columns.extend(self.start.iter_mut().flat_map(Times::take_batch));
        if let Some(group) = &mut self.group {
            columns.push(Arc::new(StringArray::from(emptied(group))));
        }
        RecordBatch::try_new(self.schema.clone(), columns).expect("columns as the schema has them")
    }
}

pub fn type_of(kind: ColumnKind) -> DataType {
    match kind {
        ColumnKind::Text => DataType::Utf8,
        ColumnKind::Flag => DataType::Boolean,
        ColumnKind::Whole => DataType::Int64,
        _ => DataType::Float64,
    }
}

/// A value that no frame had is null.
fn array(kind: ColumnKind, values: &[f64]) -> ArrayRef {
    let values = values.iter().map(|value| Some(*value).filter(|value| value.is_finite()));
    match kind {
        ColumnKind::Flag => Arc::new(values.map(|value| value.map(|value| value != 0.0)).collect::<BooleanArray>()),
        ColumnKind::Whole => Arc::new(values.map(|value| value.map(|value| value as i64)).collect::<Int64Array>()),
        _ => Arc::new(values.collect::<Float64Array>()),
    }
}
