//! A file of a recording.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// A recording that cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// A file or directory of it.
    #[error(
        "cannot write {}: {source}; expected a directory with room that may be written",
        .path.display()
    )]
    Write {
        /// Which.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The directory holds something.
    #[error(
        "{}: expected a new or an empty directory, got one that holds {entries}; name another, or give --force, which replaces the files of a recording and leaves all others",
        .directory.display()
    )]
    Occupied {
        /// Which.
        directory: PathBuf,
        /// What.
        entries: String,
    },
    /// Somebody records into the directory.
    #[error("{}: another process records into it; expected a directory of its own", .0.display())]
    InUse(PathBuf),
    /// A directory has the name of a file of the recording.
    #[error("{}: expected a file of a recording or a free name, got a directory; move it, or name another directory", .0.display())]
    NotAFile(PathBuf),
    /// No thread to write it.
    #[error(
        "cannot record into {}: expected a thread more, got: {source}; raise the limit of processes and threads (`ulimit -u`)",
        .directory.display()
    )]
    Thread {
        /// Of the recording.
        directory: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// One file that tells its path when it fails. What is written reaches the system with [`Output::flush`] and never
/// before: the recorder decides which file is ahead of which.
pub(crate) struct Output {
    pub(super) path: PathBuf,
    file: File,
    buffer: Vec<u8>,
}

impl Output {
    pub fn create(directory: &Path, name: &str) -> Result<Output, RecordError> {
        let path = directory.join(name);
        match File::create_new(&path) {
            Ok(file) => Ok(Output { path, file, buffer: Vec::new() }),
            Err(source) => Err(RecordError::Write { path, source }),
        }
    }

    /// Writes into the buffer.
    pub fn write(&mut self, content: impl FnOnce(&mut Vec<u8>) -> io::Result<()>) -> Result<(), RecordError> {
        content(&mut self.buffer).map_err(|source| RecordError::Write { path: self.path.clone(), source })
    }

    /// Renames the file, which is whole, to `name`: what was there is replaced in one step.
    pub fn put_in_place(&mut self, name: &str) -> Result<(), RecordError> {
        self.flush()?;
        let place = self.path.with_file_name(name);
        fs::rename(&self.path, &place).map_err(|source| RecordError::Write { path: place.clone(), source })?;
        self.path = place;
        Ok(())
    }

    /// Bytes that the system does not have yet.
    pub fn buffered(&self) -> usize {
        self.buffer.len()
    }

    /// Hands what is buffered to the system.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        if self.buffer.is_empty() {
            return Ok(());
        }
        let written = self.file.write_all(&self.buffer);
        self.buffer.clear();
        written.map_err(|source| RecordError::Write { path: self.path.clone(), source })
    }
}

/// A time in ns as seconds with six decimals, the grain of a capture.
pub(super) fn stamp(ns: i64) -> String {
    let micros = (ns + 500) / 1000;
    format!("{}.{:06}", micros / 1_000_000, micros % 1_000_000)
}
