//! Files and directories that a command writes: what options name them, and how they are written.
//!
//! An option that names an output has the type [`OutputFile`] or [`OutputDirectory`]; by it [`claim`] finds them all, and
//! without it nothing can be written.

use std::any::TypeId;
use std::ffi::OsString;
use std::fmt::{self, Display, Formatter};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{ArgMatches, Command};
use geu_files::{Output, claim_directory, claim_input, claim_output, claim_standard_output, persist_all};

use crate::failure::Failure;
use crate::overwriting::Force;

/// A file to write; `-` is standard output.
#[derive(Debug, Clone)]
pub struct OutputFile(PathBuf);

impl From<OsString> for OutputFile {
    fn from(path: OsString) -> OutputFile {
        OutputFile(path.into())
    }
}

impl Display for OutputFile {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        self.0.display().fmt(f)
    }
}

impl OutputFile {
    /// Begins it, beside its place.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn create(&self) -> Result<Output, Failure> {
        Output::create(&self.0).map_err(|error| unwritten(&self.0, &error))
    }

    /// Writes it as a whole.
    ///
    /// # Errors
    /// When it cannot be written; then what was there is there still.
    pub fn write(&self, content: impl AsRef<[u8]>) -> Result<(), Failure> {
        write(&self.0, content)
    }
}

/// A directory to write into.
#[derive(Debug, Clone)]
pub struct OutputDirectory(PathBuf);

impl From<OsString> for OutputDirectory {
    fn from(path: OsString) -> OutputDirectory {
        OutputDirectory(path.into())
    }
}

impl OutputDirectory {
    /// Its path, where it may be written into.
    ///
    /// # Errors
    /// One that holds anything, unless it was forced.
    pub fn prepare(&self, force: Force) -> Result<&Path, Failure> {
        force.refuse_filled(&self.0)?;
        Ok(&self.0)
    }
}

/// Writes several, each as a whole, and none before all could be written.
///
/// # Errors
/// When one cannot be written; then what was there is there still.
pub fn write_all<'a>(outputs: impl IntoIterator<Item = (&'a OutputFile, String)>) -> Result<(), Failure> {
    let complete = |(file, text): (&OutputFile, String)| {
        let mut output = file.create()?;
        let written = output.write_all(text.as_bytes()).and_then(|()| output.complete());
        written.map(|()| output).map_err(|error| unwritten(&file.0, &error))
    };
    let outputs = outputs.into_iter().map(complete).collect::<Result<Vec<_>, Failure>>()?;
    persist_all(outputs).map_err(Failure::writing)
}

/// Writes a file of an output directory as a whole.
///
/// # Errors
/// When it cannot be written; then what was there is there still.
pub fn write(path: &Path, content: impl AsRef<[u8]>) -> Result<(), Failure> {
    geu_files::write_whole(path, content).map_err(|error| unwritten(path, &error))
}

fn unwritten(path: &Path, error: &std::io::Error) -> Failure {
    Failure::failed(format!("{}: cannot be written: {error}", path.display()))
}

/// Claims what the options of a command line name, before the command begins: outputs by the type of their values, and
/// every other value that is the path of a file as an input. Inputs that no option names claim themselves when they are
/// opened.
///
/// # Errors
/// An output that cannot be written, that is an input, or another output.
pub fn claim(command: &Command, matches: &ArgMatches) -> Result<(), Failure> {
    let (mut command, mut matches) = (command, matches);
    while let Some((name, within)) = matches.subcommand() {
        let Some(found) = command.find_subcommand(name) else { break };
        (command, matches) = (found, within);
    }
    claim_standard_output().map_err(Failure::input)?;
    for argument in command.get_arguments() {
        let Ok(Some(values)) = matches.try_get_raw(argument.get_id().as_str()) else { continue };
        let option = argument.get_long().map_or_else(|| argument.get_id().to_string(), |long| format!("--{long}"));
        let kind = argument.get_value_parser().type_id();
        for value in values {
            let path = Path::new(value);
            if kind == TypeId::of::<OutputFile>() {
                claim_output(&option, path).map_err(Failure::input)?;
            } else if kind == TypeId::of::<OutputDirectory>() {
                claim_directory(&option, path).map_err(Failure::input)?;
            } else if (kind == TypeId::of::<PathBuf>() || kind == TypeId::of::<String>())
                && let Ok(metadata) = fs::metadata(path)
            {
                claim_input(&path.display().to_string(), &metadata).map_err(Failure::input)?;
            }
        }
    }
    Ok(())
}
