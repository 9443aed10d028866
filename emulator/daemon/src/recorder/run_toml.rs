//! `run.toml`: what makes the same run again. Written beside its place and renamed, at the start, with each live fault and
//! at the end, so that at any time it is whole.
//!
//! Until the end it says `unfinished`. [`complete`] takes the rest of such a run from the files beside it: commands from
//! `commands.jsonl`, the duration from `truth.csv`. The recorder writes commands and faults out before what they caused,
//! and `truth.csv` before what the link carried, so that the run made again has all that was recorded.

use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};

use geu_model::Configuration;
use geu_model::configuration::RecordedCommand;
use geu_model::units::on_board_s;
use geu_protocol::excerpt::excerpt;
use geu_protocol::hex::read_hex;
use serde_json::Value;

use super::output::{Output, RecordError};
use super::truth_csv;

/// Its name.
pub(super) const NAME: &str = "run.toml";
/// The file on its way to its place.
pub(super) const NEW: &str = "run.toml.new";
/// Name of the file of commands.
pub(super) const COMMANDS: &str = "commands.jsonl";
/// Bytes of a line of it: the name of a link has a path at most.
const MOST_LINE_BYTES: u64 = 1 << 16;
/// Commands of an unfinished run, which are kept in memory: one in each sample interval of six days.
const MOST_COMMANDS: usize = 1 << 20;

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
    write_beside(directory, configuration, commands)?.put_in_place(NAME)
}

/// Writes the same beside its place; what was written half is removed.
pub(super) fn write_beside(
    directory: &Path,
    configuration: &Configuration,
    commands: Option<&Path>,
) -> Result<Output, RecordError> {
    let path = directory.join(NEW);
    // A process that was killed left one, or it is a link to another file, which stays as it is.
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
    // From the file, so that a run of any length needs no memory for its commands.
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

/// Puts in what an unfinished run has in the files of `directory` alone: its commands, and how long it is recorded.
///
/// # Errors
/// A file that cannot be read, a line of commands that is none, a recording of nothing.
pub fn complete(configuration: &mut Configuration, directory: &Path) -> Result<(), UnfinishedError> {
    let run = &mut configuration.run;
    let path = directory.join(truth_csv::NAME);
    let refused = |problem| UnfinishedError { path: path.clone(), needed: "duration", problem };
    let samples = open_input(&path).and_then(truth_csv::samples);
    let samples = samples.map_err(|error| refused(format!("cannot be read: {error}")))?;
    if samples == 0 {
        return Err(refused("expected a sample at least, got none: nothing was recorded".to_owned()));
    }
    let path = directory.join(COMMANDS);
    let refused = |problem| UnfinishedError { path: path.clone(), needed: "commands", problem };
    let file = open_input(&path).map_err(|error| refused(format!("cannot be read: {error}")))?;
    run.commands = read_commands(BufReader::new(file)).map_err(refused)?;
    run.duration_s = on_board_s(samples);
    (run.is_unfinished, run.ended_early) = (false, None);
    Ok(())
}

/// Opens a file that no output may be.
fn open_input(path: &Path) -> io::Result<File> {
    let file = File::open(path)?;
    geu_files::claim_input(&path.display().to_string(), &file.metadata()?).map_err(io::Error::other)?;
    Ok(file)
}

/// The commands of the lines that are whole: a last one that was cut was not acknowledged.
fn read_commands(mut lines: impl BufRead) -> Result<Vec<RecordedCommand>, String> {
    let (mut commands, mut line) = (Vec::new(), Vec::new());
    loop {
        let number = commands.len() + 1;
        line.clear();
        let read = lines.by_ref().take(MOST_LINE_BYTES).read_until(b'\n', &mut line);
        let length = read.map_err(|error| format!("line {number}: cannot be read: {error}"))?;
        if !line.ends_with(b"\n") {
            if length as u64 == MOST_LINE_BYTES {
                return Err(format!("line {number}: expected at most {MOST_LINE_BYTES} bytes, got more"));
            }
            return Ok(commands);
        }
        if number > MOST_COMMANDS {
            return Err(format!("expected at most {MOST_COMMANDS} commands, got more"));
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
    fn a_last_line_that_was_cut_within_a_character_is_left_out() {
        let cut = [LINE.as_bytes(), b"{\"half_second\": 4, \"link\": \"\xC3"].concat();
        assert_eq!(read_commands(&cut[..]).expect("commands").len(), 1);
        let whole = [&cut[..], b"\n"].concat();
        let refused = read_commands(&whole[..]).expect_err("it is none");
        assert!(refused.starts_with("line 2: expected half_second, link and bytes, got"), "{refused}");
        assert_eq!(
            read_commands(&b"\n"[..]).expect_err("empty"),
            "line 1: expected half_second, link and bytes, got \"\""
        );
    }

    #[test]
    fn lines_without_end_are_not_read_to_their_end() {
        let refused = read_commands(BufReader::new(io::repeat(b'x'))).expect_err("one line");
        assert!(refused.starts_with("line 1: expected at most"), "{refused}");
        let refused = read_commands(LINE.repeat(MOST_COMMANDS + 1).as_bytes()).expect_err("too many");
        assert!(refused.starts_with("expected at most"), "{refused}");
    }
}
