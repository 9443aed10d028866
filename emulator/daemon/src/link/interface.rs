//! A link as the cadence thread sees it, and what links share.

use std::io;
use std::ops::Deref;
use std::os::fd::{AsFd, AsRawFd, RawFd};
use std::sync::Arc;
use std::time::Duration;

use tokio::io::unix::AsyncFd;
use tokio::sync::Notify;
use tokio::time::timeout;

use super::statistics::LinkStatistics;
use crate::cadence::now_ns;
use crate::link_model::{LinkModel, WireData};
use crate::patience::Patience;

/// Answers of a client that wait for their time, at most: beyond, they are dropped.
pub(super) const LATE_ANSWERS: usize = 1000;

/// What a link is, and what it has done.
#[derive(Clone)]
pub(crate) struct LinkInfo {
    pub model: LinkModel,
    pub statistics: Arc<LinkStatistics>,
}

impl LinkInfo {
    pub fn new(model: LinkModel, name: impl Into<String>) -> LinkInfo {
        LinkInfo { model, statistics: LinkStatistics::new(name) }
    }
}

/// A link, as the thread that keeps time sees it.
pub(crate) trait Link: Send {
    /// Its model and statistics.
    fn info(&self) -> &LinkInfo;
    /// Sends data without blocking; a reader that has no room is given `patience` before it loses all of it. Where the data
    /// end within a frame, its rest comes with the next.
    fn send(&mut self, data: &[WireData], more_fragments: bool, patience: &Patience);
    /// Sends at once, as the run ends, the answers that faults still hold back.
    fn send_answers(&mut self);
    /// Whether it can be used at once; one that cannot tells by itself when it can.
    fn is_ready(&self) -> bool {
        true
    }
    /// Whether all that was taken has reached those who read.
    fn is_drained(&self) -> bool;
}

/// Waits until the next is due, `next_ns` on the monotonic clock, or `later` reports that something may be due earlier.
pub(super) async fn until_due(later: &Notify, next_ns: Option<i64>) {
    match next_ns {
        None => later.notified().await,
        Some(due_ns) => {
            let wait_ns = (due_ns - now_ns()).max(0) as u64;
            let _ = timeout(Duration::from_nanos(wait_ns), later.notified()).await;
        }
    }
}

/// A descriptor whose readiness the runtime tells.
pub(super) struct Watched<T>(T);

impl<T: AsFd> Watched<T> {
    pub fn new(owner: T) -> io::Result<AsyncFd<Watched<T>>> {
        // SAFETY: the owner keeps its descriptor open, and the same, for as long as it is inside.
        Ok(unsafe { AsyncFd::register(Watched(owner)) }?)
    }
}

impl<T: AsFd> AsRawFd for Watched<T> {
    fn as_raw_fd(&self) -> RawFd {
        self.0.as_fd().as_raw_fd()
    }
}

impl<T> Deref for Watched<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.0
    }
}
