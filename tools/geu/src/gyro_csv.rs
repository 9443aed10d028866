//! CSV of any gyros: its description.

use std::path::Path;

use geu_recording::GyroCsvSpec;

use crate::command_error::CommandError;
use crate::settings::read_text;

/// Reads a description.
///
/// # Errors
/// The file cannot be read or is not valid.
pub fn description(path: &Path) -> Result<GyroCsvSpec, CommandError> {
    let text = read_text(path, "a description, such as configs/suchai3.toml")?;
    GyroCsvSpec::parse(&path.display().to_string(), &text).map_err(CommandError::input)
}
