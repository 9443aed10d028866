//! Columns of the default unit.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::{ArrayRef, BooleanArray, Float64Array, Int16Array, Int32Array, Int64Array, RecordBatch};
use arrow_buffer::BooleanBuffer;
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use geu_model::device::DEFAULT_DEVICE;
use geu_model::device::columns::{IS_RECEIVED, TIME};
use geu_protocol::field::{
    Bit, ClockCount, Electronics, FIELDS, Field as _, GYRO_FLAGS, GyroFlags, Sensor, Sequence, UNIT_FLAGS, UnitFlags,
};
use geu_recording::ReceivedSample;
use geu_recording::archive::DEVICE;

use crate::{Times, VERSION, emptied, field, nulls};

/// Samples of a unit, collected as columns.
pub trait Columns {
    type Row;

    /// Names, types and units of the columns; the unit in the metadata.
    fn schema(&self) -> SchemaRef;

    fn push(&mut self, row: &Self::Row);

    /// Rows since the last batch.
    fn len(&self) -> usize;

    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The rows since the last batch.
    fn take_batch(&mut self) -> RecordBatch;
}

/// Columns of the default unit.
#[derive(Debug)]
pub struct UnitColumns {
    schema: SchemaRef,
    times: Times,
    sequence: Vec<i32>,
    clock_count: Vec<i64>,
    increments: [Vec<i16>; 4],
    gyro_flags: Vec<u8>,
    unit_flags: Vec<u8>,
    electronics_c: Vec<f64>,
    sensor_c: Vec<f64>,
    has_clock: Vec<bool>,
    is_received: Vec<bool>,
}

impl Default for UnitColumns {
    fn default() -> UnitColumns {
        UnitColumns {
            schema: schema(),
            times: Times::default(),
            sequence: Vec::new(),
            clock_count: Vec::new(),
            increments: Default::default(),
            gyro_flags: Vec::new(),
            unit_flags: Vec::new(),
            electronics_c: Vec::new(),
            sensor_c: Vec::new(),
            has_clock: Vec::new(),
            is_received: Vec::new(),
        }
    }
}

fn schema() -> SchemaRef {
    let of = |spec: geu_protocol::field::FieldSpec, kind, is_nullable| field(spec.name, kind, spec.unit, is_nullable);
    let mut fields = Times::fields(TIME).to_vec();
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
        self.schema.clone()
    }

    #[inline]
    fn push(&mut self, row: &ReceivedSample) {
        let sample = &row.sample;
        self.times.push(row.time);
        self.sequence.push(sample.sequence.into());
        self.clock_count.push(sample.clock_count as i64);
        for (column, increment) in self.increments.iter_mut().zip(sample.increments) {
            column.push(increment);
        }
        self.gyro_flags.push(sample.gyro_flags);
        self.unit_flags.push(sample.unit_flags);
        self.electronics_c.push(f64::from(sample.electronics_centi_c) / 100.0);
        self.sensor_c.push(f64::from(sample.sensor_centi_c) / 100.0);
        self.has_clock.push(row.has_clock);
        self.is_received.push(row.is_received);
    }

    fn len(&self) -> usize {
        self.sequence.len()
    }

    fn take_batch(&mut self) -> RecordBatch {
        let has_clock = nulls(&mut self.has_clock);
        let mut columns: Vec<ArrayRef> = self.times.take_batch().to_vec();
        columns.push(Arc::new(Int32Array::from(emptied(&mut self.sequence))));
        columns.push(Arc::new(Int64Array::new(emptied(&mut self.clock_count).into(), has_clock.clone())));
        columns.extend(self.increments.iter_mut().map(|own| Arc::new(Int16Array::from(emptied(own))) as ArrayRef));
        let words = [&mut self.gyro_flags, &mut self.unit_flags].map(emptied);
        columns.extend(
            words
                .each_ref()
                .map(|word| Arc::new(word.iter().map(|own| i16::from(*own)).collect::<Int16Array>()) as ArrayRef),
        );
        for (flags, bits) in words.iter().zip([GYRO_FLAGS, UNIT_FLAGS]) {
            columns.extend(bits.iter().map(|bit| is_set(flags, bit)));
        }
        columns.push(Arc::new(Float64Array::from(emptied(&mut self.electronics_c))));
        columns.push(Arc::new(Float64Array::new(emptied(&mut self.sensor_c).into(), has_clock)));
        columns.push(Arc::new(BooleanArray::from(emptied(&mut self.is_received))));
        RecordBatch::try_new(self.schema.clone(), columns).expect("columns as the schema has them")
    }
}

fn is_set(flags: &[u8], bit: &Bit) -> ArrayRef {
    let values = BooleanBuffer::collect_bool(flags.len(), |row| flags[row] >> bit.bit & 1 == 1);
    Arc::new(BooleanArray::new(values, None))
}
