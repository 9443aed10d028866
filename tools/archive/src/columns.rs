//! Columns of the default unit.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::{ArrayRef, BooleanArray, Float64Array, Int16Array, Int32Array, Int64Array, RecordBatch};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use geu_model::device::DEFAULT_DEVICE;
use geu_model::device::columns::{IS_RECEIVED, TIME};
use geu_protocol::field::{
    Bit, ClockCount, Electronics, FIELDS, Field as _, GYRO_FLAGS, GyroFlags, Sensor, Sequence, UNIT_FLAGS, UnitFlags,
};
use geu_recording::ReceivedSample;
use geu_recording::archive::DEVICE;

use crate::{Columns, VERSION, booleans, field, nulls, time_columns, time_fields};

/// Columns of the default unit.
#[derive(Debug, Clone)]
pub struct UnitColumns(SchemaRef);

impl Default for UnitColumns {
    fn default() -> UnitColumns {
        UnitColumns(schema())
    }
}

fn schema() -> SchemaRef {
    let of = |spec: geu_protocol::field::FieldSpec, kind, is_nullable| field(spec.name, kind, spec.unit, is_nullable);
    let mut fields = time_fields(TIME).to_vec();
    fields.push(of(Sequence::SPEC, DataType::Int32, false));
    fields.push(of(ClockCount::SPEC, DataType::Int64, true));
    fields.extend(FIELDS[..4].iter().map(|spec| of(*spec, DataType::Int16, false)));
    fields.extend([GyroFlags::SPEC, UnitFlags::SPEC].map(|spec| of(spec, DataType::Int16, false)));
    let bits = [GYRO_FLAGS, UNIT_FLAGS].into_iter().flatten();
    fields.extend(bits.map(|bit| Field::new(bit.name, DataType::Boolean, false)));
    fields.push(of(Electronics::SPEC, DataType::Float64, false));
    fields.push(of(Sensor::SPEC, DataType::Float64, true));
    fields.push(Field::new(IS_RECEIVED, DataType::Boolean, false));
    let metadata = [(DEVICE, DEFAULT_DEVICE), (VERSION, env!("CARGO_PKG_VERSION"))];
    let metadata: HashMap<String, String> = metadata.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
    Arc::new(Schema::new_with_metadata(fields, metadata))
}

impl Columns for UnitColumns {
    type Row = ReceivedSample;

    fn schema(&self) -> SchemaRef {
        self.0.clone()
    }

    fn batch(&self, rows: &[ReceivedSample]) -> RecordBatch {
        let samples = || rows.iter().map(|row| &row.sample);
        let has_clock = nulls(rows.iter().map(|row| row.has_clock));
        let clock_count = samples().map(|sample| sample.clock_count as i64).collect::<Vec<i64>>();
        let flags = [
            samples().map(|sample| sample.gyro_flags).collect::<Vec<u8>>(),
            samples().map(|sample| sample.unit_flags).collect::<Vec<u8>>(),
        ];
        let is_received = rows.iter().map(|row| row.is_received.into()).collect::<Vec<u8>>();
        let electronics_c = samples().map(|sample| f64::from(sample.electronics_centi_c) / 100.0);
        let sensor_c = samples().map(|sample| f64::from(sample.sensor_centi_c) / 100.0).collect::<Vec<f64>>();
        let mut columns: Vec<ArrayRef> = time_columns(rows.iter().map(|row| row.time)).to_vec();
        columns.push(Arc::new(Int32Array::from_iter_values(samples().map(|sample| sample.sequence.into()))));
        columns.push(Arc::new(Int64Array::new(clock_count.into(), has_clock.clone())));
        columns.extend((0..4).map(|gyro| {
            Arc::new(Int16Array::from_iter_values(samples().map(|sample| sample.increments[gyro]))) as ArrayRef
        }));
        columns.extend(
            flags
                .iter()
                .map(|flags| Arc::new(Int16Array::from_iter_values(flags.iter().copied().map(i16::from))) as ArrayRef),
        );
        for (flags, bits) in flags.iter().zip([GYRO_FLAGS, UNIT_FLAGS]) {
            let column = |bit: &Bit| Arc::new(BooleanArray::from(booleans(flags, bit.bit))) as ArrayRef;
            columns.extend(bits.iter().map(column));
        }
        columns.push(Arc::new(Float64Array::from_iter_values(electronics_c)));
        columns.push(Arc::new(Float64Array::new(sensor_c.into(), has_clock)));
        columns.push(Arc::new(BooleanArray::from(booleans(&is_received, 0))));
        RecordBatch::try_new(self.schema(), columns).expect("columns as the schema has them")
    }
}
