//! `run.toml`: what makes the same run again. Written beside its place and renamed, at the start, with each live fault and
//! at the end, so that at any time it is whole.
//!
//! Until the end it says `unfinished`. [`complete`] takes the rest of such a run from the files beside it: commands from
//! `commands.jsonl`, the duration from `truth.csv`. The recorder writes commands and faults out before what they caused,
//! and `truth.csv` before what the link carried, so that the run made again has all that was recorded.

use std::fs::{self, File};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};

use geu_model::Configuration;
use geu_model::configuration::{RecordedCommand, read_hex};
use geu_model::units::on_board_s;
use serde_json::Value;

use super::output::{Output, RecordError};
use super::truth_csv;

/// Its name.
pub(super) const NAME: &str = "run.toml";
/// The file on its way to its place.
pub(super) const NEW: &str = "run.toml.new";
/// Name of the file of commands.
pub(super) const COMMANDS: &str = "commands.jsonl";

/// A file beside an unfinished `run.toml` that tells nothing of the rest of the run.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}; the run of run.toml beside it did not end, and its {needed} stand in this file", .path.display())]
pub struct UnfinishedError {
    path: PathBuf,
    needed: &'static str,
    problem: String,
}

/// Puts the configuration of a run in place, with the commands that a file has, one in each line.
pub(super) fn write(
    directory: &Path,
    configuration: &Configuration,
    commands: Option<&Path>,
) -> Result<(), RecordError> {
    write_beside(directory, configuration, commands)?;
    put_in_place(directory)
}

/// Puts in place what was written beside it.
pub(super) fn put_in_place(directory: &Path) -> Result<(), RecordError> {
    let path = directory.join(NEW);
    fs::rename(&path, directory.join(NAME)).map_err(|source| RecordError::Write { path, source })
}

/// Writes the same beside its place; what was written half is removed.
pub(super) fn write_beside(
    directory: &Path,
    configuration: &Configuration,
    commands: Option<&Path>,
) -> Result<(), RecordError> {
    let path = directory.join(NEW);
    // A process that was killed left one, or it is a link to another file, which stays as it is.
    let _ = fs::remove_file(&path);
    let run = Output::create(directory, NEW)?;
    fill(run, configuration, commands).inspect_err(|_| drop(fs::remove_file(&path)))
}

fn fill(mut run: Output, configuration: &Configuration, commands: Option<&Path>) -> Result<(), RecordError> {
    run.write(|file| {
        writeln!(file, "# A recorded run: `geu simulate run.toml --out DIRECTORY` writes the same bytes again.")?;
        file.write_all(configuration.to_toml(false).as_bytes())
    })?;
    // From the file, so that a run of any length needs no memory for its commands.
    if let Some(commands) = commands {
        let file = File::open(commands).map_err(|source| RecordError::Write { path: commands.to_owned(), source })?;
        for line in BufReader::new(file).lines() {
            run.write(|file| {
                let command: Value = serde_json::from_str(&line?)?;
                let (half_second, link, bytes) = (&command["half_second"], &command["link"], &command["bytes"]);
                writeln!(file, "\n[[run.command]]\nhalf_second = {half_second}\nlink = {link}\nbytes = {bytes}")
            })?;
            if run.buffered() > 1 << 16 {
                run.flush()?;
            }
        }
    }
    run.flush()
}

/// Puts in what an unfinished run has in the files of `directory` alone: its commands, and how long it is recorded.
///
/// # Errors
/// A file that cannot be read, a line of commands that is none, a recording of nothing.
pub fn complete(configuration: &mut Configuration, directory: &Path) -> Result<(), UnfinishedError> {
    let run = &mut configuration.run;
    let path = directory.join(truth_csv::NAME);
    let refused = |problem| UnfinishedError { path: path.clone(), needed: "duration", problem };
    let half_seconds = truth_csv::half_seconds(&path).map_err(|error| refused(format!("cannot be read: {error}")))?;
    if half_seconds == 0 {
        return Err(refused("expected a half second at least, got none: nothing was recorded".to_owned()));
    }
    let path = directory.join(COMMANDS);
    let refused = |problem| UnfinishedError { path: path.clone(), needed: "commands", problem };
    let text = fs::read_to_string(&path).map_err(|error| refused(format!("cannot be read: {error}")))?;
    for (index, line) in whole_lines(&text).lines().enumerate() {
        let expected = "expected half_second, link and bytes";
        let shown: String = line.chars().take(80).collect();
        let command =
            read_command(line).ok_or_else(|| refused(format!("line {}: {expected}, got {shown:?}", index + 1)))?;
        run.commands.push(command);
    }
    run.duration_s = on_board_s(half_seconds);
    (run.is_unfinished, run.ended_early) = (false, None);
    Ok(())
}

fn read_command(line: &str) -> Option<RecordedCommand> {
    let command: Value = serde_json::from_str(line).ok()?;
    Some(RecordedCommand {
        half_second: command["half_second"].as_u64()?,
        link: command["link"].as_str()?.to_owned(),
        payload: read_hex(command["bytes"].as_str()?)?,
    })
}

/// The lines of a text that are whole: a last one that was cut was not acknowledged.
pub fn whole_lines(text: &str) -> &str {
    &text[..text.rfind('\n').map_or(0, |end| end + 1)]
}
