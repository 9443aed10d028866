//! `geu describe`: the definition of the link for other tools.

use std::path::Path;

use clap::{Args, ValueEnum};
use geu_model::device::Device;
use geu_protocol::{CanIdMap, describe};

use crate::command_error::{CommandError, print};
use crate::device::{DEFAULT_DEVICE, device, verify_link};
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
    /// Telemetry and commands for ground systems: CCSDS XTCE 1.2 (XML).
    Xtce,
    /// Telemetry and commands for OpenC3 COSMOS: a file of cmd_tlm, with the lines of plugin.txt as comments.
    Cosmos,
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
    /// Base of the CAN identifiers in the database and in the XTCE document, hexadecimal.
    #[arg(long, value_parser = can_base, default_value = "1A0")]
    base: CanIdMap,
    /// Name or description of another unit than the default one (`geu device list`).
    #[arg(long, value_name = "NAME|FILE", conflicts_with = "base")]
    device: Option<String>,
}

/// Runs `geu describe`.
///
/// # Errors
/// The definition cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let text = match (arguments.device.as_deref().filter(|name| *name != DEFAULT_DEVICE), arguments.format) {
        (Some(name), format) => of_device(name, &device(name)?, format)?,
        (None, Format::Dbc) => describe::dbc(arguments.base),
        (None, Format::Header) => describe::header(),
        (None, Format::Dissector) => describe::dissector(),
        (None, Format::Icd) => describe::icd(),
        (None, Format::Xtce) => describe::ground(arguments.base).xtce().map_err(CommandError::input)?,
        (None, Format::Cosmos) => describe::ground(arguments.base).cosmos(),
    };
    match &arguments.out {
        Some(out) => out.write(text),
        None => print(format_args!("{text}")),
    }
}

/// The definition of a described unit.
fn of_device(name: &str, device: &Device, format: Format) -> Result<String, CommandError> {
    verify_link(device)?;
    let stem = Path::new(name).file_stem().filter(|_| Path::new(name).exists());
    let stem = stem.map_or(name.into(), |stem| stem.to_string_lossy());
    let mut prefix: String = stem
        .chars()
        .map(|letter| if letter.is_ascii_alphanumeric() { letter.to_ascii_lowercase() } else { '_' })
        .collect();
    // Other programs have names such as `tcp` themselves.
    prefix.insert_str(0, "unit_");
    let wire = device.wire(&prefix);
    match (format, &device.can) {
        (Format::Dbc, Some(can)) => Ok(can.dbc.clone()),
        (Format::Dbc, None) => Err(CommandError::input(format!(
            "{name}: expected a unit on CAN for a CAN database, got one on a serial line"
        ))),
        (Format::Header, _) => Ok(wire.header()),
        (Format::Dissector, _) => Ok(wire.dissector()),
        (Format::Icd, _) => Ok(wire.icd()),
        (Format::Xtce, _) => wire.ground().xtce().map_err(|message| CommandError::input(format!("{name}: {message}"))),
        (Format::Cosmos, _) => Ok(wire.ground().cosmos()),
    }
}
