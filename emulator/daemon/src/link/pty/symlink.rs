//! The symlink at which clients find the pty, and the lock of its owner.
//!
//! `PATH.lock` is beside `PATH`: the emulator that created the symlink holds the lock during its lifetime, and writes the target
//! of the symlink into it. So of two emulators that start together one gets the path, and the symlink of a killed emulator is
//! recognised, even if the number of its pty is in use again.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File, OpenOptions, Permissions, TryLockError};
use std::io::{self, Write};
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt, PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use nix::libc::{O_NOFOLLOW, O_NONBLOCK};

use super::super::error::LinkError;
use crate::host;

/// First bytes of a lock; any other file is not a lock of an emulator.
const MARK: &str = "geu pty ";
/// Maximum length of a lock: longer than any name of a pty.
const MAX_LOCK_BYTES: usize = 4096;

/// The symlink; removed on drop if it is still this one.
pub(super) struct Symlink {
    path: PathBuf,
    target: Mutex<PathBuf>,
    lock: Lock,
}

impl Symlink {
    /// Creates it in one step, and replaces a link that leads nowhere, to a pty that is ours now, or that a killed emulator left.
    pub fn create(path: &Path, target: &Path) -> Result<Symlink, LinkError> {
        let name = || path.display().to_string();
        let fail = |error| LinkError::Pty(name(), error);
        if let Ok(metadata) = path.symlink_metadata() {
            let kind = metadata.file_type();
            if kind.is_dir() {
                return Err(LinkError::PathTaken(name(), "a directory"));
            }
            if !kind.is_symlink() {
                return Err(LinkError::PathTaken(name(), if kind.is_file() { "a file" } else { "a device or socket" }));
            }
        }
        let lock = Lock::acquire(path)?;
        match fs::read_link(path) {
            Ok(old) if old != target && Some(&old) != lock.led_to.as_ref() && path.exists() => {
                return Err(LinkError::PathBusy(name(), old.display().to_string()));
            }
            _ => {}
        }
        let mut made = Symlink { path: path.to_owned(), target: Mutex::new(PathBuf::new()), lock };
        made.lock.write(target).and_then(|()| made.make(target)).map_err(fail)?;
        made.target = Mutex::new(target.to_owned());
        Ok(made)
    }

    /// Creates it under a temporary name and renames it: the path always has a symlink.
    fn make(&self, target: &Path) -> io::Result<()> {
        let (directory, name) = parts(&self.path)?;
        let made = tempfile::Builder::new().prefix(&name).make_in(directory, |path| symlink(target, path))?;
        made.persist(&self.path).map(drop).map_err(|error| error.error)
    }

    fn is_ours(&self) -> bool {
        fs::read_link(&self.path).is_ok_and(|target| target == self.target())
    }

    /// Changes the target, unless the path has another link by now.
    pub fn lead_to(&self, target: &Path) -> io::Result<()> {
        if self.is_ours() {
            self.lock.write(target)?;
            self.make(target)?;
        }
        *host::lock(&self.target) = target.to_owned();
        Ok(())
    }

    /// Target of the symlink.
    pub fn target(&self) -> PathBuf {
        host::lock(&self.target).clone()
    }
}

