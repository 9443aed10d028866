//! Destination of an output, with symlinks resolved.

use std::fs::{self, File, Metadata};
use std::io::{self, ErrorKind, stderr, stdout};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use nix::unistd::{AccessFlags, access};

/// Device and inode of a file: the same for every path, hard link and symlink.
pub(crate) type FileId = (u64, u64);

/// Largest number of symlinks to a missing file that are followed, as in Linux.
const MAX_SYMLINKS: usize = 40;

pub(crate) fn file_id(metadata: &Metadata) -> FileId {
    (metadata.dev(), metadata.ino())
}

#[derive(Debug)]
pub(crate) enum Target {
    /// Standard output or standard error: `-`, or the path of their file.
    Descriptor(File),
    /// A device or a pipe, which is written directly.
    Direct(PathBuf),
    /// A regular file, with the metadata of the previous one.
    Regular { path: PathBuf, before: Option<Metadata> },
}

impl Target {
    pub fn new(path: &Path) -> io::Result<Target> {
        Target::within(path, MAX_SYMLINKS)
    }

    fn within(path: &Path, symlinks: usize) -> io::Result<Target> {
        if path == Path::new("-") {
            return Ok(Target::Descriptor(duplicate(stdout().as_fd())?));
        }
        match fs::metadata(path) {
            Ok(metadata) if metadata.is_dir() => Err(ErrorKind::IsADirectory.into()),
            Ok(metadata) => {
                for open in [stdout().as_fd(), stderr().as_fd()] {
                    let open = duplicate(open)?;
                    if open.metadata().is_ok_and(|open| file_id(&open) == file_id(&metadata)) {
                        return Ok(Target::Descriptor(open));
                    }
                }
                match metadata.is_file() {
                    true => Ok(Target::Regular { path: fs::canonicalize(path)?, before: Some(metadata) }),
                    false => Ok(Target::Direct(path.to_owned())),
                }
            }
            Err(error) if error.kind() == ErrorKind::NotFound => match (fs::read_link(path), symlinks) {
                (Ok(_), 0) => Err(io::Error::other("too many symlinks")),
                (Ok(target), _) => Target::within(&parent(path).join(target), symlinks - 1),
                (Err(_), _) => {
                    let name = path.file_name().filter(|_| !path.as_os_str().as_bytes().ends_with(b"/"));
                    let name = name.ok_or(ErrorKind::InvalidFilename)?;
                    Ok(Target::Regular { path: fs::canonicalize(parent(path))?.join(name), before: None })
                }
            },
            Err(error) => Err(error),
        }
    }

    /// Checks that it may be written.
    pub fn check(&self) -> io::Result<()> {
        match self {
            Target::Descriptor(_) => Ok(()),
            Target::Direct(path) => Ok(access(path, AccessFlags::W_OK)?),
            Target::Regular { path, before } => {
                if before.is_some() {
                    access(path, AccessFlags::W_OK)?;
                }
                // The file is written beside its final path.
                Ok(access(parent(path), AccessFlags::W_OK | AccessFlags::X_OK)?)
            }
        }
    }
}

pub(crate) fn parent(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

pub(crate) fn duplicate(descriptor: BorrowedFd) -> io::Result<File> {
    Ok(File::from(descriptor.try_clone_to_owned()?))
}
