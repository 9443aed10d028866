//! A file that is written beside its place and renamed when it is whole.

use std::ffi::{OsStr, OsString};
use std::fs::{File, Metadata, OpenOptions, Permissions};
use std::io::{self, Write};
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::os::unix::fs::{MetadataExt, PermissionsExt, fchown};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use crate::interruption::{unfinished, watch};
use crate::place::{Place, parent};

/// How the name of a file ends that is not whole.
const SUFFIX: &str = ".partial";
/// Bytes of its own name that it begins with: a file system takes 255, and some are added.
const NAME_BYTES: usize = 200;
/// Of a new file, before the process's mask.
const MODE: u32 = 0o666;

/// An output. Dropped before [`Output::persist`], it leaves what was there.
///
/// A file is written as `NAME.….partial` beside its place. The file that it replaces keeps its permissions and, where that
/// may be done, its owner; a symlink stays and what it leads to is replaced. Standard output (`-`), devices and pipes are
/// written as they stand.
#[derive(Debug)]
pub struct Output {
    destination: Destination,
}

#[derive(Debug)]
enum Destination {
    AsItStands(File),
    Beside(Unfinished, PathBuf),
}

/// A file that is not whole, which a signal removes too.
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
    /// Begins one that will be at `path`.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn create(path: &Path) -> io::Result<Output> {
        let place = Place::of(path)?;
        place.check()?;
        let destination = match place {
            Place::Descriptor(file) => Destination::AsItStands(file),
            Place::AsItStands(path) => Destination::AsItStands(OpenOptions::new().write(true).open(path)?),
            Place::Regular { path, before } => Destination::Beside(Unfinished::beside(&path, before.as_ref())?, path),
        };
        Ok(Output { destination })
    }

    fn file(&mut self) -> &mut File {
        match &mut self.destination {
            Destination::AsItStands(file) => file,
            Destination::Beside(unfinished, _) => {
                unfinished.0.as_mut().expect("there until it is persisted").as_file_mut()
            }
        }
    }

    /// Has all that was written on the disk, still beside its place.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn complete(&mut self) -> io::Result<()> {
        match self.destination {
            // Devices and pipes have nothing to wait for, and say so by an error.
            Destination::AsItStands(_) => self.file().flush(),
            Destination::Beside(..) => self.file().sync_all(),
        }
    }

    /// Puts it in its place, whole.
    ///
    /// # Errors
    /// When it cannot be; what was there is there still.
    pub fn persist(mut self) -> io::Result<()> {
        self.complete()?;
        let Destination::Beside(unfinished_file, path) = &mut self.destination else { return Ok(()) };
        let file = unfinished_file.0.take().expect("there until it is persisted");
        let mut unfinished = unfinished();
        unfinished.remove(file.path());
        file.persist(path).map(drop).map_err(|error| error.error)
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
    /// Begins a file beside `path`, with the permissions of what is there.
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
                // Only root may give files away; a file of the user's own is no failure.
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

/// Writes a whole file.
///
/// # Errors
/// When it cannot be; what was there is there still.
pub fn write_whole(path: &Path, content: impl AsRef<[u8]>) -> io::Result<()> {
    let mut output = Output::create(path)?;
    output.write_all(content.as_ref())?;
    output.persist()
}

/// Puts several in their places when all are whole.
///
/// # Errors
/// When one cannot be written; then none is there. A rename that fails behind others (the directory is gone by then) leaves
/// those before it, each whole.
pub fn persist_all(outputs: impl IntoIterator<Item = Output>) -> io::Result<()> {
    let mut outputs: Vec<Output> = outputs.into_iter().collect();
    outputs.iter_mut().try_for_each(Output::complete)?;
    outputs.into_iter().try_for_each(Output::persist)
}
