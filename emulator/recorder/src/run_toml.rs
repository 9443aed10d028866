//! `run.toml`: the configuration that repeats a run. It is written under a temporary name and renamed, at the start, with each
//! injected fault and at the end, so that it is complete at any time.
//!
//! Until the end it has the key `unfinished`. [`complete`] reads the rest of such a run from the files beside it: commands
//! from `commands.jsonl`, the duration from `truth.csv`. With a truth as columns, `run.toml` has the planned duration instead. The
//! recorder flushes commands and faults before their effects, and `truth.csv` before the link, so that the repeated run contains
//! all that was recorded.

use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};

use geu_model::Configuration;
use geu_model::configuration::RecordedCommand;
use geu_protocol::excerpt::excerpt;
use geu_protocol::hex::read_hex;
use serde_json::Value;

use crate::output::{Output, RecordError};
use crate::truth_csv;

/// Name of the file.
pub(crate) const NAME: &str = "run.toml";
/// Temporary name.
pub(crate) const NEW: &str = "run.toml.new";
/// Name of the file of commands.
pub(crate) const COMMANDS: &str = "commands.jsonl";
/// Maximum length of a line: the name of a link contains at most a path.
const MAX_LINE_BYTES: u64 = 1 << 16;
/// Maximum number of commands of an unfinished run, which are kept in memory: one per sample for six days.
const MAX_COMMANDS: usize = 1 << 20;

/// A file beside an unfinished `run.toml` from which the rest of the run cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}; the run of run.toml beside it did not end, and this file contains its {needed}", .path.display())]
pub struct UnfinishedError {
    path: PathBuf,
    needed: &'static str,
    problem: String,
}

/// Replaces the file by the configuration of a run, with the commands of a file with one per line.
pub(crate) fn write(
    directory: &Path,
    configuration: &Configuration,
    commands: Option<&Path>,
) -> Result<(), RecordError> {
    write_beside(directory, configuration, commands)?.put_in_place(NAME)
}

/// Writes it under the temporary name; an incomplete file is removed.
pub(crate) fn write_beside(
    directory: &Path,
    configuration: &Configuration,
    commands: Option<&Path>,
) -> Result<Output, RecordError> {
    let path = directory.join(NEW);
    // Left by a killed process, or a link to another file, which is kept.
    let _ = fs::remove_file(&path);
    let mut run = Output::create(directory, NEW)?;
    fill(&mut run, configuration, commands).inspect_err(|_| drop(fs::remove_file(&path)))?;
    Ok(run)
}

fn fill(run: &mut Output, configuration: &Configuration, commands: Option<&Path>) -> Result<(), RecordError> {
    run.write(|file| {
        writeln!(file, "# A recorded run: `geu simulate run.toml --out DIRECTORY` writes the same bytes again.")?;
        file.write_all(configuration.to_toml(false).as_bytes())
    })?;
    // Copied from the file, so that the commands of a long run need no memory.
    if let Some(commands) = commands {
        let file = File::open(commands).map_err(|source| RecordError::Write { path: commands.to_owned(), source })?;
        for line in BufReader::new(file).lines() {
            run.write(|file| {
                let command: Value = serde_json::from_str(&line?)?;
                let (sample, link, bytes) = (&command["half_second"], &command["link"], &command["bytes"]);
                writeln!(file, "\n[[run.command]]\nhalf_second = {sample}\nlink = {link}\nbytes = {bytes}")
            })?;
            if run.buffered() > 1 << 16 {
                run.flush()?;
            }
        }
    }
    run.flush()
}

