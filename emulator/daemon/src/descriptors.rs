//! Limit of file descriptors: raised at the start, so that a lack of them later affects clients and never the unit.

use nix::sys::resource::{Resource, getrlimit, setrlimit};

/// Required number: links, a recording, the control interface, and some clients over TCP.
const NEEDED: u64 = 128;
/// Number reserved from clients over TCP: for 48 connections of the control interface, and for links that are reopened.
const SPARE: u64 = 64;

/// The limit of the process is too low.
#[derive(Debug, thiserror::Error)]
#[error("this process may have {0} descriptors, expected {NEEDED} at least; raise the limit: ulimit -n 1024")]
pub struct TooFew(u64);

/// Raises the limit to its maximum.
///
/// # Errors
/// A maximum below the needs of a run.
pub(crate) fn take_all() -> Result<(), TooFew> {
    let Ok((_, hard)) = getrlimit(Resource::RLIMIT_NOFILE) else { return Ok(()) };
    if hard < NEEDED {
        return Err(TooFew(hard));
    }
    // A refusal keeps the limit, which is checked below.
    let _ = setrlimit(Resource::RLIMIT_NOFILE, hard, hard);
    match limit() {
        limit if limit < NEEDED => Err(TooFew(limit)),
        _ => Ok(()),
    }
}

/// True if `descriptor`, a new one, is reserved: the kernel assigns the lowest free number.
pub(crate) fn is_scarce_beside(descriptor: i32) -> bool {
    descriptor as u64 >= limit().saturating_sub(SPARE)
}

fn limit() -> u64 {
    getrlimit(Resource::RLIMIT_NOFILE).map_or(u64::MAX, |(soft, _)| soft)
}
