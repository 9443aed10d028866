//! `geu describe`: the link as other tools read it.

use clap::{Args, ValueEnum};
use geu_protocol::{CanIdMap, describe};

use crate::failure::{CommandError, print};
use crate::outputs::OutputFile;

/// What `geu describe` can write.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Form {
    /// CAN database, for cantools, SavvyCAN and others (geu.dbc).
    Dbc,
    /// C99 header for on-board software (geu.h).
    Header,
    /// Wireshark dissector in Lua (geu.lua).
    Dissector,
    /// Interface control document (ICD.md).
    Icd,
}

/// Writes the link's definition in the form another tool reads.
#[derive(Debug, Args)]
pub struct Arguments {
    /// In which form.
    form: Form,
    /// File to write instead of standard output.
    #[arg(long, value_name = "FILE")]
    out: Option<OutputFile>,
    /// Base of the CAN identifiers in the database, hexadecimal.
    #[arg(long, value_parser = base, default_value = "1A0")]
    base: CanIdMap,
}

fn base(text: &str) -> Result<CanIdMap, String> {
    let expected = || format!("expected a hexadecimal number up to {:X}", CanIdMap::MAX_BASE);
    let base = u16::from_str_radix(text, 16).map_err(|_| expected())?;
    CanIdMap::with_base(base).ok_or_else(expected)
}

/// Writes the description.
///
/// # Errors
/// When it cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let text = match arguments.form {
        Form::Dbc => describe::dbc(arguments.base),
        Form::Header => describe::header(),
        Form::Dissector => describe::dissector(),
        Form::Icd => describe::icd(),
    };
    match &arguments.out {
        Some(out) => out.write(text),
        None => print(format_args!("{text}")),
    }
}