/// Adds the commands and the recorded duration of an unfinished run from the files of `directory`.
///
/// # Errors
/// A file that cannot be read, an invalid line of commands, a recording without a sample.
pub fn complete(configuration: &mut Configuration, directory: &Path) -> Result<(), UnfinishedError> {
    let run = &mut configuration.run;
    let path = directory.join(truth_csv::NAME);
    if run.duration_s == 0.0 || path.exists() {
        let refused = |problem| UnfinishedError { path: path.clone(), needed: "duration", problem };
        let samples = open_input(&path).and_then(|file| truth_csv::samples(file, configuration.device.heads.len()));
        let samples = samples.map_err(|error| refused(format!("cannot be read: {error}")))?;
        if samples == 0 {
            return Err(refused("expected at least one sample, got none".to_owned()));
        }
        run.duration_s = configuration.device.on_board_s(samples);
    }
    let path = directory.join(COMMANDS);
    let refused = |problem| UnfinishedError { path: path.clone(), needed: "commands", problem };
    let file = open_input(&path).map_err(|error| refused(format!("cannot be read: {error}")))?;
    run.commands = read_commands(BufReader::new(file)).map_err(refused)?;
    (run.is_unfinished, run.ended_early) = (false, None);
    Ok(())
}

/// Opens an input file, which no output may overwrite.
fn open_input(path: &Path) -> io::Result<File> {
    let file = File::open(path)?;
    geu_files::claim_input(&path.display().to_string(), &file.metadata()?).map_err(io::Error::other)?;
    Ok(file)
}

/// Reads the commands of complete lines: a truncated last one was not acknowledged.
fn read_commands(mut lines: impl BufRead) -> Result<Vec<RecordedCommand>, String> {
    let (mut commands, mut line) = (Vec::new(), Vec::new());
    loop {
        let number = commands.len() + 1;
        line.clear();
        let read = lines.by_ref().take(MAX_LINE_BYTES).read_until(b'\n', &mut line);
        let length = read.map_err(|error| format!("line {number}: cannot be read: {error}"))?;
        if !line.ends_with(b"\n") {
            if length as u64 == MAX_LINE_BYTES {
                return Err(format!("line {number}: expected at most {MAX_LINE_BYTES} bytes, got more"));
            }
            return Ok(commands);
        }
        if number > MAX_COMMANDS {
            return Err(format!("expected at most {MAX_COMMANDS} commands, got more"));
        }
        commands.push(read_command(&line).ok_or_else(|| {
            let text = String::from_utf8_lossy(&line);
            format!("line {number}: expected half_second, link and bytes, got {:?}", excerpt(text.trim_end()))
        })?);
    }
}

fn read_command(line: &[u8]) -> Option<RecordedCommand> {
    let command: Value = serde_json::from_slice(line).ok()?;
    Some(RecordedCommand {
        sample: command["half_second"].as_u64()?,
        link: command["link"].as_str()?.to_owned(),
        payload: read_hex(command["bytes"].as_str()?)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: &str = "{\"half_second\": 3, \"link\": \"tcp\", \"bytes\": \"01\"}\n";

    #[test]
    fn a_last_line_truncated_within_a_character_is_ignored() {
        let cut = [LINE.as_bytes(), b"{\"half_second\": 4, \"link\": \"\xC3"].concat();
        assert_eq!(read_commands(&cut[..]).expect("commands").len(), 1);
        let whole = [&cut[..], b"\n"].concat();
        let refused = read_commands(&whole[..]).expect_err("not a command");
        assert!(refused.starts_with("line 2: expected half_second, link and bytes, got"), "{refused}");
        assert_eq!(
            read_commands(&b"\n"[..]).expect_err("empty"),
            "line 1: expected half_second, link and bytes, got \"\""
        );
    }

    #[test]
    fn endless_lines_are_rejected() {
        let refused = read_commands(BufReader::new(io::repeat(b'x'))).expect_err("one line");
        assert!(refused.starts_with("line 1: expected at most"), "{refused}");
        let refused = read_commands(LINE.repeat(MAX_COMMANDS + 1).as_bytes()).expect_err("too many");
        assert!(refused.starts_with("expected at most"), "{refused}");
    }
}
