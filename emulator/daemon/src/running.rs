//! Which emulators run: each keeps a file that it holds locked, so that clients find it by what runs.
//!
//! The files stand in a directory that belongs to the user alone. A file whose lock is free is left of an emulator that was
//! killed; whoever finds it takes it away.

use std::fmt;
use std::fs::{self, DirBuilder, File, OpenOptions, TryLockError};
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use nix::libc;
use serde_json::{Value, json};

/// How the name of a file ends.
const SUFFIX: &str = ".json";
/// No file is longer: more is not read.
const LONGEST: u64 = 64 * 1024;

/// A running emulator, as its file tells.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Running {
    /// Its process.
    pub pid: u32,
    /// Its links, kind and address, as in their ready lines.
    pub links: Vec<(String, String)>,
    /// Where its control interface listens; nothing where it has none.
    pub control: Option<String>,
}

/// A directory for the files that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RunningError {
    /// It cannot be made or read.
    #[error("{0}: cannot be used: {1}; expected a directory in which running emulators are found")]
    Directory(PathBuf, io::Error),
    /// Somebody else could put files there.
    #[error("{0}: expected a directory of this user alone (mode 700), got another; remove it, or set XDG_RUNTIME_DIR")]
    NotOwn(PathBuf),
}

impl fmt::Display for Running {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let links: Vec<String> = self.links.iter().map(|(kind, address)| format!("{kind} {address}")).collect();
        let control = self.control.as_ref().map_or("off".to_owned(), |address| format!("http://{address}/"));
        write!(f, "process {}: {}; control {control}", self.pid, links.join(", "))
    }
}

impl Running {
    /// Whether it has the link that `named` names, as in its ready line (`can vcan0 1A0`) or as `geu send` takes it: a path in
    /// any form, `vcan0`, `vcan0:1A0`, `tcp:HOST:PORT`.
    pub fn has_link(&self, named: &str) -> bool {
        let path = fs::canonicalize(named).ok();
        self.links.iter().any(|(kind, address)| {
            // Behind a CAN interface stands its base, behind a serial port its rate.
            let device = match kind.as_str() {
                "can" | "serial" => address.rsplit_once(' ').map_or(address.as_str(), |(device, _)| device),
                _ => address,
            };
            let is_path = || path.is_some() && path == fs::canonicalize(device).ok();
            [address.as_str(), device, &address.replace(' ', ":")].contains(&named)
                || [format!("{kind} {address}"), format!("{kind}:{address}")].iter().any(|form| form == named)
                || is_path()
        })
    }

    fn json(&self) -> Value {
        let links: Vec<Value> =
            self.links.iter().map(|(kind, address)| json!({ "kind": kind, "address": address })).collect();
        json!({ "pid": self.pid, "links": links, "control": self.control })
    }

    fn read(value: &Value) -> Option<Running> {
        let text = |value: &Value| value.as_str().map(str::to_owned);
        let links = value["links"].as_array()?.iter();
        let links = links.map(|link| Some((text(&link["kind"])?, text(&link["address"])?))).collect::<Option<_>>()?;
        Some(Running { pid: value["pid"].as_u64()?.try_into().ok()?, links, control: text(&value["control"]) })
    }
}

/// The file of this emulator, there for as long as this lives.
#[derive(Debug)]
pub struct Registration {
    path: PathBuf,
    /// Holds the lock.
    _file: File,
}

impl Drop for Registration {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.path);
    }
}

fn user() -> u32 {
    // SAFETY: has no argument, cannot fail and changes nothing.
    unsafe { libc::geteuid() }
}

/// `$XDG_RUNTIME_DIR/geu`, else `/tmp/geu-UID`.
fn directory() -> PathBuf {
    let runtime = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from).filter(|path| path.is_dir());
    runtime.map_or_else(|| format!("/tmp/geu-{}", user()).into(), |runtime| runtime.join("geu"))
}

/// Lets clients find this emulator until what is returned is dropped.
///
/// # Errors
/// A directory that cannot be used.
pub fn register(running: &Running) -> Result<Registration, RunningError> {
    register_in(&directory(), running)
}

/// The emulators of this user that run, by process.
///
/// # Errors
/// A directory that cannot be used; one that is not there has none.
pub fn all() -> Result<Vec<Running>, RunningError> {
    all_in(&directory())
}

/// Whether the directory is there; refused where it is not this user's alone.
fn is_there(directory: &Path) -> Result<bool, RunningError> {
    match fs::symlink_metadata(directory) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(RunningError::Directory(directory.to_owned(), error)),
        Ok(found) => {
            let is_own = found.uid() == user() && found.permissions().mode() & 0o077 == 0;
            if found.is_dir() && is_own { Ok(true) } else { Err(RunningError::NotOwn(directory.to_owned())) }
        }
    }
}

