//! `geu device`: the units that are known by name, and the check of a description.

use std::fmt::Write;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{Args, Subcommand};
use geu_model::Configuration;
use geu_model::device::{DEVICES, Device, TableWire};
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::Gyro;
use geu_protocol::hex::spaced_hex;
use geu_protocol::layout::{Frame, FrameSet, Quantity};
use geu_protocol::suggestion::did_you_mean;

use crate::command_error::{CommandError, print, say};

/// Lists, shows and checks descriptions of units.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Subcommand, Debug)]
enum Action {
    /// Print the units that are known by name
    List,
    /// Print what a unit is and what its frames carry, byte by byte
    Show {
        /// Name or description of the unit
        #[arg(value_name = "NAME|FILE")]
        device: String,
        /// Print the description itself, to begin another one with
        #[arg(long)]
        toml: bool,
    },
    /// Check a description; exit 2 with the place of the first error. docs/devices.md lists the keys
    Check {
        /// Description of the unit (TOML)
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
}

pub use geu_model::device::DEFAULT_DEVICE;

/// The unit of a name or a description.
///
/// # Errors
/// No such unit, or a description that is not valid.
pub fn device(name: &str) -> Result<Device, CommandError> {
    match Device::from_name(name) {
        Some(device) => Ok(device),
        None if !Path::new(name).exists() => Err(unknown(name)),
        None => read(Path::new(name)),
    }
}

/// The unit of a name or a description, or the default one.
///
/// # Errors
/// No such unit, or a description that is not valid.
pub fn unit(name: &str) -> Result<Arc<Device>, CommandError> {
    if name == DEFAULT_DEVICE { Ok(Device::iras()) } else { device(name).map(Arc::new) }
}

/// Refuses a unit without a link.
///
/// # Errors
/// The samples come in a table alone.
pub fn verify_link(device: &Device) -> Result<(), CommandError> {
    match device.has_link() {
        true => Ok(()),
        false => {
            Err(CommandError::input(format!("{}: expected a unit with a link, got one with a table", device.name)))
        }
    }
}

/// Refuses another unit than the default one, with the reason.
///
/// # Errors
/// A described unit, or an unknown name.
pub fn verify_default(name: Option<&str>, reason: &str) -> Result<(), CommandError> {
    match name.map(unit).transpose()?.filter(|device| !device.is_iras()) {
        Some(device) => {
            Err(CommandError::input(format!("--device: expected {DEFAULT_DEVICE}, got {}: {reason}", device.name)))
        }
        None => Ok(()),
    }
}

fn unknown(name: &str) -> CommandError {
    let names: Vec<&str> = DEVICES.iter().map(|(name, _)| *name).collect();
    let hint = did_you_mean(name, &names);
    CommandError::input(format!("{name}: {hint}expected a description (TOML), or a name: {}", names.join(", ")))
}

/// The text of a regular file.
fn text_of(path: &Path) -> Result<String, std::io::Error> {
    match path.metadata()?.is_file() {
        true => geu_recording::read_text(path),
        false => Err(std::io::Error::other("not a regular file")),
    }
}

/// The text of a CAN database, which is often in Windows' Western encoding.
fn database(path: &Path) -> Result<String, String> {
    let is_short = path.metadata().is_ok_and(|file| file.len() <= MAX_DATABASE_BYTES);
    match text_of(path) {
        Err(error) if error.kind() == ErrorKind::InvalidData && is_short => {
            let bytes = std::fs::read(path).map_err(|error| error.to_string())?;
            Ok(bytes.iter().map(|byte| char::from(*byte)).collect())
        }
        result => result.map_err(|error| error.to_string()),
    }
}

/// Longest database that is not UTF-8.
const MAX_DATABASE_BYTES: u64 = 1 << 22;

/// The text of a description.
fn description(path: &Path) -> Result<String, CommandError> {
    let expected = "expected a description, such as `geu device show stim300 --toml` prints";
    text_of(path).map_err(|error| CommandError::input(format!("{}: {error}; {expected}", path.display())))
}

fn read(path: &Path) -> Result<Device, CommandError> {
    let text = description(path)?;
    // A recording's configuration has its unit.
    let name = path.display().to_string();
    if let Ok(configuration) = Configuration::parse(&name, &text, &[])
        && !configuration.device.is_iras()
    {
        return Ok((*configuration.device).clone());
    }
    let beside = |file: &str| database(&path.with_file_name(file));
    Device::parse(&name, &text, &beside).map_err(CommandError::input)
}

/// Runs `geu device`.
///
/// # Errors
/// A description is not valid.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    match &arguments.action {
        Action::List => {
            let heads = Gyro::NAMES.join(" ");
            let mut text = format!(
                "{DEFAULT_DEVICE:<18} {:<11} {:>8}  {heads}, the default unit\n",
                "serial, CAN",
                format!("{} Hz", 1.0 / SAMPLE_INTERVAL_S)
            );
            for (name, _) in DEVICES {
                let device = device(name)?;
                let heads: Vec<&str> = device.gyros().map(Gyro::name).collect();
                let (serial, can, table) = (device.serial.is_some(), device.can.is_some(), device.table.is_some());
                let links = [("serial", serial), ("CAN", can), ("table", table)];
                let links = links.into_iter().filter(|(_, has)| *has).map(|(link, _)| link);
                let links = links.collect::<Vec<_>>().join(", ");
                let (heads, interval) = (heads.join(" "), device.rate_in_words());
                _ = writeln!(text, "{name:<18} {links:<11} {interval:>8}  {heads}, {}", device.name);
            }
            print(format_args!("{text}"))
        }
        Action::Show { device: name, toml: true } => match DEVICES.iter().find(|(own, _)| own == name) {
            Some((_, text)) => print(format_args!("{text}")),
            None if Path::new(name).exists() => print(format_args!("{}", description(Path::new(name))?)),
            None => Err(unknown(name)),
        },
        Action::Show { device: name, .. } if name == DEFAULT_DEVICE => {
            say!("{name}: the default unit; `geu describe icd` prints its interface")
        }
        Action::Show { device: name, .. } => print(format_args!("{}", text(&device(name)?))),
        Action::Check { file } => {
            let device = read(file)?;
            say!("{}: valid, {}", file.display(), device.name)
        }
    }
}

