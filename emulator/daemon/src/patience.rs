//! How long readers are waited for, and the end of a run, which cuts every wait short.

use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use tokio::sync::Notify;

/// Once a run is asked to end, readers have so long to take what is sent, all of them together.
pub(crate) const LAST_WORDS: Duration = Duration::from_millis(300);

/// Whether, and when, a run was asked to end.
#[derive(Debug, Default)]
pub(crate) struct Stop {
    asked: OnceLock<Instant>,
    notify: Notify,
}

impl Stop {
    /// Asks the run to end.
    pub fn ask(&self) {
        self.asked.get_or_init(Instant::now);
        self.notify.notify_waiters();
    }

    /// Whether the run was asked to end.
    pub fn is_asked(&self) -> bool {
        self.asked.get().is_some()
    }

    /// Resolves when the run was asked to end, to the time of that.
    pub async fn asked(&self) -> Instant {
        loop {
            // Made before the look, so that an end that is asked for in between is not missed.
            let notified = self.notify.notified();
            if let Some(asked) = self.asked.get() {
                return *asked;
            }
            notified.await;
        }
    }

    /// Whether readers have had their last words.
    fn is_overdue(&self) -> bool {
        self.asked.get().is_some_and(|asked| asked.elapsed() >= LAST_WORDS)
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

    /// The same, for a run that ends.
    pub fn at_least(self, limit: Duration) -> Patience {
        Patience { limit: self.limit.max(limit), ..self }
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
