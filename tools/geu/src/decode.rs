//! `geu decode`: recordings and live links to rows.

use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use geu_protocol::CanPlan;
use geu_protocol::capture::Format as InputFormat;
use geu_recording::{Defect, InputError, InputReader, Options, Row, Sink, Stop, Summary};

use crate::defects::DefectLines;
use crate::failure::{Failure, note};
use crate::gyro_csv;
use crate::overwriting::refuse_overwriting;
use crate::rows::{Flags, Form, write_row};
use crate::settings::{LONGEST_S, can_base, duration};

/// Arguments of `geu decode`.
#[derive(Args)]
pub struct Arguments {
    /// Recording, `-`, serial device, pty, or CAN interface (live); several are one stream, in order.
    #[arg(required = true, value_name = "INPUT")]
    inputs: Vec<String>,
    /// What to write.
    #[arg(long, value_enum, default_value_t = Format::Csv)]
    format: Format,
    /// How to write the flags.
    #[arg(long, value_enum, default_value_t, conflicts_with = "gyro_csv")]
    flags: Flags,
    /// Where to write it, instead of standard output.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Where to write the defects, one JSON object a line: place, kind, bytes; with a count where the same comes again.
    #[arg(long, value_name = "FILE")]
    defects: Option<PathBuf>,
    /// Exit with 1 when there were defects.
    #[arg(long)]
    strict: bool,
    /// Reads one CSV of any gyros instead, as this file describes it: columns, units, interval (configs/suchai3.toml is one).
    #[arg(long, value_name = "DESCRIPTION", conflicts_with_all = ["base", "interface", "input_format", "baud", "duration"])]
    gyro_csv: Option<PathBuf>,
    #[command(flatten)]
    reading: Reading,
    /// Do not print the summary to standard error.
    #[arg(long, short)]
    quiet: bool,
}

/// How inputs are read. Every command that reads the unit's link takes these.
#[derive(Args)]
pub struct Reading {
    /// Base of the unit's CAN identifiers, hexadecimal.
    #[arg(long, value_name = "ID", value_parser = can_base)]
    base: Option<CanPlan>,
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

impl Reading {
    /// A reader with these options, which the first SIGINT or SIGTERM ends.
    pub fn reader(&self) -> InputReader<'static> {
        stop_on_signals();
        let options = Options {
            plan: self.base.unwrap_or_default(),
            interface: self.interface.clone(),
            format: self.input_format,
            baud: self.baud,
        };
        let deadline = self.duration.map(|duration_s| Instant::now() + Duration::from_secs_f64(duration_s));
        InputReader::new(options, Stop { flag: Some(&STOP), deadline })
    }
}

