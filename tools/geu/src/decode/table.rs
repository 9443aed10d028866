//! `geu decode` in memory: Arrow batches, for programs.

use std::ffi::OsString;
use std::mem;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;

use clap::{Args, FromArgMatches};
use geu_archive::{Columns, DeviceColumns, RecordBatch, SchemaRef, UnitColumns};
use geu_recording::{Decode, Defect, InputReader, Ordered, Sink, pool};
use geu_report::rows::DefectLines;

use super::{Arguments, gives_rows};
use crate::command_error::CommandError;
use crate::device::{DEFAULT_DEVICE, device};

/// Rows of decoded inputs.
pub struct DecodedTable {
    pub schema: SchemaRef,
    pub batches: Vec<RecordBatch>,
    /// Account of records, samples and defects, in words.
    pub summary: String,
    /// One JSON object a line, as `--defects` writes.
    pub defects: String,
    /// Reason why the rows end before the inputs do: a broken container, a link that failed.
    pub broken: Option<String>,
}

/// Decodes inputs with the arguments of `geu decode`; options of outputs have no effect. `stop`, set by another thread,
/// interrupts it.
///
/// # Errors
/// Arguments that are not valid, an input that cannot be read; `None` if interrupted.
pub fn decode_table(
    arguments: impl IntoIterator<Item = OsString>,
    stop: &AtomicBool,
) -> Result<Option<DecodedTable>, CommandError> {
    let command = Arguments::augment_args(clap::Command::new("decode").no_binary_name(true).disable_help_flag(true));
    let arguments = command.try_get_matches_from(arguments).and_then(|matches| Arguments::from_arg_matches(&matches));
    let arguments = arguments.map_err(|error| {
        let text = error.render().to_string();
        let first = text.split("\n\n").next().unwrap_or_default();
        CommandError::input(first.trim_start_matches("error: ").split_whitespace().collect::<Vec<_>>().join(" "))
    })?;
    arguments.reading.verify(&arguments.inputs)?;
    let until = arguments.reading.stop(Some(stop));
    match arguments.device.as_deref().filter(|name| *name != DEFAULT_DEVICE) {
        None => table(&arguments, arguments.reading.reader(until)?, UnitColumns::default(), stop),
        Some(name) => {
            let device = device(name)?;
            table(&arguments, arguments.reading.device_reader(&device, until)?, DeviceColumns::new(&device), stop)
        }
    }
}

fn table<D, C>(
    arguments: &Arguments,
    mut reader: InputReader<'_, D>,
    columns: C,
    stop: &AtomicBool,
) -> Result<Option<DecodedTable>, CommandError>
where
    D: Decode<Row: Send + 'static>,
    C: Columns<Row = D::Row>,
{
    let mut table = Table {
        columns,
        rows: Vec::new(),
        made: pool().map(Ordered::new),
        spare: Vec::new(),
        batches: Vec::new(),
        lines: DefectLines::default(),
        defects: Vec::new(),
        stop,
    };
    let mut result = Ok(());
    for input in &arguments.inputs {
        result = reader.read(input, &mut table);
        if result.is_err() || reader.is_stopped() {
            break;
        }
    }
    let (summary, ending) = reader.finish(&mut table);
    if table.is_closed() {
        return Ok(None);
    }
    let result = result.and(ending);
    if let Err(error) = &result
        && !gives_rows(&result)
    {
        return Err(CommandError::input(error));
    }
    table.end_batches();
    table.lines.end(&mut table.defects);
    arguments.check_strict(&summary)?;
    Ok(Some(DecodedTable {
        schema: table.columns.schema(),
        batches: table.batches,
        summary: summary.to_string(),
        defects: String::from_utf8_lossy(&table.defects).into_owned(),
        broken: result.err().map(|error| error.to_string()),
    }))
}

/// Rows of a batch, which stay in a core's cache until they are columns.
const BATCH_ROWS: usize = 1 << 14;

/// Collects batches and defects.
struct Table<'a, C: Columns> {
    columns: C,
    /// Rows until now, up to a batch.
    rows: Vec<C::Row>,
    /// Batches that other threads make, with the vectors of their rows; `None`: this thread makes them.
    made: Option<Ordered<(RecordBatch, Vec<C::Row>)>>,
    spare: Vec<Vec<C::Row>>,
    batches: Vec<RecordBatch>,
    lines: DefectLines,
    defects: Vec<u8>,
    stop: &'a AtomicBool,
}

impl<C: Columns> Table<'_, C> {
    #[cold]
    fn end_batch(&mut self) {
        let Some(made) = &mut self.made else {
            self.batches.push(self.columns.batch(&self.rows));
            return self.rows.clear();
        };
        let (columns, next) = (self.columns.clone(), self.spare.pop().unwrap_or_default());
        let mut rows = mem::replace(&mut self.rows, next);
        made.start(move || {
            let batch = columns.batch(&rows);
            rows.clear();
            (batch, rows)
        });
        while self.made.as_ref().is_some_and(Ordered::is_full) {
            self.take_batch();
        }
    }

    fn end_batches(&mut self) {
        if !self.rows.is_empty() {
            self.end_batch();
        }
        while self.take_batch() {}
    }

    /// Waits for a batch; false if there is none.
    fn take_batch(&mut self) -> bool {
        let Some((batch, rows)) = self.made.as_mut().and_then(Ordered::wait) else { return false };
        self.batches.push(batch);
        self.spare.push(rows);
        true
    }
}

impl<C: Columns> Sink<C::Row> for Table<'_, C> {
    #[inline]
    fn row(&mut self, row: &C::Row) {
        self.lines.end(&mut self.defects);
        self.rows.push(row.clone());
        if self.rows.len() >= BATCH_ROWS {
            self.end_batch();
        }
    }

    fn defect(&mut self, defect: &Defect) {
        self.lines.push(defect, &mut self.defects);
    }

    fn is_closed(&self) -> bool {
        self.stop.load(Relaxed)
    }
}
