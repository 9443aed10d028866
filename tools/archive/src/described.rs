//! Columns of a described unit.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::{ArrayRef, BooleanArray, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use geu_model::device::columns::{GROUP, IS_RECEIVED, NUMBER, START, TIME};
use geu_model::device::{Device, TableWire};
use geu_recording::DeviceSample;
use geu_recording::archive::{ColumnKind, DESCRIPTION, DEVICE};

use crate::{Columns, FILE, VERSION, booleans, field, time_columns, time_fields};

/// Columns of a described unit: time, number of the sample, its values by their names; start and trial if a table has them.
#[derive(Debug, Clone)]
pub struct DeviceColumns {
    schema: SchemaRef,
    interval_s: f64,
    kinds: Vec<ColumnKind>,
    has_start: bool,
    has_group: bool,
}

impl DeviceColumns {
    pub fn new(device: &Device) -> DeviceColumns {
        let has = |column: fn(&TableWire) -> bool| device.table.as_ref().is_some_and(column);
        let (has_start, has_group) = (has(|table| table.start.is_some()), has(|table| table.group.is_some()));
        let mut fields = time_fields(TIME).to_vec();
        fields.push(Field::new(NUMBER, DataType::Int64, false));
        let kinds: Vec<ColumnKind> =
            (0..device.values().len()).map(|slot| ColumnKind::of_value(device, slot)).collect();
        let values = device.values().iter().zip(&kinds);
        fields.extend(values.map(|(value, kind)| field(&value.name, type_of(*kind), value.unit, true)));
        fields.push(Field::new(IS_RECEIVED, DataType::Boolean, false));
        if has_start {
            fields.extend(time_fields(START));
        }
        if has_group {
            fields.push(Field::new(GROUP, DataType::Utf8, false));
        }
        let description = &device.description;
        let metadata =
            [(DEVICE, device.unit_name()), (DESCRIPTION, &description.text), (VERSION, env!("CARGO_PKG_VERSION"))];
        let metadata = metadata.map(|(key, value)| (key.to_owned(), value.to_owned()));
        let files = description.files.iter().map(|(name, text)| (format!("{FILE}{name}"), text.clone()));
        let metadata: HashMap<String, String> = metadata.into_iter().chain(files).collect();
        DeviceColumns {
            schema: Arc::new(Schema::new_with_metadata(fields, metadata)),
            interval_s: device.interval_s,
            kinds,
            has_start,
            has_group,
        }
    }
}

impl Columns for DeviceColumns {
    type Row = DeviceSample;

    fn schema(&self) -> SchemaRef {
        self.schema.clone()
    }

    fn batch(&self, rows: &[DeviceSample]) -> RecordBatch {
        let times = rows.iter().map(|row| Some(row.time_or_number(self.interval_s)));
        let mut columns: Vec<ArrayRef> = time_columns(times).to_vec();
        columns.push(Arc::new(Int64Array::from_iter_values(rows.iter().map(|row| row.number as i64))));
        let values = |slot: usize| rows.iter().map(move |row| row.values[slot]);
        columns.extend(self.kinds.iter().enumerate().map(|(slot, kind)| array(*kind, values(slot))));
        let is_received = rows.iter().map(|row| row.time.is_some().into()).collect::<Vec<u8>>();
        columns.push(Arc::new(BooleanArray::from(booleans(&is_received, 0))));
        if self.has_start {
            columns.extend(time_columns(rows.iter().map(|row| row.start)));
        }
        if self.has_group {
            columns.push(Arc::new(StringArray::from_iter_values(rows.iter().map(|row| &row.group))));
        }
        RecordBatch::try_new(self.schema(), columns).expect("columns as the schema has them")
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
fn array(kind: ColumnKind, values: impl Iterator<Item = f64>) -> ArrayRef {
    let values = values.map(|value| Some(value).filter(|value| value.is_finite()));
    match kind {
        ColumnKind::Flag => Arc::new(values.map(|value| value.map(|value| value != 0.0)).collect::<BooleanArray>()),
        ColumnKind::Whole => Arc::new(values.map(|value| value.map(|value| value as i64)).collect::<Int64Array>()),
        _ => Arc::new(values.collect::<Float64Array>()),
    }
}