impl Drop for Symlink {
    fn drop(&mut self) {
        if self.is_ours() {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// The directory of a path, and the prefix of names beside it.
fn parts(path: &Path) -> io::Result<(&Path, OsString)> {
    let mut name = path.file_name().ok_or(io::ErrorKind::InvalidInput)?.to_owned();
    name.push(".");
    let directory = path.parent().filter(|directory| !directory.as_os_str().is_empty());
    Ok((directory.unwrap_or(Path::new(".")), name))
}

/// A file that is locked while an emulator uses the path.
struct Lock {
    path: PathBuf,
    file: File,
    /// Target of the symlink of a killed emulator.
    led_to: Option<PathBuf>,
}

impl Lock {
    fn acquire(link: &Path) -> Result<Lock, LinkError> {
        let name = link.display().to_string();
        let fail = |error| LinkError::Pty(name.clone(), error);
        let (directory, mut file_name) = parts(link).map_err(fail)?;
        file_name.push("lock");
        let path = directory.join(&file_name);
        loop {
            let file = match open_lock(&path) {
                // Not created by name: a directory with the sticky bit refuses that for a file of others, and another
                // emulator could lock the file before its mark is written.
                Err(error) if error.kind() == io::ErrorKind::NotFound => {
                    match create_lock(directory, &file_name, &path) {
                        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
                        created => return Ok(Lock { file: created.map_err(fail)?, path, led_to: None }),
                    }
                }
                opened => opened.map_err(fail)?,
            };
            let own = file.metadata().map_err(fail)?;
            let is_lock = own.is_file() && read_mark(&file).is_some();
            match file.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => {
                    return Err(LinkError::PathBusy(name, format!("a pty of the owner of {}", path.display())));
                }
                Err(TryLockError::Error(error)) => return Err(fail(error)),
            }
            // The previous owner may have removed it meanwhile: then the locked file is invisible to others.
            let seen = path.symlink_metadata();
            if !seen.is_ok_and(|seen| (seen.dev(), seen.ino()) == (own.dev(), own.ino())) {
                continue;
            }
            if !is_lock {
                return Err(LinkError::PathTaken(path.display().to_string(), "a file that is no lock of an emulator"));
            }
            let led_to = read_mark(&file).filter(|target| !target.as_os_str().is_empty());
            return Ok(Lock { path, file, led_to });
        }
    }

    /// Writes the target of the symlink.
    fn write(&self, target: &Path) -> io::Result<()> {
        let text = format!("{MARK}{}\n", target.display());
        // Overwrites: that works on a full disk.
        self.file.write_all_at(text.as_bytes(), 0)?;
        self.file.set_len(text.len() as u64)
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        // While it is locked, so that no other emulator has it yet.
        let _ = fs::remove_file(&self.path);
    }
}

/// Opens it without waiting for the other end of a FIFO.
fn open_lock(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).write(true).custom_flags(O_NOFOLLOW | O_NONBLOCK).open(path)
}

/// Creates a lock that is held and marked before it has its name.
fn create_lock(directory: &Path, prefix: &OsStr, path: &Path) -> io::Result<File> {
    let mut created =
        tempfile::Builder::new().prefix(prefix).permissions(Permissions::from_mode(0o644)).tempfile_in(directory)?;
    created.write_all(MARK.as_bytes())?;
    created.as_file().try_lock()?;
    Ok(created.persist_noclobber(path)?)
}

/// Target of the symlink of the emulator that wrote the lock; `None` for another file.
fn read_mark(file: &File) -> Option<PathBuf> {
    let mut bytes = [0; MAX_LOCK_BYTES];
    let length = file.read_at(&mut bytes, 0).ok()?;
    let text = str::from_utf8(&bytes[..length]).ok()?;
    text.strip_prefix(MARK).map(|target| PathBuf::from(target.trim_end()))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::thread;

    use super::*;

    #[test]
    fn a_lock_has_one_owner_and_is_recognised_by_all_others() {
        let directory = tempfile::tempdir().unwrap();
        let link = directory.path().join("geu0");
        let (holders, times_held) = (AtomicUsize::new(0), AtomicUsize::new(0));
        thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    for _ in 0..500 {
                        match Lock::acquire(&link) {
                            Ok(lock) => {
                                assert_eq!(holders.fetch_add(1, Ordering::SeqCst), 0, "one holds it");
                                times_held.fetch_add(1, Ordering::SeqCst);
                                holders.fetch_sub(1, Ordering::SeqCst);
                                drop(lock);
                            }
                            Err(error) => assert!(matches!(error, LinkError::PathBusy(..)), "{error}"),
                        }
                    }
                });
            }
        });
        assert!(times_held.into_inner() > 0);
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 0, "locks are removed");
    }
}
