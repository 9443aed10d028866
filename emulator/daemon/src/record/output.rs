//! A file of a recording.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

/// A file of the recording that cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {}: {source}; expected a directory with room that may be written, and that nobody else records into", .path.display())]
pub struct RecordError {
    pub(super) path: PathBuf,
    pub(super) source: io::Error,
}

/// One file, written through a buffer, that tells its path when it fails.
pub(crate) struct Output {
    pub(super) path: PathBuf,
    file: BufWriter<File>,
}

impl Output {
    pub fn create(directory: &Path, name: &str) -> Result<Output, RecordError> {
        let path = directory.join(name);
        match File::create(&path) {
            Ok(file) => Ok(Output { path, file: BufWriter::with_capacity(1 << 16, file) }),
            Err(source) => Err(RecordError { path, source }),
        }
    }

    pub fn write(&mut self, content: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<(), RecordError> {
        content(&mut self.file).map_err(|source| RecordError { path: self.path.clone(), source })
    }
}
