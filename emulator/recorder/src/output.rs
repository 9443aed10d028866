//! A file of a recording.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// A recording that cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// A file or directory.
    #[error(
        "cannot write {}: {source}; expected a writable directory with free space",
        .path.display()
    )]
    Write {
        /// Path.
        path: PathBuf,
        /// Cause.
        source: io::Error,
    },
    /// The directory is not empty.
    #[error(
        "{}: expected a new or an empty directory, got one with {entries}; choose another, or give --force, which replaces the files of a recording and keeps all others",
        .directory.display()
    )]
    Occupied {
        /// Path.
        directory: PathBuf,
        /// Names of entries.
        entries: String,
    },
    /// Another process records into the directory.
    #[error("{}: another process records into it; expected a directory of its own", .0.display())]
    InUse(PathBuf),
    /// A directory has the name of a file of the recording.
    #[error("{}: expected a file of a recording or a free name, got a directory; move it, or choose another directory", .0.display())]
    NotAFile(PathBuf),
    /// The thread cannot be started.
    #[error(
        "cannot record into {}: expected another thread, got: {source}; raise the limit of processes and threads (`ulimit -u`)",
        .directory.display()
    )]
    Thread {
        /// Directory of the recording.
        directory: PathBuf,
        /// Cause.
        source: io::Error,
    },
}

/// A file with its path for error messages. Data reaches the system with [`Output::flush`] and never before: the recorder
/// determines the order of the files.
pub(crate) struct Output {
    pub(crate) path: PathBuf,
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

    /// Appends to the buffer.
    pub fn write(&mut self, content: impl FnOnce(&mut Vec<u8>) -> io::Result<()>) -> Result<(), RecordError> {
        content(&mut self.buffer).map_err(|source| RecordError::Write { path: self.path.clone(), source })
    }

    /// Renames the complete file to `name`, and replaces the previous one in one step.
    pub fn put_in_place(&mut self, name: &str) -> Result<(), RecordError> {
        self.flush()?;
        let place = self.path.with_file_name(name);
        fs::rename(&self.path, &place).map_err(|source| RecordError::Write { path: place.clone(), source })?;
        self.path = place;
        Ok(())
    }

    /// Number of buffered bytes.
    pub fn buffered(&self) -> usize {
        self.buffer.len()
    }

    /// Writes the buffer to the file.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        if self.buffer.is_empty() {
            return Ok(());
        }
        let written = self.file.write_all(&self.buffer);
        self.buffer.clear();
        written.map_err(|source| RecordError::Write { path: self.path.clone(), source })
    }
}
