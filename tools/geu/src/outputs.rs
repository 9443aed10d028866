//! Files and directories that a command writes.
//!
//! An option that names an output has the type [`OutputFile`] or [`OutputDirectory`]; [`claim`] finds the outputs by it.

use std::any::TypeId;
use std::ffi::OsString;
use std::fmt::{self, Display, Formatter};
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use clap::{ArgMatches, Command};
use geu_files::{Output, claim_input, claim_output, claim_standard_output, persist_all};

use crate::command_error::CommandError;
use crate::output_guard::Force;

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
    pub fn standard() -> OutputFile {
        OutputFile("-".into())
    }

    /// Starts the file beside its final place.
    ///
    /// # Errors
    /// It cannot be created.
    pub fn create(&self) -> Result<Output, CommandError> {
        Output::create(&self.0).map_err(|error| self.write_error(error))
    }

    /// Error of writing this file; a closed pipe is a quiet end.
    pub fn write_error(&self, error: io::Error) -> CommandError {
        write_error(&self.0, error)
    }

    /// Writes the complete file.
    ///
    /// # Errors
    /// It cannot be written; then the previous file is kept.
    pub fn write(&self, content: impl AsRef<[u8]>) -> Result<(), CommandError> {
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
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Returns the path after checking that these files may be written into the directory.
    ///
    /// # Errors
    /// The directory is not empty and `force` is not set; a file is an input.
    pub fn prepare<F: AsRef<Path>>(
        &self,
        force: Force,
        files: impl IntoIterator<Item = F>,
    ) -> Result<&Path, CommandError> {
        force.check_empty(&self.0)?;
        self.claim(files)
    }

    /// Returns the path after claiming these files in it as outputs; other files in the directory are not checked.
    ///
    /// # Errors
    /// A file is an input or another output.
    pub fn claim<F: AsRef<Path>>(&self, files: impl IntoIterator<Item = F>) -> Result<&Path, CommandError> {
        // A directory that does not exist contains no input.
        let exists = |path: &PathBuf| path.parent().is_some_and(Path::is_dir);
        for path in files.into_iter().map(|file| self.0.join(file)).filter(exists) {
            claim_output("output", &path)?;
        }
        Ok(&self.0)
    }
}

/// Writes several complete files; none replaces its previous file before all are written.
///
/// # Errors
/// One cannot be written; then the previous files are kept.
pub fn write_all<'a>(outputs: impl IntoIterator<Item = (&'a OutputFile, String)>) -> Result<(), CommandError> {
    let complete = |(file, text): (&OutputFile, String)| {
        let mut output = file.create()?;
        let written = output.write_all(text.as_bytes()).and_then(|()| output.complete());
        written.map(|()| output).map_err(|error| file.write_error(error))
    };
    let outputs = outputs.into_iter().map(complete).collect::<Result<Vec<_>, CommandError>>()?;
    persist(outputs)
}

/// Moves complete files to their final paths.
///
/// # Errors
/// One cannot be moved; then the previous files are kept.
pub fn persist(outputs: Vec<Output>) -> Result<(), CommandError> {
    persist_all(outputs).map_err(CommandError::writing)
}

/// Creates an output directory with its parents.
///
/// # Errors
/// It cannot be created.
pub fn create_directory(path: &Path) -> Result<(), CommandError> {
    let failed = |error| CommandError::failed(format!("{}: cannot be created: {error}", path.display()));
    fs::create_dir_all(path).map_err(failed)
}

/// Writes a complete file of an output directory.
///
/// # Errors
/// It cannot be written; then the previous file is kept.
pub fn write(path: &Path, content: impl AsRef<[u8]>) -> Result<(), CommandError> {
    geu_files::write_whole(path, content).map_err(|error| write_error(path, error))
}

fn write_error(path: &Path, error: io::Error) -> CommandError {
    match error.kind() {
        io::ErrorKind::BrokenPipe => CommandError::writing(error),
        _ => CommandError::failed(format!("{}: cannot be written: {error}", path.display())),
    }
}

