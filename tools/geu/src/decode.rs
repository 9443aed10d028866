//! `geu decode`: recordings and live links to rows.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use geu_files::interruption::stop_flag;
use geu_protocol::CanIdMap;
use geu_protocol::capture::Format as InputFormat;
use geu_recording::{
    DecodeSummary, DecoderOptions, Defect, InputError, InputReader, ReceivedSample, Sink, Stop, is_live,
};
use geu_report::rows::{DefectLines, TextFormat, write_row};

use crate::failure::{CommandError, note};
use crate::gyro_csv;
use crate::outputs::OutputFile;
use crate::settings::{LONGEST_S, can_base, duration};

/// Arguments of `geu decode`.
#[derive(Args)]
pub struct Arguments {
    /// Recording, `-`, serial device, pty, CAN interface or HOST:PORT of `--tcp` (live); several are one stream, in order.
    #[arg(required = true, value_name = "INPUT")]
    inputs: Vec<String>,
    /// What to write.
    #[arg(long, value_enum, default_value_t = Format::Csv)]
    format: Format,
    /// How to write the flags.
    #[arg(long, value_enum, default_value_t, conflicts_with = "gyro_csv")]
    flags: Flags,
    /// Where to write it, instead of standard output. Until the end, which Ctrl-C is too of a live input, rows stand beside
    /// it in FILE.….partial; FILE is what was there before or whole. A process that is killed leaves the rows so far there.
    #[arg(long, value_name = "FILE")]
    out: Option<OutputFile>,
    /// Where to write the defects, one JSON object a line: place, kind, bytes; with a count where the same comes again.
    /// As --out, whole or not at all.
    #[arg(long, value_name = "FILE")]
    defects: Option<OutputFile>,
    /// Exit with 1 when there were defects.
    #[arg(long)]
    strict: bool,
    /// Reads one CSV of any gyros instead, as this file describes it: columns, units, interval (configs/suchai3.toml is one).
    #[arg(long, value_name = "DESCRIPTION", conflicts_with_all = ["base", "interface", "input_format", "baud", "duration"])]
    gyro_csv: Option<PathBuf>,
    #[command(flatten)]
    reading: InputArgs,
    /// Do not print the summary to standard error.
    #[arg(long, short)]
    quiet: bool,
}

/// How inputs are read. Every command that reads the unit's link takes these.
#[derive(Args)]
pub struct InputArgs {
    /// Base of the unit's CAN identifiers, hexadecimal.
    #[arg(long, value_name = "ID", value_parser = can_base)]
    base: Option<CanIdMap>,
    /// The interface wanted, where several in a capture carry the unit (otherwise the first that does).
    #[arg(long, value_name = "NAME")]
    interface: Option<String>,
    /// Format of the inputs, instead of telling it from their content.
    #[arg(long, value_name = "FORMAT", value_parser = input_format)]
    input_format: Option<InputFormat>,
    /// Rate of serial devices.
    #[arg(long, value_name = "BAUD")]
    baud: Option<u32>,
    /// Stop after so long.
    #[arg(long, value_name = "DURATION", allow_negative_numbers = true, value_parser = duration(0.0, LONGEST_S))]
    duration: Option<f64>,
}

impl InputArgs {
    /// A reader with these options. The first SIGINT, SIGTERM or SIGHUP ends it well where one of the inputs is live, of
    /// which the rest cannot be read again; of recorded files it ends the process.
    ///
    /// # Errors
    /// When signals cannot be watched.
    pub fn reader(&self, inputs: &[String]) -> Result<InputReader<'static>, CommandError> {
        let stop = inputs.iter().any(|input| is_live(input)).then(stop_flag).transpose();
        let stop = stop.map_err(|error| CommandError::failed(format!("signals cannot be watched: {error}")))?;
        let options = DecoderOptions {
            plan: self.base.unwrap_or_default(),
            interface: self.interface.clone(),
            format: self.input_format,
            baud: self.baud,
        };
        let deadline = self.duration.map(|duration_s| Instant::now() + Duration::from_secs_f64(duration_s));
        Ok(InputReader::new(options, Stop { flag: stop, deadline }))
    }

    /// Says why no row came.
    pub fn note_no_rows(&self, summary: &DecodeSummary) {
        if let Some(reason) = geu_recording::no_rows_reason(summary, self.base.unwrap_or_default(), self.input_format) {
            note(format_args!("geu: {reason}\n"));
        }
    }
}

