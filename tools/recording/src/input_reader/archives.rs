//! Reads archives.

use std::path::Path;

use geu_protocol::capture::RecordPosition;

use super::{Decode, InputReader};
use crate::archive::{Archive, archive_files};
use crate::input::InputError;
use crate::row::Sink;

impl<D: Decode> InputReader<'_, D> {
    /// Reads the files of an archive; false if it is none.
    pub(super) fn archive(&mut self, name: &str, sink: &mut impl Sink<D::Row>) -> Result<bool, InputError> {
        let files = archive_files(name)?;
        let is_file = files.is_none();
        if is_file && !Path::new(name).is_file() {
            return Ok(false);
        }
        let unit = self.decoder.archive();
        for file in files.unwrap_or_else(|| vec![name.into()]) {
            let path = file.display().to_string();
            let failed = |message: String| InputError::Archive { name: path.clone(), message };
            let archive = Archive::open(&file, &unit, self.options.range).map_err(|error| failed(error.to_string()))?;
            let Some(mut archive) = archive else {
                let message =
                    "expected a file of `geu decode --format parquet`, got another or damaged one; move it elsewhere";
                return if is_file { Ok(false) } else { Err(failed(message.to_owned())) };
            };
            self.begin(&path, sink);
            self.decoder.describe("archive");
            while !self.is_done(sink)
                && let Some((before, count)) = archive.next_batch().map_err(|error| failed(error.to_string()))?
            {
                for row in 0..count {
                    let number = before + row as u64 + 1;
                    let has_row = archive.has_row(row).and_then(|has_row| match has_row {
                        true => self.decoder.archived(RecordPosition::Line(number), archive.rows(), row, sink),
                        false => Ok(()),
                    });
                    has_row.map_err(|error| failed(format!("row {number}: {error}")))?;
                }
            }
        }
        Ok(true)
    }
}
