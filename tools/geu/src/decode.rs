//! `geu decode`: recordings and live links to rows.

mod output;
pub mod stream;
pub mod table;
mod writer;

use clap::{ArgAction, Args, ValueEnum};
use geu_archive::{Columns, DeviceColumns, FileFormat, UnitColumns};
use geu_recording::{Decode, DecodeSummary, DeviceSample, InputError, InputReader, ReceivedSample};
use geu_report::rows::{DeviceRows, TextFormat, write_row};

use crate::command_error::{CommandError, note};
use crate::device::{DEFAULT_DEVICE, device};
use crate::input_args::{InputArgs, note_elsewhere};
use crate::output_writer::OutputWriter;
use crate::outputs::{OutputDirectory, OutputFile, persist};
use crate::settings::choice;
use output::NoRows;
pub use output::{ColumnPlace, ColumnRows, RowOutput, TextRows, verify_columns_place};
use writer::Writer;

/// Decodes recordings or live links to CSV, JSON lines, Parquet, Arrow or a summary.
#[derive(Args)]
pub struct Arguments {
    /// Recording, archive (Parquet of `geu decode`, a file or a directory), `-`, serial device, pty, CAN interface or HOST:PORT
    /// of `--tcp` (live); several are one stream, in order.
    #[arg(required = true, value_name = "INPUT")]
    inputs: Vec<String>,
    /// Output format.
    #[arg(long, value_enum, default_value_t = Format::Csv)]
    format: Format,
    /// Format of the flags.
    #[arg(long, default_value = "integers", action = ArgAction::Set, value_parser = choice(FLAGS))]
    flags: bool,
    /// Output file, instead of standard output. Until the end (for a live input also Ctrl-C) rows are written to
    /// FILE.….partial; FILE is the previous file or complete. A process that is killed leaves FILE.….partial,
    /// which is readable in CSV and JSON lines.
    #[arg(long, value_name = "FILE")]
    out: Option<OutputFile>,
    /// Directory of an archive, with --format parquet or arrow: the samples of each day are a file of their own,
    /// device=NAME/day=YYYY-MM-DD/HHMMSS.….parquet, named by its first sample.
    #[arg(long, value_name = "DIRECTORY", conflicts_with = "out")]
    partition: Option<OutputDirectory>,
    /// Replace files of the archive.
    #[arg(long, requires = "partition")]
    force: bool,
    /// Output file of the defects, one JSON object a line: place, kind, bytes; with a count for repetitions.
    /// The file is complete or absent.
    #[arg(long, value_name = "FILE")]
    defects: Option<OutputFile>,
    /// Exit with 1 if there were defects, or no sample.
    #[arg(long)]
    strict: bool,
    /// Name or description of another unit than the default one (`geu device list`).
    #[arg(long, alias = "gyro-csv", value_name = "NAME|FILE", conflicts_with_all = ["base", "flags"])]
    device: Option<String>,
    #[command(flatten)]
    reading: InputArgs,
    /// Do not print the summary to standard error.
    #[arg(long, short)]
    quiet: bool,
}

/// True: a column for each bit.
const FLAGS: &[(&str, bool, &str)] = &[
    ("integers", false, "As two integers"),
    ("bits", true, "Also each bit by its name, in the last columns: 0 or 1 in CSV, false or true in JSON"),
];

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Comma-separated values with a header.
    Csv,
    /// One JSON object a line.
    Jsonl,
    /// Parquet: columns with their units, a column of true and false for each flag.
    Parquet,
    /// Arrow IPC file (Feather 2), the same columns.
    Arrow,
    /// The summary alone.
    Summary,
}

/// Runs `geu decode`.
///
/// # Errors
/// An input cannot be read, an output cannot be written; with `--strict`, defects.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    arguments.verify_format()?;
    arguments.reading.verify(&arguments.inputs)?;
    let stop = arguments.reading.stop_at_signals(&arguments.inputs)?;
    match arguments.device.as_deref().filter(|name| *name != DEFAULT_DEVICE) {
        Some(name) => {
            let device = device(name)?;
            let reader = arguments.reading.device_reader(&device, stop)?;
            decode_to(arguments, reader, DeviceColumns::new(&device), |format| {
                let rows = DeviceRows::new(format, &device);
                (rows.header(), move |row: &DeviceSample, out: &mut Vec<u8>| rows.write(row, out))
            })
        }
        None => {
            let (with_bits, reader) = (arguments.flags, arguments.reading.reader(stop)?);
            decode_to(arguments, reader, UnitColumns::default(), |format| {
                let write = move |row: &ReceivedSample, out: &mut Vec<u8>| write_row(format, with_bits, row, out);
                (format.header(with_bits), write)
            })
        }
    }
}