/// Says which interfaces carry the unit beside the one used.
pub fn note_elsewhere(summary: &DecodeSummary) {
    if !summary.elsewhere.is_empty() {
        let left_out = summary.elsewhere.iter().map(|(name, frames)| format!("{frames} on {name}"));
        let left_out = left_out.collect::<Vec<_>>().join(", ");
        let used = summary.interface.as_deref().unwrap_or("none");
        note(format_args!("geu: frames of the unit left out: {left_out} (used: {used}; --interface chooses)\n"));
    }
}

/// How flags are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
enum Flags {
    /// As two integers
    #[default]
    Integers,
    /// And after all else each bit by its name: 0 or 1 in CSV, false or true in JSON
    Bits,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Comma-separated values with a header.
    Csv,
    /// One JSON object a line.
    Jsonl,
    /// The summary alone.
    Summary,
}

pub fn input_format(text: &str) -> Result<InputFormat, String> {
    InputFormat::named(text).ok_or_else(|| {
        let names = InputFormat::NAMED.map(|(name, _)| name);
        format!("expected one of {}, got {text}", names.join(", "))
    })
}

/// Decodes.
pub fn run(arguments: Arguments) -> Result<(), CommandError> {
    if let Some(description) = &arguments.gyro_csv {
        return decode_gyro_csv(&arguments, description);
    }
    let mut writer = Writer::new(&arguments);
    let mut reader = arguments.reading.reader(&arguments.inputs)?;
    let (mut result, mut read): (Result<(), InputError>, _) = (Ok(()), 0);
    for input in &arguments.inputs {
        result = reader.read(input, &mut writer);
        if result.is_err() || writer.is_closed() || reader.is_stopped() {
            break;
        }
        read += 1;
    }
    let (summary, ending) = reader.finish(&mut writer);
    let result = result.and(ending);
    let is_refused = is_refused(&result, &summary, read);
    if !is_refused {
        writer.flush();
    }
    if let Some(failure) = writer.broken.take() {
        return Err(failure);
    }
    if arguments.format == Format::Summary && writer.is_open && !is_refused {
        let mut out = OutputWriter::open(arguments.out.as_ref())?;
        out.buffer = summary.to_string().into_bytes();
        out.flush()?;
        writer.rows = Some(out);
    }
    if gives_rows(&result) {
        OutputWriter::finish([writer.rows.take(), writer.defects.take()].into_iter().flatten())?;
    }
    if arguments.format != Format::Summary && !arguments.quiet && summary.account.records + summary.account.bytes > 0 {
        note(format_args!("{summary}"));
    }
    note_elsewhere(&summary);
    result?;
    arguments.reading.note_no_rows(&summary);
    let defects = summary.account.defect_count();
    match arguments.strict && defects > 0 {
        true => Err(CommandError::failed(format!("--strict: {defects} defects"))),
        false => Ok(()),
    }
}

/// As [`run`], for a CSV of any gyros.
fn decode_gyro_csv(arguments: &Arguments, description: &Path) -> Result<(), CommandError> {
    let [input] = &arguments.inputs[..] else {
        return Err(CommandError::input(format!("--gyro-csv: expected one file, got {}", arguments.inputs.len())));
    };
    let read = gyro_csv::read(input, description)?;
    let account = read.account();
    let mut defects = arguments.defects.as_ref().map(|file| OutputWriter::open(Some(file))).transpose()?;
    if let Some(defects) = &mut defects {
        gyro_csv::write_defects(input, &read, &mut defects.buffer);
    }
    let mut out = OutputWriter::open(arguments.out.as_ref())?;
    match arguments.format {
        Format::Csv => gyro_csv::write_csv(&read, &mut out.buffer),
        Format::Jsonl => gyro_csv::write_jsonl(&read, &mut out.buffer),
        Format::Summary => out.buffer.extend_from_slice(format!("input        {input}\n{account}").as_bytes()),
    }
    OutputWriter::finish(defects.into_iter().chain([out]))?;
    if arguments.format != Format::Summary && !arguments.quiet {
        note(format_args!("{account}"));
    }
    match arguments.strict && !read.defects.is_empty() {
        true => Err(CommandError::failed(format!("--strict: {} defects", read.defects.len()))),
        false => Ok(()),
    }
}

/// Bytes kept before they are written.
pub const BUFFER: usize = 1 << 18;

/// A file or standard output behind a large buffer.
pub struct OutputWriter {
    /// None is standard output.
    file: Option<OutputFile>,
    writer: geu_files::Output,
    /// What is to be written.
    pub buffer: Vec<u8>,
    form: TextFormat,
}