/// Says which interfaces carry the unit beside the one used.
pub fn note_elsewhere(summary: &Summary) {
    if !summary.elsewhere.is_empty() {
        let left_out = summary.elsewhere.iter().map(|(name, frames)| format!("{frames} on {name}"));
        let left_out = left_out.collect::<Vec<_>>().join(", ");
        let used = summary.interface.as_deref().unwrap_or("none");
        note(format_args!("geu: frames of the unit left out: {left_out} (used: {used}; --interface chooses)\n"));
    }
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

/// Set by the first SIGINT or SIGTERM; the second ends the process.
static STOP: AtomicBool = AtomicBool::new(false);

extern "C" fn stop(_signal: i32) {
    STOP.store(true, Ordering::Relaxed);
}

fn stop_on_signals() {
    use nix::sys::signal::{SaFlags, SigAction, SigHandler, SigSet, Signal, sigaction};
    let action = SigAction::new(SigHandler::Handler(stop), SaFlags::SA_RESETHAND, SigSet::empty());
    for signal in [Signal::SIGINT, Signal::SIGTERM] {
        // SAFETY: the handler only stores to an atomic.
        let _ = unsafe { sigaction(signal, &action) };
    }
}

/// Decodes.
pub fn run(arguments: Arguments) -> Result<(), Failure> {
    let outputs = [("--out", arguments.out.as_ref()), ("--defects", arguments.defects.as_ref())];
    refuse_overwriting(&outputs, &arguments.inputs.iter().map(String::as_str).collect::<Vec<_>>())?;
    if let Some(description) = &arguments.gyro_csv {
        return decode_gyro_csv(&arguments, description);
    }
    let mut writer = Writer::new(&arguments);
    let mut reader = arguments.reading.reader();
    let mut result: Result<(), InputError> = Ok(());
    for input in &arguments.inputs {
        result = reader.read(input, &mut writer);
        if result.is_err() || writer.is_closed() {
            break;
        }
    }
    let (summary, ending) = reader.finish(&mut writer);
    writer.flush();
    if let Some(failure) = writer.broken.take() {
        return Err(failure);
    }
    if arguments.format == Format::Summary {
        if writer.is_open {
            let mut out = Output::open(arguments.out.as_ref())?;
            out.buffer = summary.to_string().into_bytes();
            out.finish()?;
        }
    } else if !arguments.quiet && summary.account.records + summary.account.bytes > 0 {
        note(format_args!("{summary}"));
    }
    note_elsewhere(&summary);
    result.and(ending).map_err(Failure::input)?;
    let defects = summary.account.defect_count();
    match arguments.strict && defects > 0 {
        true => Err(Failure::failed(format!("--strict: {defects} defects"))),
        false => Ok(()),
    }
}

/// As [`run`], for a CSV of any gyros.
fn decode_gyro_csv(arguments: &Arguments, description: &Path) -> Result<(), Failure> {
    let [input] = &arguments.inputs[..] else {
        return Err(Failure::input(format!("--gyro-csv: expected one file, got {}", arguments.inputs.len())));
    };
    let read = gyro_csv::read(input, description)?;
    let account = read.account();
    if let Some(path) = &arguments.defects {
        let mut defects = Output::open(Some(path))?;
        gyro_csv::write_defects(input, &read, &mut defects.buffer);
        defects.finish()?;
    }
    let mut out = Output::open(arguments.out.as_ref())?;
    match arguments.format {
        Format::Csv => gyro_csv::write_csv(&read, &mut out.buffer),
        Format::Jsonl => gyro_csv::write_jsonl(&read, &mut out.buffer),
        Format::Summary => out.buffer.extend_from_slice(format!("input        {input}\n{account}").as_bytes()),
    }
    out.finish()?;
    if arguments.format != Format::Summary && !arguments.quiet {
        note(format_args!("{account}"));
    }
    match arguments.strict && !read.defects.is_empty() {
        true => Err(Failure::failed(format!("--strict: {} defects", read.defects.len()))),
        false => Ok(()),
    }
}

/// Bytes kept before they are written.
pub const BUFFER: usize = 1 << 18;

/// A file or standard output behind a large buffer.
pub struct Output {
    writer: Box<dyn Write>,
    /// What is to be written.
    pub buffer: Vec<u8>,
    form: Form,
}

impl Output {
    /// Opens a file, or standard output where none is named.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn open(path: Option<&PathBuf>) -> Result<Output, Failure> {
        let writer: Box<dyn Write> = match path {
            Some(path) => Box::new(
                File::create(path)
                    .map_err(|error| Failure::failed(format!("{}: cannot be written: {error}", path.display())))?,
            ),
            None => Box::new(io::stdout().lock()),
        };
        Ok(Output { writer, buffer: Vec::with_capacity(BUFFER + 1024), form: Form::Csv })
    }

    fn in_form(mut self, form: Form, flags: Flags) -> Output {
        self.form = form;
        self.buffer.extend_from_slice(form.header(flags).as_bytes());
        self
    }

    /// Writes all; whoever read and went away has seen enough.
    fn finish(mut self) -> Result<(), Failure> {
        self.flush().map_err(Failure::writing)
    }

    /// Writes what is in the buffer.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn flush(&mut self) -> io::Result<()> {
        self.writer.write_all(&self.buffer)?;
        self.buffer.clear();
        self.writer.flush()
    }
}

/// Writes rows and defects as they come.
struct Writer<'a> {
    arguments: &'a Arguments,
    /// Whether an input could be opened, and with it the outputs.
    is_open: bool,
    rows: Option<Output>,
    defects: Option<Output>,
    lines: DefectLines,
    /// Why nothing can be written any more.
    broken: Option<Failure>,
}

impl<'a> Writer<'a> {
    fn new(arguments: &'a Arguments) -> Writer<'a> {
        Writer { arguments, is_open: false, rows: None, defects: None, lines: DefectLines::default(), broken: None }
    }

    fn open(&mut self) -> Result<(), Failure> {
        self.rows = match self.arguments.format {
            Format::Summary => None,
            format => {
                let form = if format == Format::Jsonl { Form::Jsonl } else { Form::Csv };
                Some(Output::open(self.arguments.out.as_ref())?.in_form(form, self.arguments.flags))
            }
        };
        self.defects = self.arguments.defects.as_ref().map(|path| Output::open(Some(path))).transpose()?;
        Ok(())
    }

    #[cold]
    fn write_out(&mut self) {
        for output in [&mut self.rows, &mut self.defects].into_iter().flatten() {
            if let Err(error) = output.flush() {
                output.buffer.clear();
                self.broken.get_or_insert_with(|| Failure::writing(error));
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
    fn row(&mut self, row: &Row) {
        if let Some(output) = &mut self.defects {
            self.lines.end(&mut output.buffer);
        }
        if let Some(output) = &mut self.rows {
            write_row(output.form, self.arguments.flags, row, &mut output.buffer);
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
