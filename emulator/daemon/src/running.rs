//! Registry of running emulators: each holds a locked file that describes it, so that clients find it.
//!
//! The files are in a directory that only the user can access. An unlocked file was left by an emulator that was killed;
//! the next reader removes it.

use std::fmt;
use std::fs::{self, DirBuilder, File, OpenOptions, TryLockError};
use std::io::{self, BufReader, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use nix::unistd::geteuid;
use serde::{Deserialize, Serialize};

/// Suffix of the files.
const SUFFIX: &str = ".json";
/// Maximum length of a file that is read, byte.
const MAX_LENGTH: u64 = 64 * 1024;

/// A running emulator.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Running {
    /// Address of its control interface; `None` without one.
    pub control: Option<String>,
    /// Its links.
    pub links: Vec<RunningLink>,
    /// Its process.
    pub pid: u32,
}

/// A link of a running emulator, as in its ready line.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunningLink {
    /// Path, interface and base, or HOST:PORT.
    pub address: String,
    /// Transport.
    pub kind: String,
}

impl fmt::Display for RunningLink {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.kind, self.address)
    }
}

/// The directory of the files cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RunningError {
    /// It cannot be created or read.
    #[error("{0}: cannot be used: {1}; expected a directory in which running emulators are found")]
    Directory(PathBuf, io::Error),
    /// Other users have access to it.
    #[error("{0}: expected a directory of this user alone (mode 700), got another; remove it, or set XDG_RUNTIME_DIR")]
    NotOwn(PathBuf),
}

impl fmt::Display for Running {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let links: Vec<String> = self.links.iter().map(RunningLink::to_string).collect();
        let control = self.control.as_ref().map_or("off".to_owned(), |address| format!("http://{address}/"));
        write!(f, "process {}: {}; control {control}", self.pid, links.join(", "))
    }
}

impl Running {
    /// True if it has the link `name`, as in its ready line (`can vcan0 1A0`) or as an argument of `geu send`: any path to it,
    /// `vcan0`, `vcan0:1A0`, `tcp:HOST:PORT`.
    pub fn has_link(&self, name: &str) -> bool {
        let path = fs::canonicalize(name).ok();
        self.links.iter().any(|RunningLink { address, kind }| {
            // The address of a CAN interface ends with its base, that of a serial port with its rate.
            let device = match kind.as_str() {
                "can" | "serial" => address.rsplit_once(' ').map_or(address.as_str(), |(device, _)| device),
                _ => address,
            };
            [address, device, &address.replace(' ', ":"), &format!("{kind} {address}"), &format!("{kind}:{address}")]
                .contains(&name)
                || path.is_some() && path == fs::canonicalize(device).ok()
        })
    }
}

/// The file of this emulator; dropping it removes the file.
#[derive(Debug)]
pub struct Registration {
    path: PathBuf,
    /// Locked.
    _file: File,
}

impl Drop for Registration {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.path);
    }
}

/// `$XDG_RUNTIME_DIR/geu`, else `/tmp/geu-UID`.
fn directory() -> PathBuf {
    let runtime = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from).filter(|path| path.is_dir());
    runtime.map_or_else(|| format!("/tmp/geu-{}", geteuid()).into(), |runtime| runtime.join("geu"))
}

/// Registers this emulator until the returned registration is dropped.
///
/// # Errors
/// A directory that cannot be used.
pub fn register(running: &Running) -> Result<Registration, RunningError> {
    register_in(&directory(), running)
}

/// The running emulators of this user, sorted by process.
///
/// # Errors
/// A directory that cannot be used; a missing one has no emulators.
pub fn all() -> Result<Vec<Running>, RunningError> {
    all_in(&directory())
}

/// True if the directory exists; an error if other users have access to it.
fn exists(directory: &Path) -> Result<bool, RunningError> {
    match fs::symlink_metadata(directory) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(RunningError::Directory(directory.to_owned(), error)),
        Ok(found) => {
            let is_own = found.uid() == geteuid().as_raw() && found.permissions().mode() & 0o077 == 0;
            if found.is_dir() && is_own { Ok(true) } else { Err(RunningError::NotOwn(directory.to_owned())) }
        }
    }
}

fn register_in(directory: &Path, running: &Running) -> Result<Registration, RunningError> {
    let fail = |error| RunningError::Directory(directory.to_owned(), error);
    match DirBuilder::new().mode(0o700).create(directory) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(fail(error)),
        _ => exists(directory)?,
    };
    // Process numbers are reused, also in containers that share the directory.
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let name = format!("{}-{}", running.pid, since.as_nanos());
    // Renamed once it is locked: readers remove unlocked files.
    let (new, path) = (directory.join(format!(".{name}")), directory.join(name + SUFFIX));
    let make = || {
        let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&new)?;
        file.lock()?;
        file.write_all(&serde_json::to_vec(running)?)?;
        fs::rename(&new, &path)?;
        Ok(file)
    };
    match make() {
        Ok(file) => Ok(Registration { path: path.clone(), _file: file }),
        Err(error) => {
            let _ = fs::remove_file(&new);
            Err(fail(error))
        }
    }
}

