//! SIGINT, SIGTERM and SIGHUP while files are written: what is not whole is removed, and the process ends with 128 + the
//! signal's number, 130 or 143.
//!
//! Where a command asked for it, the first signal asks it to end by itself, as one that follows a link does. Should it not,
//! the second ends the process, and what is not whole stays: those are rows that nobody can receive again.

use std::io;
use std::path::{Path, PathBuf};
use std::process::exit;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;

use nix::sys::signal::{SaFlags, SigAction, SigHandler, SigSet, Signal, sigaction};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

/// Whether a command ends by itself at the first signal.
static ENDS_ITSELF: AtomicBool = AtomicBool::new(false);
static STOP: AtomicBool = AtomicBool::new(false);

/// Set by the first SIGINT, SIGTERM or SIGHUP from now on, for a command that then ends by itself.
///
/// # Errors
/// When signals cannot be watched.
pub fn stop_flag() -> io::Result<&'static AtomicBool> {
    ENDS_ITSELF.store(true, Ordering::Relaxed);
    watch()?;
    Ok(&STOP)
}

/// Files that are not whole. Whoever holds them keeps a signal from ending the process meanwhile.
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
            // Held to the end, so that no other file begins.
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

/// Whether whoever started the process wants this signal ignored, as nohup does.
fn is_ignored(signal: Signal) -> io::Result<bool> {
    let ignore = SigAction::new(SigHandler::SigIgn, SaFlags::empty(), SigSet::empty());
    // SAFETY: ignoring runs no code of ours, and neither does what was there, which is put back.
    let before = unsafe { sigaction(signal, &ignore) }?;
    if matches!(before.handler(), SigHandler::SigIgn) {
        return Ok(true);
    }
    // SAFETY: as above.
    unsafe { sigaction(signal, &before) }?;
    Ok(false)
}

/// Makes a write beyond the limit on the size of files (`ulimit -f`) an error, as a full disk is, in place of a signal that
/// ends the process.
pub fn ignore_file_size_signal() {
    let ignore = SigAction::new(SigHandler::SigIgn, SaFlags::empty(), SigSet::empty());
    // SAFETY: ignoring runs no code.
    let _ = unsafe { sigaction(Signal::SIGXFSZ, &ignore) };
}
