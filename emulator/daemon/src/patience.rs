//! How long readers are waited for, and the end of a run, which cuts every wait short.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering::Relaxed};
use std::time::{Duration, Instant};

use crate::cadence::now_ns;

/// Once a run is asked to end, readers have so long to take what is sent, all of them together.
pub(crate) const LAST_WORDS: Duration = Duration::from_millis(300);

/// Whether, and when, a run was asked to end.
#[derive(Debug, Default)]
pub(crate) struct Stop {
    /// On the monotonic clock, ns; 0 where it was not asked.
    asked_ns: AtomicI64,
}

impl Stop {
    /// Asks the run to end.
    pub fn ask(&self) {
        self.asked_ns.store(now_ns(), Relaxed);
    }

    /// Whether the run was asked to end.
    pub fn is_asked(&self) -> bool {
        self.asked_ns.load(Relaxed) != 0
    }

    /// Whether readers have had their last words.
    fn is_overdue(&self) -> bool {
        let asked_ns = self.asked_ns.load(Relaxed);
        asked_ns != 0 && now_ns() - asked_ns >= LAST_WORDS.as_nanos() as i64
    }
}

/// How long a reader without room is waited for.
#[derive(Debug, Clone)]
pub(crate) struct Patience {
    limit: Duration,
    stop: Arc<Stop>,
}

impl Patience {
    /// So long, and never beyond the end of the run.
    pub fn new(limit: Duration, stop: &Arc<Stop>) -> Patience {
        Patience { limit, stop: stop.clone() }
    }

    /// Whether nobody is waited for.
    pub fn is_none(&self) -> bool {
        self.limit.is_zero()
    }

    /// Whether a reader that is waited for since then is waited for no longer.
    pub fn is_over(&self, since: Instant) -> bool {
        since.elapsed() >= self.limit || self.stop.is_overdue()
    }
}
