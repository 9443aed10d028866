//! The directory that a recording goes into: nothing in it is touched before the recording can begin.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use geu_model::Configuration;

use super::output::{Output, RecordError};
use super::{run_toml, truth_csv};
use crate::truth::received;

/// Files that a recording can have. With `--force` these are replaced, and no others.
pub const FILES: [&str; 13] = [
    "link.log",
    "link.bin",
    "reference.csv",
    "truth.csv",
    "manoeuvres.csv",
    "commands.jsonl",
    "faults.jsonl",
    "fss.csv",
    "sse.csv",
    received::NAME,
    run_toml::NAME,
    run_toml::NEW,
    truth_csv::WIDER,
];
/// Names of a directory's entries that a message tells.
const TOLD: usize = 3;

/// Where a recording goes.
#[derive(Debug, Clone)]
pub struct Destination {
    directory: PathBuf,
    /// Whether a recording that is there is replaced.
    replaces: bool,
}

impl Destination {
    /// A directory, which need not be there; `replaces`: a recording in it is replaced.
    pub fn new(directory: impl Into<PathBuf>, replaces: bool) -> Destination {
        Destination { directory: directory.into(), replaces }
    }

    /// Its path.
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// Whether a recording may begin there; changes nothing.
    ///
    /// # Errors
    /// A directory that holds something, or cannot be read.
    pub fn check(&self) -> Result<(), RecordError> {
        let entries = match fs::read_dir(&self.directory) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            entries => {
                entries.and_then(Iterator::collect::<io::Result<Vec<_>>>).map_err(|source| self.failed(source))?
            }
        };
        if self.replaces {
            let taken = FILES.iter().map(|name| self.directory.join(name)).find(|path| path.is_dir());
            return taken.map_or(Ok(()), |path| Err(RecordError::NotAFile(path)));
        }
        if entries.is_empty() {
            return Ok(());
        }
        let mut names: Vec<String> =
            entries.iter().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
        names.sort_unstable();
        let more = names.len().saturating_sub(TOLD);
        names.truncate(TOLD);
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        Err(RecordError::Occupied { directory: self.directory.clone(), entries: names.join(", ") + &more })
    }

    /// Makes the directory, holds it for as long as the file lives, writes `run` beside its place, and removes what a
    /// recording has that is replaced. Returns the lock, and `run` to be put in place.
    pub(super) fn claim(&self, run: &Configuration) -> Result<(File, Output), RecordError> {
        self.check()?;
        fs::create_dir_all(&self.directory).map_err(|source| self.failed(source))?;
        let held = File::open(&self.directory).map_err(|source| self.failed(source))?;
        // A file system that cannot lock a directory is recorded to all the same.
        if let Err(TryLockError::WouldBlock) = held.try_lock() {
            return Err(RecordError::InUse(self.directory.clone()));
        }
        // Again: somebody may have recorded into it before it was held.
        self.check()?;
        // A directory that cannot be written, or takes no bytes, is found out before anything is removed.
        let run = run_toml::write_beside(&self.directory, run, None)?;
        for path in FILES.iter().filter(|name| **name != run_toml::NEW).map(|name| self.directory.join(name)) {
            match fs::remove_file(&path) {
                Err(source) if source.kind() != io::ErrorKind::NotFound => {
                    return Err(RecordError::Write { path, source });
                }
                _ => {}
            }
        }
        Ok((held, run))
    }

    fn failed(&self, source: io::Error) -> RecordError {
        RecordError::Write { path: self.directory.clone(), source }
    }
}
