//! Time limit for readers, and the end of a run, which ends every wait.

use std::sync::{Arc, OnceLock};
use std::time::Duration;

use tokio::sync::Notify;

use crate::host::Instant;

/// Time for all readers together to read the last data after a request to end.
pub(crate) const LAST_WORDS: Duration = Duration::from_millis(300);

/// The request to end a run.
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

    /// True after the request.
    pub fn is_asked(&self) -> bool {
        self.asked.get().is_some()
    }

    /// Resolves at the request, to its time.
    pub async fn asked(&self) -> Instant {
        loop {
            // Created before the check, so that a request in between is not missed.
            let notified = self.notify.notified();
            if let Some(asked) = self.asked.get() {
                return *asked;
            }
            notified.await;
        }
    }

    /// True once the time of readers after the request has passed.
    fn is_overdue(&self) -> bool {
        self.asked.get().is_some_and(|asked| asked.elapsed() >= LAST_WORDS)
    }
}

/// Time for which a reader that accepts no data is awaited.
#[derive(Debug, Clone)]
pub(crate) struct Patience {
    limit: Duration,
    stop: Arc<Stop>,
}

impl Patience {
    /// At most `limit`, and never beyond the end of the run.
    pub fn new(limit: Duration, stop: &Arc<Stop>) -> Patience {
        Patience { limit, stop: stop.clone() }
    }

    /// Extends the limit, for the end of a run.
    pub fn at_least(self, limit: Duration) -> Patience {
        Patience { limit: self.limit.max(limit), ..self }
    }

    /// True if readers are not awaited.
    pub fn is_none(&self) -> bool {
        self.limit.is_zero()
    }

    /// True if the time of a reader awaited since then has passed.
    pub fn is_over(&self, since: Instant) -> bool {
        since.elapsed() >= self.limit || self.stop.is_overdue()
    }
}
