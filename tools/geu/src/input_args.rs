//! Options of commands that read a link, and notes on what was read.

use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use geu_files::interruption::stop_flag;
use geu_model::device::Device;
use geu_protocol::CanIdMap;
use geu_protocol::capture::Format as InputFormat;
use geu_recording::{
    DecodeSummary, DecoderOptions, DeviceDecoder, InputReader, Stop, is_live, is_recording, verify_exists,
};

use crate::command_error::{CommandError, note};
use crate::settings::{LONGEST_S, can_base, duration};
use crate::time_range::RangeArgs;

/// Options of commands that read the unit's link.
#[derive(Args)]
pub struct InputArgs {
    /// Base of the unit's CAN identifiers, hexadecimal.
    #[arg(long, value_name = "ID", value_parser = can_base)]
    base: Option<CanIdMap>,
    /// Interface of the unit, if a capture has several [default: the first with frames of the unit].
    #[arg(long, value_name = "NAME")]
    interface: Option<String>,
    /// Format of the inputs [default: detected from their content].
    #[arg(long, value_name = "FORMAT", value_parser = input_format())]
    input_format: Option<&'static InputFormat>,
    /// Rate of serial devices.
    #[arg(long, value_name = "BAUD")]
    baud: Option<u32>,
    /// Stop a live input after this time; fails if it ends before.
    #[arg(long, value_name = "DURATION", allow_negative_numbers = true, value_parser = duration(0.001, LONGEST_S))]
    duration: Option<f64>,
    #[command(flatten)]
    range: RangeArgs,
}

impl InputArgs {
    /// A reader with these options.
    ///
    /// # Errors
    /// A range of times that is none.
    pub fn reader<'a>(&self, stop: Stop<'a>) -> Result<InputReader<'a>, CommandError> {
        Ok(InputReader::new(self.options()?, stop))
    }

    /// A reader for a described unit.
    ///
    /// # Errors
    /// A range of times that is none, or a base of identifiers that a description has.
    pub fn device_reader<'a>(
        &self,
        device: &Device,
        stop: Stop<'a>,
    ) -> Result<InputReader<'a, DeviceDecoder>, CommandError> {
        if self.base.is_some() {
            return Err(CommandError::input("--base: expected none: the identifiers are in the description"));
        }
        let mut options = self.options()?;
        options.baud = options.baud.or(device.serial.as_ref().map(|serial| serial.baud));
        Ok(InputReader::with(DeviceDecoder::new(device, &options), options, stop))
    }

    /// The end of a command: the first SIGINT, SIGTERM or SIGHUP ends a live input regularly; with files only, it ends the
    /// process.
    ///
    /// # Errors
    /// Signals cannot be watched.
    pub fn stop_at_signals(&self, inputs: &[String]) -> Result<Stop<'static>, CommandError> {
        let flag = inputs.iter().any(|input| is_live(input)).then(stop_flag).transpose();
        let flag = flag.map_err(|error| CommandError::failed(format!("signals cannot be watched: {error}")))?;
        Ok(self.stop(flag))
    }

    /// The end by a flag, or after the duration.
    pub fn stop<'a>(&self, flag: Option<&'a AtomicBool>) -> Stop<'a> {
        let deadline = self.duration.map(|duration_s| Instant::now() + Duration::from_secs_f64(duration_s));
        Stop { flag, deadline }
    }

    /// Verifies the inputs before the first is read.
    ///
    /// # Errors
    /// An input that does not exist; a duration of a recording.
    pub fn verify(&self, inputs: &[String]) -> Result<(), CommandError> {
        inputs.iter().try_for_each(|input| verify_exists(input))?;
        if self.duration.is_some()
            && let Some(recording) = inputs.iter().find(|input| is_recording(input))
        {
            let got = format!("--duration: expected live inputs alone, got the recording {recording}; leave it out");
            return Err(CommandError::input(got));
        }
        Ok(())
    }

    fn options(&self) -> Result<DecoderOptions, CommandError> {
        Ok(DecoderOptions {
            plan: self.base.unwrap_or_default(),
            interface: self.interface.clone(),
            format: self.input_format,
            baud: self.baud,
            range: self.range.range()?,
            ..DecoderOptions::default()
        })
    }

    /// Prints the reason if there was no row.
    pub fn note_no_rows(&self, summary: &DecodeSummary) {
        if let Some(reason) = geu_recording::no_rows_reason(summary, self.base.unwrap_or_default(), self.input_format) {
            note(format_args!("geu: {reason}\n"));
        }
    }
}

/// Prints the other interfaces with frames of the unit.
pub fn note_elsewhere(summary: &DecodeSummary) {
    if !summary.elsewhere.is_empty() {
        let left_out = summary.elsewhere.iter().map(|(name, frames)| format!("{frames} on {name}"));
        let left_out = left_out.collect::<Vec<_>>().join(", ");
        let used = summary.interface.as_deref().unwrap_or("none");
        note(format_args!("geu: frames of the unit left out: {left_out} (used: {used}; --interface chooses)\n"));
    }
}

/// Parser of `--input-format`: the capture formats with their titles and usual suffixes as help.
pub fn input_format() -> impl TypedValueParser<Value = &'static InputFormat> {
    let values = InputFormat::all().map(|format| {
        let suffixes: Vec<_> = format.suffixes.iter().map(|suffix| format!(".{suffix}")).collect();
        PossibleValue::new(format.name).help(format!("{} ({})", format.title, suffixes.join(", ")))
    });
    PossibleValuesParser::new(values).map(|name| InputFormat::from_name(&name).expect("a listed name"))
}
