//! Where an output goes: what its path names, and where symlinks lead.

use std::fs::{self, File, Metadata};
use std::io::{self, ErrorKind, stderr, stdout};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use nix::unistd::{AccessFlags, access};

/// A file, by device and inode: the same by every path, hard link and symlink.
pub(crate) type FileId = (u64, u64);

/// Symlinks that are followed where the last leads to nothing; as many as Linux follows.
const MAX_SYMLINKS: usize = 40;

pub(crate) fn file_id(metadata: &Metadata) -> FileId {
    (metadata.dev(), metadata.ino())
}

#[derive(Debug)]
pub(crate) enum Place {
    /// Standard output or standard error: `-`, or a path to where one of them goes.
    Descriptor(File),
    /// A device or a pipe, which is written as it stands.
    AsItStands(PathBuf),
    /// A regular file, with what is there now.
    Regular { path: PathBuf, before: Option<Metadata> },
}

impl Place {
    pub fn of(path: &Path) -> io::Result<Place> {
        Place::within(path, MAX_SYMLINKS)
    }

    fn within(path: &Path, symlinks: usize) -> io::Result<Place> {
        if path == Path::new("-") {
            return Ok(Place::Descriptor(duplicate(stdout().as_fd())?));
        }
        match fs::metadata(path) {
            Ok(metadata) if metadata.is_dir() => Err(ErrorKind::IsADirectory.into()),
            Ok(metadata) => {
                for open in [stdout().as_fd(), stderr().as_fd()] {
                    let open = duplicate(open)?;
                    if open.metadata().is_ok_and(|open| file_id(&open) == file_id(&metadata)) {
                        return Ok(Place::Descriptor(open));
                    }
                }
                match metadata.is_file() {
                    true => Ok(Place::Regular { path: fs::canonicalize(path)?, before: Some(metadata) }),
                    false => Ok(Place::AsItStands(path.to_owned())),
                }
            }
            Err(error) if error.kind() == ErrorKind::NotFound => match (fs::read_link(path), symlinks) {
                (Ok(_), 0) => Err(io::Error::other("too many symlinks")),
                (Ok(target), _) => Place::within(&parent(path).join(target), symlinks - 1),
                (Err(_), _) => {
                    let name = path.file_name().filter(|_| !path.as_os_str().as_bytes().ends_with(b"/"));
                    let name = name.ok_or(ErrorKind::InvalidFilename)?;
                    Ok(Place::Regular { path: fs::canonicalize(parent(path))?.join(name), before: None })
                }
            },
            Err(error) => Err(error),
        }
    }

    /// Whether it may be written; said before there is anything to write.
    pub fn check(&self) -> io::Result<()> {
        match self {
            Place::Descriptor(_) => Ok(()),
            Place::AsItStands(path) => Ok(access(path, AccessFlags::W_OK)?),
            Place::Regular { path, before } => {
                if before.is_some() {
                    access(path, AccessFlags::W_OK)?;
                }
                // It is written beside its place.
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