/// Claims the files that a command line names, before the command starts: outputs by the type of their values, and every
/// other value that is the path of a file as an input. Other inputs are claimed when they are opened.
///
/// # Errors
/// An output cannot be written, is an input, or is named twice.
pub fn claim(command: &Command, matches: &ArgMatches) -> Result<(), CommandError> {
    let (mut command, mut matches) = (command, matches);
    while let Some((name, within)) = matches.subcommand() {
        let Some(found) = command.find_subcommand(name) else { break };
        (command, matches) = (found, within);
    }
    claim_standard_output()?;
    for argument in command.get_arguments() {
        let Ok(Some(values)) = matches.try_get_raw(argument.get_id().as_str()) else { continue };
        let option = argument.get_long().map_or_else(|| argument.get_id().to_string(), |long| format!("--{long}"));
        let kind = argument.get_value_parser().type_id();
        for value in values {
            let path = Path::new(value);
            if kind == TypeId::of::<OutputFile>() {
                claim_output(&option, path)?;
            } else if (kind == TypeId::of::<PathBuf>() || kind == TypeId::of::<String>())
                && let Ok(metadata) = fs::metadata(path)
            {
                claim_input(&path.display().to_string(), &metadata)?;
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use clap::CommandFactory;

    use super::*;

    /// Options that name a path that is read, or is not a result. A new option of this kind is added here.
    const NO_OUTPUTS: [&str; 41] = [
        "blind campaign --config",
        "blind hide --config",
        "blind merge shards",
        "blind score --config",
        "blind score --json",
        "blind score --key",
        "calibrate --compare",
        "calibrate --config",
        "calibrate --fss",
        "calibrate --known",
        "calibrate --link",
        "calibrate --manoeuvres",
        "calibrate --reference",
        "calibrate --sse",
        "checkout --config",
        "config check config",
        "config show config",
        "device check file",
        "diagnose --config",
        "diagnose --link",
        "diagnose --manoeuvres",
        "diagnose --reference",
        "inject --control-token-file",
        "inject --plan",
        "monitor --control-token-file",
        "reconstruct --config",
        "reconstruct --fss",
        "reconstruct --link",
        "reconstruct --sse",
        "replay --faults",
        "replay --pty",
        "run --control-token-file",
        "run --faults",
        "run --pty",
        "run config",
        "simulate --faults",
        "simulate config",
        "track --config",
        "watch --config",
        "watch --control-token-file",
        "watch --reference",
    ];

    /// Options that `tests/outputs.rs` (files) and `tests/directories.rs` (directories) test.
    const SHOWN: &str = include_str!("../tests/outputs.txt");

    fn options(command: &Command, name: &str, is: &dyn Fn(&clap::Arg) -> bool, found: &mut BTreeSet<String>) {
        for argument in command.get_arguments().filter(|argument| is(argument)) {
            let own = argument.get_long().map_or_else(|| argument.get_id().to_string(), |long| format!("--{long}"));
            found.insert(format!("{name} {own}").trim_start().to_owned());
        }
        for within in command.get_subcommands() {
            options(within, format!("{name} {}", within.get_name()).trim_start(), is, found);
        }
    }

    fn found(is: &dyn Fn(&clap::Arg) -> bool) -> BTreeSet<String> {
        let mut found = BTreeSet::new();
        options(&crate::Arguments::command(), "", is, &mut found);
        found
    }

    #[test]
    fn every_output_option_is_tested() {
        let is_output = |argument: &clap::Arg| {
            let kind = argument.get_value_parser().type_id();
            kind == TypeId::of::<OutputFile>() || kind == TypeId::of::<OutputDirectory>()
        };
        let shown: BTreeSet<String> = SHOWN.lines().map(str::to_owned).collect();
        assert_eq!(found(&is_output), shown);
    }

    #[test]
    fn every_other_path_option_is_listed_as_no_output() {
        let names_path = |argument: &clap::Arg| {
            let kind = argument.get_value_parser().type_id();
            let names = argument.get_value_names().unwrap_or_default();
            let is_named =
                names.iter().any(|name| ["FILE", "CSV", "CONFIG", "DIR", "DIRECTORY"].contains(&name.as_str()));
            kind == TypeId::of::<PathBuf>() || (kind == TypeId::of::<String>() && is_named)
        };
        let known: BTreeSet<String> = NO_OUTPUTS.iter().map(|option| (*option).to_owned()).collect();
        assert_eq!(found(&names_path), known);
    }
}
