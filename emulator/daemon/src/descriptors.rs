//! How many descriptors the process may have: asked for at the start, so that what is missing later is a client's place and
//! never the unit's.

use nix::sys::resource::{Resource, getrlimit, setrlimit};

/// Fewer than these are refused: links, a recording, the control interface, and some clients over TCP.
const NEEDED: u64 = 128;
/// Clients over TCP leave so many to everything else: 48 connections of the control interface, and what links open to
/// recover.
const SPARE: u64 = 64;

/// A process that may have too few.
#[derive(Debug, thiserror::Error)]
#[error("this process may have {0} descriptors, expected {NEEDED} at least; raise the limit: ulimit -n 1024")]
pub struct TooFew(u64);

/// Takes as many as the process may have.
///
/// # Errors
/// Fewer than a run needs.
pub(crate) fn take_all() -> Result<(), TooFew> {
    let Ok((_, hard)) = getrlimit(Resource::RLIMIT_NOFILE) else { return Ok(()) };
    if hard < NEEDED {
        return Err(TooFew(hard));
    }
    // Refused, the limit stays as it is, and `limit` says what it is.
    let _ = setrlimit(Resource::RLIMIT_NOFILE, hard, hard);
    match limit() {
        limit if limit < NEEDED => Err(TooFew(limit)),
        _ => Ok(()),
    }
}

/// Whether too few are left for others beside `descriptor`, which is new: the kernel gives the lowest number that is free.
pub(crate) fn is_scarce_beside(descriptor: i32) -> bool {
    descriptor as u64 >= limit().saturating_sub(SPARE)
}

fn limit() -> u64 {
    getrlimit(Resource::RLIMIT_NOFILE).map_or(u64::MAX, |(soft, _)| soft)
}
