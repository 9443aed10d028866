//! Rows to a file or standard output.

use std::io::Write;
use std::path::Path;

use crate::command_error::CommandError;
use crate::outputs::OutputFile;

/// Bytes kept before they are written.
pub const BUFFER: usize = 1 << 18;

/// A file or standard output behind a large buffer.
pub struct OutputWriter {
    /// `None`: standard output.
    file: Option<OutputFile>,
    writer: geu_files::Output,
    pub buffer: Vec<u8>,
}

impl OutputWriter {
    /// Opens a file, or standard output for `None`.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn open(file: Option<&OutputFile>) -> Result<OutputWriter, CommandError> {
        let writer = match file {
            Some(file) => file.create()?,
            None => geu_files::Output::create(Path::new("-")).map_err(CommandError::writing)?,
        };
        Ok(OutputWriter { file: file.cloned(), writer, buffer: Vec::with_capacity(BUFFER + 1024) })
    }

    /// Writes the buffer.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn flush(&mut self) -> Result<(), CommandError> {
        let written = self.writer.write_all(&self.buffer).and_then(|()| self.writer.flush());
        self.buffer.clear();
        written.map_err(|error| match &self.file {
            Some(file) => file.write_error(error),
            None => CommandError::writing(error),
        })
    }

    /// Writes the buffer; the complete file is still beside its final path.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn complete(mut self) -> Result<geu_files::Output, CommandError> {
        self.flush()?;
        Ok(self.writer)
    }
}