fn register_in(directory: &Path, running: &Running) -> Result<Registration, RunningError> {
    let fail = |error| RunningError::Directory(directory.to_owned(), error);
    match DirBuilder::new().mode(0o700).create(directory) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(fail(error)),
        _ => is_there(directory)?,
    };
    // Process numbers come again, also in containers that share the directory.
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let name = format!("{}-{}", running.pid, since.as_nanos());
    // Under another name until it is locked: whoever finds it unlocked takes it away.
    let (new, path) = (directory.join(format!(".{name}")), directory.join(name + SUFFIX));
    let make = || {
        let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&new)?;
        file.lock()?;
        file.write_all(running.json().to_string().as_bytes())?;
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
    if !is_there(directory)? {
        return Ok(Vec::new());
    }
    let entries = fs::read_dir(directory).map_err(|error| RunningError::Directory(directory.to_owned(), error))?;
    let names = entries.flatten().filter(|entry| entry.file_name().to_string_lossy().ends_with(SUFFIX));
    let mut all: Vec<Running> = names.filter_map(|entry| alive(&entry.path())).collect();
    all.sort_by_key(|running| running.pid);
    Ok(all)
}

/// What the file tells where its emulator lives; otherwise takes it away.
fn alive(path: &Path) -> Option<Running> {
    let file = File::open(path).ok()?;
    // A shared lock, which others who look may have at the same time.
    match file.try_lock_shared() {
        Err(TryLockError::WouldBlock) => {}
        Ok(()) => {
            let _ = fs::remove_file(path);
            return None;
        }
        Err(TryLockError::Error(_)) => return None,
    }
    let mut text = String::new();
    file.take(LONGEST).read_to_string(&mut text).ok()?;
    Running::read(&serde_json::from_str(&text).ok()?)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    fn running(pid: u32, link: (&str, &str)) -> Running {
        Running { pid, links: vec![(link.0.to_owned(), link.1.to_owned())], control: Some("127.0.0.1:8470".to_owned()) }
    }

    #[test]
    fn what_is_registered_is_found_until_it_is_dropped() {
        let room = tempfile::tempdir().expect("a directory");
        let directory = room.path().join("geu");
        assert_eq!(all_in(&directory).expect("none yet"), []);
        let (one, other) = (running(7, ("pty", "/tmp/a b")), running(3, ("can", "vcan0")));
        let first = register_in(&directory, &one).expect("registered");
        let second = register_in(&directory, &other).expect("registered");
        assert_eq!(all_in(&directory).expect("two"), [other.clone(), one.clone()]);
        drop(second);
        assert_eq!(all_in(&directory).expect("one"), [one]);
        drop(first);
        assert_eq!(all_in(&directory).expect("none"), []);
        assert_eq!(fs::read_dir(&directory).expect("it is there").count(), 0, "nothing is left");
    }

    #[test]
    fn a_file_of_an_emulator_that_was_killed_is_taken_away() {
        let room = tempfile::tempdir().expect("a directory");
        let directory = room.path().join("geu");
        let lives = register_in(&directory, &running(1, ("tcp", "127.0.0.1:4700"))).expect("registered");
        let left = directory.join("2-0.json");
        fs::write(&left, running(2, ("tcp", "127.0.0.1:4701")).json().to_string()).expect("written");
        let pids: Vec<u32> = all_in(&directory).expect("one").iter().map(|running| running.pid).collect();
        assert_eq!(pids, [1]);
        assert!(!left.exists());
        assert!(lives.path.exists());
    }

    #[test]
    fn a_directory_that_others_may_write_to_is_refused() {
        let room = tempfile::tempdir().expect("a directory");
        let (open, linked) = (room.path().join("open"), room.path().join("linked"));
        DirBuilder::new().mode(0o700).create(&open).expect("made");
        symlink(&open, &linked).expect("linked");
        fs::set_permissions(&open, fs::Permissions::from_mode(0o770)).expect("opened");
        for directory in [&open, &linked] {
            let refused = register_in(directory, &running(1, ("tcp", "a:1"))).expect_err("not its own").to_string();
            assert!(refused.contains("mode 700"), "{refused}");
            assert!(all_in(directory).is_err());
        }
    }

    #[test]
    fn a_link_is_named_by_its_ready_line_its_address_or_any_path_to_it() {
        let room = tempfile::tempdir().expect("a directory");
        let (pty, beside) = (room.path().join("geu0"), room.path().join("beside"));
        fs::write(&pty, "").expect("a file in place of a pty");
        symlink(&pty, &beside).expect("linked");
        let own = running(1, ("pty", pty.to_str().expect("text")));
        for named in [pty.to_str(), beside.to_str(), Some(&*format!("pty {}", pty.display()))] {
            assert!(own.has_link(named.expect("text")), "{named:?}");
        }
        assert!(!own.has_link("geu1") && !own.has_link("pty"));
        assert!(running(1, ("tcp", "127.0.0.1:4700")).has_link("tcp:127.0.0.1:4700"));
        for named in ["vcan0", "vcan0:1A0", "can vcan0 1A0"] {
            assert!(running(1, ("can", "vcan0 1A0")).has_link(named), "{named}");
        }
    }
}
