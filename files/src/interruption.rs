//! SIGINT, SIGTERM and SIGHUP while files are written: incomplete files are removed, and the process ends with 128 + the
//! signal's number, 130 or 143.
//!
//! With [`stop_flag`], the first signal asks the command to end by itself, for example if it follows a link. The second
//! signal ends the process and keeps incomplete files, because their rows cannot be received again.

use std::io;
use std::path::{Path, PathBuf};
use std::process::exit;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;

use nix::sys::signal::{SaFlags, SigAction, SigHandler, SigSet, Signal, sigaction};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

/// True if the command ends by itself at the first signal.
static ENDS_ITSELF: AtomicBool = AtomicBool::new(false);
static STOP: AtomicBool = AtomicBool::new(false);

/// A flag that the first SIGINT, SIGTERM or SIGHUP sets; the command then ends by itself.
///
/// # Errors
/// Signals cannot be watched.
pub fn stop_flag() -> io::Result<&'static AtomicBool> {
    ENDS_ITSELF.store(true, Ordering::Relaxed);
    watch()?;
    Ok(&STOP)
}

/// Incomplete files. While they are locked, a signal does not end the process.
pub(crate) struct Unfinished {
    paths: Vec<PathBuf>,
    is_watched: bool,
}

static UNFINISHED: Mutex<Unfinished> = Mutex::new(Unfinished { paths: Vec::new(), is_watched: false });

pub(crate) fn unfinished() -> MutexGuard<'static, Unfinished> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Unfinished {
    pub fn add(&mut self, path: &Path) {
        self.paths.push(path.to_owned());
    }

    pub fn remove(&mut self, path: &Path) {
        self.paths.retain(|other| other != path);
    }
}

pub(crate) fn watch() -> io::Result<()> {
    let mut unfinished = unfinished();
    if unfinished.is_watched {
        return Ok(());
    }
    let mut signals = Signals::new([SIGINT, SIGTERM])?;
    if !is_ignored(Signal::SIGHUP)? {
        signals.add_signal(SIGHUP)?;
    }
    thread::Builder::new().name("signals".to_owned()).spawn(move || {
        for signal in signals.forever() {
            let ends_itself = ENDS_ITSELF.load(Ordering::Relaxed);
            if ends_itself && !STOP.swap(true, Ordering::Relaxed) {
                continue;
            }
            // Locked until the end, so that no other file is started.
            let unfinished = self::unfinished();
            for path in unfinished.paths.iter().filter(|_| !ends_itself) {
                let _ = std::fs::remove_file(path);
            }
            exit(128 + signal);
        }
    })?;
    unfinished.is_watched = true;
    Ok(())
}

/// True if the parent of the process set this signal to be ignored, as nohup does.
fn is_ignored(signal: Signal) -> io::Result<bool> {
    let ignore = SigAction::new(SigHandler::SigIgn, SaFlags::empty(), SigSet::empty());
    // SAFETY: ignoring runs no code of ours, nor does the previous action, which is restored.
    let before = unsafe { sigaction(signal, &ignore) }?;
    if matches!(before.handler(), SigHandler::SigIgn) {
        return Ok(true);
    }
    // SAFETY: as above.
    unsafe { sigaction(signal, &before) }?;
    Ok(false)
}

/// Makes a write beyond the limit of file sizes (`ulimit -f`) an error, like a full disk, in place of a fatal signal.
pub fn ignore_file_size_signal() {
    let ignore = SigAction::new(SigHandler::SigIgn, SaFlags::empty(), SigSet::empty());
    // SAFETY: ignoring runs no code.
    let _ = unsafe { sigaction(Signal::SIGXFSZ, &ignore) };
}
