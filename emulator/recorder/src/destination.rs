//! The directory of a recording: no file in it is changed before the recording can begin.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use geu_model::Configuration;

use crate::output::{Output, RecordError};
use crate::received;
use crate::{run_toml, truth_csv};

/// Files that a recording can have; `--force` replaces only these.
pub const FILES: [&str; 15] = [
    "link.log",
    "link.bin",
    "reference.csv",
    "truth.csv",
    "truth.parquet",
    "truth.arrow",
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
/// Maximum number of directory entries in a message.
const LISTED: usize = 3;

/// Destination of a recording.
#[derive(Debug, Clone)]
pub struct Destination {
    directory: PathBuf,
    /// True if an existing recording is replaced.
    replaces: bool,
}

impl Destination {
    /// A directory, which need not exist; `replaces`: an existing recording in it is replaced.
    pub fn new(directory: impl Into<PathBuf>, replaces: bool) -> Destination {
        Destination { directory: directory.into(), replaces }
    }

    /// Path of the directory.
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// Checks that a recording may begin, without any change.
    ///
    /// # Errors
    /// A directory that is not empty, or cannot be read.
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
        let more = names.len().saturating_sub(LISTED);
        names.truncate(LISTED);
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        Err(RecordError::Occupied { directory: self.directory.clone(), entries: names.join(", ") + &more })
    }

    /// Creates and locks the directory, writes `run` under a temporary name, and removes the files of a replaced recording.
    /// Returns the lock, and the temporary file.
    pub(crate) fn claim(&self, run: &Configuration) -> Result<(File, Output), RecordError> {
        self.check()?;
        fs::create_dir_all(&self.directory).map_err(|source| self.failed(source))?;
        let lock = File::open(&self.directory).map_err(|source| self.failed(source))?;
        // Some file systems cannot lock a directory; recording is possible nevertheless.
        if let Err(TryLockError::WouldBlock) = lock.try_lock() {
            return Err(RecordError::InUse(self.directory.clone()));
        }
        // Again: another process may have recorded into it before the lock.
        self.check()?;
        // An unwritable directory or a full disk is detected before any file is removed.
        let run = run_toml::write_beside(&self.directory, run, None)?;
        let left = self.partial_truths().map_err(|source| self.failed(source))?;
        let replaced = FILES.iter().filter(|name| **name != run_toml::NEW).map(|name| self.directory.join(name));
        for path in replaced.chain(left) {
            match fs::remove_file(&path) {
                Err(source) if source.kind() != io::ErrorKind::NotFound => {
                    return Err(RecordError::Write { path, source });
                }
                _ => {}
            }
        }
        Ok((lock, run))
    }

    /// Truths as columns that killed runs left, incomplete and of no use.
    fn partial_truths(&self) -> io::Result<Vec<PathBuf>> {
        let is_left = |path: &PathBuf| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            name.starts_with("truth.") && geu_files::is_partial(path)
        };
        let paths = fs::read_dir(&self.directory)?.map(|entry| entry.map(|entry| entry.path()));
        Ok(paths.collect::<io::Result<Vec<_>>>()?.into_iter().filter(is_left).collect())
    }

    fn failed(&self, source: io::Error) -> RecordError {
        RecordError::Write { path: self.directory.clone(), source }
    }
}
