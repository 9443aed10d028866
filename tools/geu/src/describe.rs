//! `geu describe`: the definition of the link for other tools.

use clap::{Args, ValueEnum};
use geu_protocol::{CanIdMap, describe};

use crate::command_error::{CommandError, print};
use crate::outputs::OutputFile;
use crate::settings::can_base;

/// Formats of the definition.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Format {
    /// CAN database, for cantools, SavvyCAN and others (geu.dbc).
    Dbc,
    /// C99 header for on-board software (geu.h).
    Header,
    /// Wireshark dissector in Lua (geu.lua).
    Dissector,
    /// Interface control document (ICD.md).
    Icd,
}

/// Writes the definition of the link in the format of another tool.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Format of the definition.
    #[arg(value_name = "FORM")]
    format: Format,
    /// File to write instead of standard output.
    #[arg(long, value_name = "FILE")]
    out: Option<OutputFile>,
    /// Base of the CAN identifiers in the database, hexadecimal.
    #[arg(long, value_parser = can_base, default_value = "1A0")]
    base: CanIdMap,
}

/// Runs `geu describe`.
///
/// # Errors
/// The definition cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let text = match arguments.format {
        Format::Dbc => describe::dbc(arguments.base),
        Format::Header => describe::header(),
        Format::Dissector => describe::dissector(),
        Format::Icd => describe::icd(),
    };
    match &arguments.out {
        Some(out) => out.write(text),
        None => print(format_args!("{text}")),
    }
}