impl OutputWriter {
    /// Opens a file, or standard output where none is named.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn open(file: Option<&OutputFile>) -> Result<OutputWriter, CommandError> {
        let writer = match file {
            Some(file) => file.create()?,
            None => geu_files::Output::create(Path::new("-")).map_err(CommandError::writing)?,
        };
        Ok(OutputWriter {
            file: file.cloned(),
            writer,
            buffer: Vec::with_capacity(BUFFER + 1024),
            form: TextFormat::Csv,
        })
    }

    fn in_form(mut self, form: TextFormat, with_bits: bool) -> OutputWriter {
        self.form = form;
        self.buffer.extend_from_slice(form.header(with_bits).as_bytes());
        self
    }

    /// Writes what is in the buffer.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn flush(&mut self) -> Result<(), CommandError> {
        let written = self.writer.write_all(&self.buffer).and_then(|()| self.writer.flush());
        self.buffer.clear();
        written.map_err(|error| match &self.file {
            Some(file) => file.unwritten(error),
            None => CommandError::writing(error),
        })
    }

    /// Writes all and puts each in its place; whoever read and went away has seen enough.
    ///
    /// # Errors
    /// When one cannot be written; then each leaves what was there.
    pub fn finish(outputs: impl IntoIterator<Item = OutputWriter>) -> Result<(), CommandError> {
        let flush = |mut output: OutputWriter| output.flush().map(|()| output.writer);
        let written = outputs.into_iter().map(flush).collect::<Result<Vec<_>, CommandError>>()?;
        geu_files::persist_all(written).map_err(CommandError::writing)
    }
}

/// Whether what was read until then is a result: a broken recording or a link that went away gives its rows.
pub fn gives_rows(read: &Result<(), InputError>) -> bool {
    use InputError::{Container, Cut, Read};
    matches!(read, Ok(()) | Err(Read { .. } | Container { .. } | Cut { .. }))
}

/// Whether the first input was refused, so that there is nothing to be written, no header either. `read` were read to their end;
/// serial bytes are refused after that where none of them is of a frame.
pub fn is_refused(result: &Result<(), InputError>, summary: &DecodeSummary, read: usize) -> bool {
    let is_first = read == 0 || matches!(result, Err(InputError::NoFrame { .. }));
    !gives_rows(result) && is_first && summary.rows == 0
}

/// Writes rows and defects as they come.
struct Writer<'a> {
    arguments: &'a Arguments,
    /// Whether an input could be opened, and with it the outputs.
    is_open: bool,
    rows: Option<OutputWriter>,
    defects: Option<OutputWriter>,
    lines: DefectLines,
    /// Why nothing can be written any more.
    broken: Option<CommandError>,
}

impl<'a> Writer<'a> {
    fn new(arguments: &'a Arguments) -> Writer<'a> {
        Writer { arguments, is_open: false, rows: None, defects: None, lines: DefectLines::default(), broken: None }
    }

    fn open(&mut self) -> Result<(), CommandError> {
        self.rows = match self.arguments.format {
            Format::Summary => None,
            format => {
                let form = if format == Format::Jsonl { TextFormat::Jsonl } else { TextFormat::Csv };
                Some(
                    OutputWriter::open(self.arguments.out.as_ref())?.in_form(form, self.arguments.flags == Flags::Bits),
                )
            }
        };
        self.defects = self.arguments.defects.as_ref().map(|path| OutputWriter::open(Some(path))).transpose()?;
        Ok(())
    }

    #[cold]
    fn write_out(&mut self) {
        for output in [&mut self.rows, &mut self.defects].into_iter().flatten() {
            if let Err(failure) = output.flush() {
                self.broken.get_or_insert(failure);
            }
        }
    }
}

impl Sink for Writer<'_> {
    fn opened(&mut self) {
        if !self.is_open {
            self.is_open = true;
            self.broken = self.open().err();
        }
    }

    #[inline]
    fn row(&mut self, row: &ReceivedSample) {
        if let Some(output) = &mut self.defects {
            self.lines.end(&mut output.buffer);
        }
        if let Some(output) = &mut self.rows {
            write_row(output.form, self.arguments.flags == Flags::Bits, row, &mut output.buffer);
            if output.buffer.len() >= BUFFER {
                self.write_out();
            }
        }
    }

    fn defect(&mut self, defect: &Defect) {
        if let Some(output) = &mut self.defects {
            self.lines.push(defect, &mut output.buffer);
            if output.buffer.len() >= BUFFER {
                self.write_out();
            }
        }
    }

    fn flush(&mut self) {
        if let Some(output) = &mut self.defects {
            self.lines.end(&mut output.buffer);
        }
        self.write_out();
    }

    fn is_closed(&self) -> bool {
        self.broken.is_some()
    }
}