/// The unit in words, and its frames.
fn text(device: &Device) -> String {
    let mut text = String::new();
    let mut line = |name: &str, value: String| _ = writeln!(text, "{name:<10} {value}");
    line("unit", device.name.clone());
    line("source", device.source.clone());
    line("output", device.in_words());
    for head in &device.heads {
        let axis = |axis: [f64; 3]| axis.map(|part| format!("{part:.3}")).join(" ");
        let output = head.axes.output().map_or(String::new(), |output| format!(", output axis {}", axis(output)));
        line("head", format!("{:<8} input axis {}{output}", head.gyro.name(), axis(head.axes.input_control)));
    }
    if let Some(serial) = &device.serial {
        let unchecked = if serial.is_unchecked { ", frames without constant or check" } else { "" };
        line("serial", format!("{} baud{unchecked}", serial.baud));
        text.push_str(&frames(&serial.frames));
    }
    if let Some(can) = &device.can {
        _ = writeln!(text, "{:<10} {} bit/s", "CAN", can.bitrate);
        text.push_str(&frames(&can.frames));
    }
    device.table.iter().for_each(|table| text.push_str(&columns(table)));
    text
}

/// The columns of a table.
fn columns(table: &TableWire) -> String {
    let mut text = format!("{:<10} cells separated by {:?}\n\n", "table", table.delimiter);
    let mut line = |column: &str, content: String| _ = writeln!(text, "  column {column:<20} {content}");
    line(&table.time.column, format!("end of the row's interval, {}", table.time.unit));
    table.start.iter().for_each(|start| line(&start.column, format!("start of the row's interval, {}", start.unit)));
    table.group.iter().for_each(|group| line(group, "trial".to_owned()));
    for (field, column) in table.frames.frames[0].fields.iter().zip(&table.columns) {
        line(column, format!("{} = {}", table.frames.values[field.slot].name, field.formula()));
    }
    if let Some(reference) = &table.reference {
        let titles = reference.titles().map(String::as_str).collect::<Vec<_>>().join(", ");
        _ = writeln!(text, "\n{:<10} windows with the columns {titles}", "reference");
    }
    text
}

/// The frames, a line for each field in the order of bytes.
fn frames(set: &FrameSet) -> String {
    let mut text = String::new();
    for frame in &set.frames {
        let id = match frame.id {
            Some((id, true)) => format!(", identifier {id:08X}"),
            Some((id, false)) => format!(", identifier {id:03X}"),
            None => String::new(),
        };
        _ = writeln!(text, "\n{}{id}, {} bytes, {}", frame.name, frame.length(), set.cadence(frame));
        for (bit, line) in lines(frame, set) {
            _ = writeln!(text, "  byte {:<3} {line}", bit / 8);
        }
    }
    text
}

/// First bit and text of each field, of the constant and of the checks.
fn lines(frame: &Frame, set: &FrameSet) -> Vec<(usize, String)> {
    let mut lines = Vec::new();
    for (at, bytes, is_constant) in frame.other_bytes() {
        let kind = if is_constant { "constant" } else { "ignored" };
        lines.push((8 * at, format!("{kind:<12} {}", spaced_hex(bytes))));
    }
    for (at, bits, own) in frame.constant_bits() {
        lines.push((8 * at, format!("{:<12} {own:02X} in the bits {bits:02X}", "constant")));
    }
    for field in &frame.fields {
        let (place, value) = (field.place, &set.values[field.slot]);
        let modulo = match (&value.quantity, set.sequence) {
            (Quantity::Sequence, (modulus, 1)) => format!(", modulo {modulus}"),
            (Quantity::Sequence, (modulus, step)) => format!(", modulo {modulus}, in steps of {step}"),
            _ => String::new(),
        };
        let text = format!("{:<12} {} = {}{modulo}", place.to_string(), value.name, field.formula());
        lines.push((8 * place.at, text));
    }
    for check in &frame.checks {
        let text = format!("{:<12} {}", check.place.to_string(), check.in_words(frame.length()));
        lines.push((8 * check.place.at, text));
    }
    lines.sort_by_key(|(bit, _)| *bit);
    lines
}
