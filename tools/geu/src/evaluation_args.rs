//! Options of commands that evaluate a recording beside attitude data.

use clap::Args;
use geu_calibration::window::{self, ManoeuvreWindow};
use geu_model::configuration::unix_ns;
use geu_protocol::CanIdMap;
use geu_recording::DecoderOptions;

use crate::command_error::{CommandError, note};
use crate::outputs::OutputFile;
use crate::settings::{can_base, start};
use crate::time_range::RangeArgs;

/// Options of commands that evaluate a recording.
#[derive(Args, Debug)]
pub struct EvaluationArgs {
    /// Manoeuvres, CSV with the columns manoeuvre,start_s,end_s [default: cut where the motion changes]
    #[arg(long, value_name = "FILE")]
    pub manoeuvres: Option<String>,
    /// Time at which the unit's clock was 0, for recordings without receive times [default: start of the attitude data]
    #[arg(long, value_name = "UNIX_SECONDS", allow_negative_numbers = true, value_parser = start)]
    pub start: Option<f64>,
    /// Base of the CAN identifiers, hexadecimal
    #[arg(long, value_name = "ID", value_parser = can_base)]
    pub base: Option<CanIdMap>,
    /// Write the result as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<OutputFile>,
    /// Write the result as a page with plots, which needs no other file
    #[arg(long, value_name = "FILE")]
    pub html: Option<OutputFile>,
    #[command(flatten)]
    pub range: RangeArgs,
}

impl EvaluationArgs {
    /// Options of the decoder.
    ///
    /// # Errors
    /// A range of times that is none.
    pub fn options(&self) -> Result<DecoderOptions, CommandError> {
        let (plan, range) = (self.base.unwrap_or_default(), self.range.range()?);
        Ok(DecoderOptions { plan, range, ..DecoderOptions::default() })
    }

    /// Reads the manoeuvres.
    ///
    /// # Errors
    /// The file cannot be read or is not valid.
    pub fn windows(&self) -> Result<Option<Vec<ManoeuvreWindow>>, CommandError> {
        self.manoeuvres.as_deref().map(window::read).transpose().map_err(CommandError::input)
    }

    pub fn start_ns(&self, default_ns: i64) -> i64 {
        self.start.map_or(default_ns, unix_ns)
    }

    /// Says where a recording without times is put beside the attitude data, unless its start is stated.
    pub fn note_start(&self, names: &[String], is_timed: bool) {
        let says = "without receive times: the unit's clock is taken to be 0 at the start of the attitude data; --start states another time";
        if !is_timed && self.start.is_none() {
            note(format_args!("geu: {}: {says}\n", names.join(" ")));
        }
    }

    /// Inputs beside the configuration, with their kinds.
    pub fn inputs(&self, links: &[String], others: &[(&'static str, &Option<String>)]) -> Vec<(&'static str, String)> {
        let links = links.iter().map(|name| ("recording", name.clone()));
        let others = [("manoeuvres", &self.manoeuvres)].into_iter().chain(others.iter().copied());
        links.chain(others.filter_map(|(kind, name)| Some((kind, name.clone()?)))).collect()
    }
}
