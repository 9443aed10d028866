//! A file that is written beside its final path and renamed when it is complete.

use std::ffi::{OsStr, OsString};
use std::fs::{File, Metadata, OpenOptions, Permissions};
use std::io::{self, Write};
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::os::unix::fs::{MetadataExt, PermissionsExt, fchown};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use crate::interruption::{unfinished, watch};
use crate::place::{Target, parent};

/// End of the name of an incomplete file.
const SUFFIX: &str = ".partial";
/// Longest part of the final name in it: file systems allow 255 bytes, and some are added.
const NAME_BYTES: usize = 200;
/// Mode of a new file, before the process's mask.
const MODE: u32 = 0o666;

/// True if the name is that of an incomplete output.
pub fn is_partial(path: &Path) -> bool {
    path.as_os_str().as_encoded_bytes().ends_with(SUFFIX.as_bytes())
}

/// An output. If it is dropped before [`Output::persist`], the previous file is kept.
///
/// A file is written as `NAME.….partial` beside its final path. It keeps the permissions and, if permitted, the owner of the
/// replaced file; of a symlink, the target is replaced. Standard output (`-`), devices and pipes are written directly.
#[derive(Debug)]
pub struct Output {
    destination: Destination,
    /// Replaces no file.
    is_new: bool,
}

#[derive(Debug)]
enum Destination {
    Direct(File),
    Beside(Unfinished, PathBuf),
}

/// An incomplete file, which a signal removes too.
#[derive(Debug)]
struct Unfinished(Option<NamedTempFile>);

impl Drop for Unfinished {
    fn drop(&mut self) {
        if let Some(file) = self.0.take() {
            let mut unfinished = unfinished();
            unfinished.remove(file.path());
            drop(file);
        }
    }
}

impl Output {
    /// Starts an output with the final path `path`.
    ///
    /// # Errors
    /// It cannot be created.
    pub fn create(path: &Path) -> io::Result<Output> {
        let target = Target::new(path)?;
        target.check()?;
        let destination = match target {
            Target::Descriptor(file) => Destination::Direct(file),
            Target::Direct(path) => Destination::Direct(OpenOptions::new().write(true).open(path)?),
            Target::Regular { path, before } => Destination::Beside(Unfinished::beside(&path, before.as_ref())?, path),
        };
        Ok(Output { destination, is_new: false })
    }

    /// Starts an output that replaces no file: if the file exists by the time of [`Output::persist`], it is kept and this is an error.
    ///
    /// # Errors
    /// It cannot be created.
    pub fn create_new(path: &Path) -> io::Result<Output> {
        Ok(Output { is_new: true, ..Output::create(path)? })
    }

    fn file(&mut self) -> &mut File {
        match &mut self.destination {
            Destination::Direct(file) => file,
            Destination::Beside(unfinished, _) => {
                unfinished.0.as_mut().expect("some until it is persisted").as_file_mut()
            }
        }
    }

    /// Writes all data to the disk, still beside the final path.
    ///
    /// # Errors
    /// They cannot be written.
    pub fn complete(&mut self) -> io::Result<()> {
        match self.destination {
            // Devices and pipes return an error for `sync_all`.
            Destination::Direct(_) => self.file().flush(),
            Destination::Beside(..) => self.file().sync_all(),
        }
    }

    /// Moves the complete file to its final path.
    ///
    /// # Errors
    /// It cannot be moved; then the previous file is kept.
    pub fn persist(mut self) -> io::Result<()> {
        self.complete()?;
        let Destination::Beside(unfinished_file, path) = &mut self.destination else { return Ok(()) };
        let file = unfinished_file.0.take().expect("some until it is persisted");
        let mut unfinished = unfinished();
        unfinished.remove(file.path());
        let moved = if self.is_new { file.persist_noclobber(&*path) } else { file.persist(&*path) };
        moved.map(drop).map_err(|error| match error.error.kind() {
            kind @ io::ErrorKind::AlreadyExists => {
                let path = path.display();
                io::Error::new(
                    kind,
                    format!("{path}: expected no file, but another process has written it meanwhile; it is kept"),
                )
            }
            _ => error.error,
        })
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file().flush()
    }
}

impl Unfinished {
    /// Starts a file beside `path`, with the permissions of the previous file.
    fn beside(path: &Path, before: Option<&Metadata>) -> io::Result<Unfinished> {
        watch()?;
        let prefix = prefix(path.file_name().unwrap_or_default());
        let mut builder = tempfile::Builder::new();
        builder.prefix(&prefix).suffix(SUFFIX).permissions(Permissions::from_mode(MODE));
        let file = {
            let mut unfinished = unfinished();
            let file = builder.tempfile_in(parent(path))?;
            unfinished.add(file.path());
            Unfinished(Some(file))
        };
        if let (Some(before), Some(file)) = (before, &file.0) {
            let now = file.as_file().metadata()?;
            if (before.uid(), before.gid()) != (now.uid(), now.gid()) {
                // Only root may change the owner; the user's own file is accepted.
                let _ = fchown(file.as_file(), Some(before.uid()), Some(before.gid()));
            }
            file.as_file().set_permissions(before.permissions())?;
        }
        Ok(file)
    }
}

fn prefix(name: &OsStr) -> OsString {
    let bytes = name.as_bytes();
    let mut prefix = bytes[..bytes.len().min(NAME_BYTES)].to_vec();
    prefix.push(b'.');
    OsString::from_vec(prefix)
}

/// Writes a complete file.
///
/// # Errors
/// It cannot be written; then the previous file is kept.
pub fn write_whole(path: &Path, content: impl AsRef<[u8]>) -> io::Result<()> {
    let mut output = Output::create(path)?;
    output.write_all(content.as_ref())?;
    output.persist()
}

/// Moves several outputs to their final paths when all are complete.
///
/// # Errors
/// One cannot be written; then none is moved. If a rename fails after others (the directory was removed), those before it
/// are complete.
pub fn persist_all(outputs: impl IntoIterator<Item = Output>) -> io::Result<()> {
    let mut outputs: Vec<Output> = outputs.into_iter().collect();
    outputs.iter_mut().try_for_each(Output::complete)?;
    outputs.into_iter().try_for_each(Output::persist)
}