/// Decodes the inputs to columns, to text with a header and a writer of rows, or to a summary alone.
fn decode_to<D, W>(
    arguments: &Arguments,
    reader: InputReader<D>,
    columns: impl Columns<Row = D::Row>,
    text: impl FnOnce(TextFormat) -> (String, W),
) -> Result<(), CommandError>
where
    D: Decode<Row: Clone + Send + 'static>,
    W: Fn(&D::Row, &mut Vec<u8>) + Send + Sync + 'static,
{
    match arguments.format.of_rows() {
        RowFormat::None => decode(arguments, reader, NoRows),
        RowFormat::Columns(format) => decode(arguments, reader, arguments.columns(format, columns)),
        RowFormat::Text(format) => {
            let (header, write) = text(format);
            decode(arguments, reader, TextRows::new(arguments.out.as_ref(), header, write))
        }
    }
}

/// Decodes the inputs to rows.
fn decode<D: Decode>(
    arguments: &Arguments,
    mut reader: InputReader<D>,
    rows: impl RowOutput<D::Row>,
) -> Result<(), CommandError> {
    let mut writer = Writer::new(arguments, rows);
    let (mut result, mut read): (Result<(), InputError>, _) = (Ok(()), 0);
    for input in &arguments.inputs {
        result = reader.read(input, &mut writer);
        if result.is_err() || writer.broken.is_some() || reader.is_stopped() {
            break;
        }
        read += 1;
    }
    let left_out = arguments.inputs.get(read + 1..).filter(|left_out| !left_out.is_empty() && reader.is_stopped());
    let (summary, ending) = reader.finish(&mut writer);
    let result = result.and(ending);
    let is_refused = is_refused(&result, &summary, read);
    if !is_refused {
        writer.write_out();
    }
    if let Some(failure) = writer.broken.take() {
        return Err(failure);
    }
    let mut outputs = Vec::new();
    if arguments.format == Format::Summary && writer.is_open && !is_refused {
        let mut out = OutputWriter::open(arguments.out.as_ref())?;
        out.buffer = summary.to_string().into_bytes();
        outputs.push(out.complete()?);
    }
    if gives_rows(&result) {
        outputs.extend(writer.finish()?);
        persist(outputs)?;
    }
    if arguments.format != Format::Summary && !arguments.quiet && summary.account.records + summary.account.bytes > 0 {
        note(format_args!("{summary}"));
    }
    note_elsewhere(&summary);
    if let Some(left_out) = left_out {
        note(format_args!("geu: not read before the end: {}\n", left_out.join(", ")));
    }
    result?;
    arguments.reading.note_no_rows(&summary);
    arguments.check_strict(&summary)
}

/// A format of rows.
enum RowFormat {
    Text(TextFormat),
    Columns(FileFormat),
    None,
}

impl Format {
    fn of_rows(self) -> RowFormat {
        match self {
            Format::Csv => RowFormat::Text(TextFormat::Csv),
            Format::Jsonl => RowFormat::Text(TextFormat::Jsonl),
            Format::Parquet => RowFormat::Columns(FileFormat::Parquet),
            Format::Arrow => RowFormat::Columns(FileFormat::Arrow),
            Format::Summary => RowFormat::None,
        }
    }
}

impl Arguments {
    /// Refuses options that a format of rows does not have.
    fn verify_format(&self) -> Result<(), CommandError> {
        let is_columns = matches!(self.format.of_rows(), RowFormat::Columns(_));
        if self.partition.is_some() && !is_columns {
            return Err(CommandError::input("--partition: expected --format parquet or arrow"));
        }
        if self.flags && is_columns {
            return Err(CommandError::input(
                "--flags: expected none: each flag is a column of true and false in Parquet and Arrow",
            ));
        }
        if is_columns && self.partition.is_none() { verify_columns_place(self.out.as_ref()) } else { Ok(()) }
    }

    fn columns<C: Columns>(&self, format: FileFormat, columns: C) -> ColumnRows<'_, C> {
        let place = match &self.partition {
            Some(directory) => ColumnPlace::Partition(directory, self.force),
            None => ColumnPlace::File(self.out.as_ref()),
        };
        ColumnRows::new(columns, format, place)
    }

    fn check_strict(&self, summary: &DecodeSummary) -> Result<(), CommandError> {
        match summary.account.defect_count() {
            0 if self.strict && summary.rows == 0 => Err(CommandError::failed("--strict: no sample")),
            defects if self.strict && defects > 0 => Err(CommandError::failed(format!("--strict: {defects} defects"))),
            _ => Ok(()),
        }
    }
}

/// True if the rows read before this end are a result, also of a broken recording or a closed link.
pub fn gives_rows(read: &Result<(), InputError>) -> bool {
    use InputError::{Container, Cut, EndedEarly, Read};
    matches!(read, Ok(()) | Err(Read { .. } | Container { .. } | Cut { .. } | EndedEarly { rows: 1.., .. }))
}

/// True if the first input was refused, so that nothing is written, not even a header. `read` inputs were read to their end;
/// serial bytes without any frame are refused after that.
pub fn is_refused(result: &Result<(), InputError>, summary: &DecodeSummary, read: usize) -> bool {
    let is_first = read == 0 || matches!(result, Err(InputError::NoFrame { .. }));
    !gives_rows(result) && is_first && summary.rows == 0
}
