//! The extension module `geu._geu`: the whole command, and `geu decode` as an Arrow stream.
//!
//! What else the package `geu` does starts the command as a process of its own, so that an interrupted or failed one leaves nothing
//! behind in Python.

use std::ffi::OsString;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;
use std::thread;
use std::time::Duration;

use arrow_array::cast::AsArray;
use arrow_array::ffi_stream::FFI_ArrowArrayStream;
use arrow_array::types::{Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, TimestampMicrosecondType};
use arrow_array::{Array, ArrayRef, RecordBatch, RecordBatchIterator};
use arrow_schema::ffi::FFI_ArrowSchema;
use arrow_schema::{DataType, SchemaRef};
use pyo3::IntoPyObjectExt;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::{PyCapsule, PyDict};

/// Decoded samples in memory; any number of consumers may take the stream, without a copy.
#[pyclass(frozen)]
struct Table {
    schema: SchemaRef,
    batches: Vec<RecordBatch>,
    #[pyo3(get)]
    summary: String,
    #[pyo3(get)]
    defects: String,
    #[pyo3(get)]
    broken: Option<String>,
}

#[pymethods]
impl Table {
    #[getter]
    fn rows(&self) -> usize {
        self.batches.iter().map(RecordBatch::num_rows).sum()
    }

    /// Name and unit of each column; the unit is empty for a column without one.
    #[getter]
    fn columns(&self) -> Vec<(String, String)> {
        let unit = |field: &arrow_schema::Field| field.metadata().get(geu::UNIT).cloned().unwrap_or_default();
        self.schema.fields().iter().map(|field| (field.name().clone(), unit(field))).collect()
    }

    #[getter]
    fn metadata(&self) -> std::collections::HashMap<String, String> {
        self.schema.metadata().clone().into()
    }

    fn __arrow_c_schema__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyCapsule>> {
        let schema = FFI_ArrowSchema::try_from(self.schema.as_ref())
            .map_err(|error| PyValueError::new_err(error.to_string()))?;
        PyCapsule::new_with_value(py, schema, c"arrow_schema")
    }

    /// The stream in its own schema; a consumer casts it to another one.
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        #[expect(unused_variables, reason = "the protocol has it")] requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        let batches: Vec<_> = self.batches.iter().cloned().map(Ok).collect();
        let stream = FFI_ArrowArrayStream::new(Box::new(RecordBatchIterator::new(batches, self.schema.clone())));
        PyCapsule::new_with_value(py, stream, c"arrow_array_stream")
    }
}

/// The exception of a command's error.
fn exception(py: Python<'_>, error: &geu::CommandError) -> PyErr {
    let exception = || py.import("geu.errors")?.getattr("error")?.call1((error.to_string(), error.code()));
    exception().map_or_else(|failure| failure, PyErr::from_value)
}

/// Decodes the serial bytes of a link as they arrive.
#[pyclass]
struct Decoder(geu::StreamDecoder);

#[pymethods]
impl Decoder {
    #[new]
    #[pyo3(signature = (device=None))]
    fn new(py: Python<'_>, device: Option<&str>) -> PyResult<Decoder> {
        geu::StreamDecoder::new(device).map(Decoder).map_err(|error| exception(py, &error))
    }

    /// Samples that these bytes complete, as dicts by the names of columns.
    fn feed<'py>(&mut self, py: Python<'py>, data: PyBackedBytes) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let batch = self.0.feed(&data);
        let row = |row: usize| {
            let sample = PyDict::new(py);
            for (field, column) in batch.schema_ref().fields().iter().zip(batch.columns()) {
                sample.set_item(field.name(), value(py, column, row)?)?;
            }
            Ok(sample)
        };
        (0..batch.num_rows()).map(row).collect()
    }

    #[getter]
    fn defects(&self) -> u64 {
        self.0.defects
    }
}

/// A value of a column; times in microseconds.
fn value<'py>(py: Python<'py>, column: &ArrayRef, row: usize) -> PyResult<Bound<'py, PyAny>> {
    if column.is_null(row) {
        return Ok(py.None().into_bound(py));
    }
    match column.data_type() {
        DataType::Boolean => column.as_boolean().value(row).into_bound_py_any(py),
        DataType::Float64 => column.as_primitive::<Float64Type>().value(row).into_bound_py_any(py),
        DataType::Int8 => column.as_primitive::<Int8Type>().value(row).into_bound_py_any(py),
        DataType::Int16 => column.as_primitive::<Int16Type>().value(row).into_bound_py_any(py),
        DataType::Int32 => column.as_primitive::<Int32Type>().value(row).into_bound_py_any(py),
        DataType::Int64 => column.as_primitive::<Int64Type>().value(row).into_bound_py_any(py),
        DataType::Utf8 => column.as_string::<i32>().value(row).into_bound_py_any(py),
        _ => column.as_primitive::<TimestampMicrosecondType>().value(row).into_bound_py_any(py),
    }
}

/// Longest delay of Ctrl-C.
const SIGNAL_INTERVAL: Duration = Duration::from_millis(50);

/// Decodes inputs with the arguments of `geu decode`.
#[pyfunction]
fn decode(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<Table> {
    let (mut signal, stop, caller) = (None, AtomicBool::new(false), thread::current());
    let decoded = py.detach(|| {
        thread::scope(|scope| {
            let work = scope.spawn(|| {
                let decoded = geu::decode_table(arguments, &stop);
                caller.unpark();
                decoded
            });
            while !work.is_finished() {
                thread::park_timeout(SIGNAL_INTERVAL);
                if signal.is_none() {
                    signal = Python::attach(|py| py.check_signals()).err();
                    stop.store(signal.is_some(), Relaxed);
                }
            }
            work.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })
    });
    if let Some(signal) = signal {
        return Err(signal);
    }
    match decoded {
        Ok(Some(table)) => Ok(Table {
            schema: table.schema,
            batches: table.batches,
            summary: table.summary,
            defects: table.defects,
            broken: table.broken,
        }),
        Ok(None) => Err(PyValueError::new_err("interrupted")),
        Err(error) => Err(exception(py, &error)),
    }
}

/// Runs the command with these arguments, the program's name first; returns its exit code. It writes to the process's standard output and
/// may end the process.
#[pyfunction]
fn command(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| geu::command(arguments))
}

#[pymodule]
fn _geu(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<Table>()?;
    module.add_class::<Decoder>()?;
    module.add_function(wrap_pyfunction!(decode, module)?)?;
    module.add_function(wrap_pyfunction!(command, module)?)
}