fn all_in(directory: &Path) -> Result<Vec<Running>, RunningError> {
    if !exists(directory)? {
        return Ok(Vec::new());
    }
    let entries = fs::read_dir(directory).map_err(|error| RunningError::Directory(directory.to_owned(), error))?;
    let names = entries.flatten().filter(|entry| entry.file_name().to_string_lossy().ends_with(SUFFIX));
    let mut all: Vec<Running> = names.filter_map(|entry| alive(&entry.path())).collect();
    all.sort_by_key(|running| running.pid);
    Ok(all)
}

/// The emulator of a file; removes the file if the emulator no longer runs.
fn alive(path: &Path) -> Option<Running> {
    let file = File::open(path).ok()?;
    // Shared, as other readers may try at the same time.
    match file.try_lock_shared() {
        Err(TryLockError::WouldBlock) => {}
        Ok(()) => {
            let _ = fs::remove_file(path);
            return None;
        }
        Err(TryLockError::Error(_)) => return None,
    }
    serde_json::from_reader(BufReader::new(file.take(MAX_LENGTH))).ok()
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    fn running(pid: u32, (kind, address): (&str, &str)) -> Running {
        let link = RunningLink { kind: kind.to_owned(), address: address.to_owned() };
        Running { pid, links: vec![link], control: Some("127.0.0.1:8470".to_owned()) }
    }

    #[test]
    fn a_registered_emulator_is_found_until_dropped() {
        let parent = tempfile::tempdir().expect("a directory");
        let directory = parent.path().join("geu");
        assert_eq!(all_in(&directory).expect("none yet"), []);
        let (one, other) = (running(7, ("pty", "/tmp/a b")), running(3, ("can", "vcan0")));
        let first = register_in(&directory, &one).expect("registered");
        let second = register_in(&directory, &other).expect("registered");
        assert_eq!(all_in(&directory).expect("two"), [other.clone(), one.clone()]);
        drop(second);
        assert_eq!(all_in(&directory).expect("one"), [one]);
        drop(first);
        assert_eq!(all_in(&directory).expect("none"), []);
        assert_eq!(fs::read_dir(&directory).expect("it is there").count(), 0, "no file remains");
    }

    #[test]
    fn the_file_of_a_killed_emulator_is_removed() {
        let parent = tempfile::tempdir().expect("a directory");
        let directory = parent.path().join("geu");
        let lives = register_in(&directory, &running(1, ("tcp", "127.0.0.1:4700"))).expect("registered");
        let left = directory.join("2-0.json");
        fs::write(&left, serde_json::to_vec(&running(2, ("tcp", "127.0.0.1:4701"))).expect("JSON")).expect("written");
        let pids: Vec<u32> = all_in(&directory).expect("one").iter().map(|running| running.pid).collect();
        assert_eq!(pids, [1]);
        assert!(!left.exists());
        assert!(lives.path.exists());
    }

    #[test]
    fn a_directory_with_access_by_others_is_rejected() {
        let parent = tempfile::tempdir().expect("a directory");
        let (open, linked) = (parent.path().join("open"), parent.path().join("linked"));
        DirBuilder::new().mode(0o700).create(&open).expect("made");
        symlink(&open, &linked).expect("linked");
        fs::set_permissions(&open, fs::Permissions::from_mode(0o770)).expect("opened");
        for directory in [&open, &linked] {
            let rejected = register_in(directory, &running(1, ("tcp", "a:1"))).expect_err("not its own").to_string();
            assert!(rejected.contains("mode 700"), "{rejected}");
            assert!(all_in(directory).is_err());
        }
    }

    #[test]
    fn a_link_is_found_by_ready_line_address_or_any_path() {
        let parent = tempfile::tempdir().expect("a directory");
        let (pty, beside) = (parent.path().join("geu0"), parent.path().join("beside"));
        fs::write(&pty, "").expect("a file in place of a pty");
        symlink(&pty, &beside).expect("linked");
        let own = running(1, ("pty", pty.to_str().expect("text")));
        for name in [pty.to_str(), beside.to_str(), Some(&*format!("pty {}", pty.display()))] {
            assert!(own.has_link(name.expect("text")), "{name:?}");
        }
        assert!(!own.has_link("geu1") && !own.has_link("pty"));
        assert!(running(1, ("tcp", "127.0.0.1:4700")).has_link("tcp:127.0.0.1:4700"));
        for name in ["vcan0", "vcan0:1A0", "can vcan0 1A0"] {
            assert!(running(1, ("can", "vcan0 1A0")).has_link(name), "{name}");
        }
    }
}
