//! `geu decode` in memory: Arrow batches, for programs.

use std::ffi::OsString;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;

use clap::{Args, FromArgMatches};
use geu_archive::{Columns, DeviceColumns, RecordBatch, SchemaRef, UnitColumns};
use geu_recording::{Decode, Defect, InputReader, Sink};
use geu_report::rows::DefectLines;

use super::{Arguments, BATCH_ROWS, gives_rows};
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
    let until = arguments.reading.stop(Some(stop));
    match arguments.device.as_deref().filter(|name| *name != DEFAULT_DEVICE) {
        None => table(&arguments, arguments.reading.reader(until)?, UnitColumns::default(), stop),
        Some(name) => {
            let device = device(name)?;
            table(&arguments, arguments.reading.device_reader(&device, until)?, DeviceColumns::new(&device), stop)
        }
    }
}

fn table<D: Decode, C: Columns<Row = D::Row>>(
    arguments: &Arguments,
    mut reader: InputReader<'_, D>,
    columns: C,
    stop: &AtomicBool,
) -> Result<Option<DecodedTable>, CommandError> {
    let mut batches =
        Batches { columns, batches: Vec::new(), lines: DefectLines::default(), defects: Vec::new(), stop };
    let mut result = Ok(());
    for input in &arguments.inputs {
        result = reader.read(input, &mut batches);
        if result.is_err() || reader.is_stopped() {
            break;
        }
    }
    let (summary, ending) = reader.finish(&mut batches);
    if batches.is_closed() {
        return Ok(None);
    }
    let result = result.and(ending);
    if let Err(error) = &result
        && !gives_rows(&result)
    {
        return Err(CommandError::input(error));
    }
    batches.end_batch();
    batches.lines.end(&mut batches.defects);
    arguments.check_strict(summary.account.defect_count())?;
    Ok(Some(DecodedTable {
        schema: batches.columns.schema(),
        batches: batches.batches,
        summary: summary.to_string(),
        defects: String::from_utf8_lossy(&batches.defects).into_owned(),
        broken: result.err().map(|error| error.to_string()),
    }))
}

/// Collects batches and defects.
struct Batches<'a, C> {
    columns: C,
    batches: Vec<RecordBatch>,
    lines: DefectLines,
    defects: Vec<u8>,
    stop: &'a AtomicBool,
}

impl<C: Columns> Batches<'_, C> {
    #[cold]
    fn end_batch(&mut self) {
        if !self.columns.is_empty() {
            self.batches.push(self.columns.take_batch());
        }
    }
}

impl<C: Columns> Sink<C::Row> for Batches<'_, C> {
    #[inline]
    fn row(&mut self, row: &C::Row) {
        self.lines.end(&mut self.defects);
        self.columns.push(row);
        if self.columns.len() >= BATCH_ROWS {
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
