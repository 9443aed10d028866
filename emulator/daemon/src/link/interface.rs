//! The interface of a link to the cadence thread, and common parts of links.

use std::fmt::Display;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::Notify;

use super::statistics::LinkStatistics;
use crate::console;
use crate::host::{self, now_ns};
use crate::patience::Patience;
use geu_recorder::link_model::{LinkModel, WireData};

/// Interval of attempts to open a device.
pub(super) const RETRY_INTERVAL: Duration = Duration::from_millis(250);
/// Maximum number of replies that wait for their time: further ones are dropped.
pub(super) const MAX_WAITING_REPLIES: usize = 1000;

/// Model and statistics of a link.
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

/// A link, used by the cadence thread.
pub(crate) trait Link: Send {
    fn info(&self) -> &LinkInfo;
    /// Sends data without blocking; a reader that does not accept it loses all of it after `patience`. With `more_fragments`
    /// the data ends within a frame, and the next call has its rest.
    fn send(&mut self, data: &[WireData], more_fragments: bool, patience: &Patience);
    /// Sends at once, at the end of the run, the replies that faults delay.
    fn send_answers(&mut self);
    /// True if the link can be used at once; otherwise it prints its ready line later.
    fn is_ready(&self) -> bool {
        true
    }
    /// True if readers have received all data.
    fn is_drained(&self) -> bool;
}

/// Logs that a device is gone, and opens it again once it is back.
pub(super) async fn reopen<T>(name: &str, reason: impl Display, open: impl Fn() -> Option<T>) -> T {
    console::say(format_args!("{name}: gone ({reason}); the unit keeps time and waits for it to come back"));
    let opened = retry(open).await;
    console::say(format_args!("{name}: is back"));
    opened
}

/// Opens a device as soon as that is possible.
pub(super) async fn retry<T>(open: impl Fn() -> Option<T>) -> T {
    loop {
        host::sleep(RETRY_INTERVAL).await;
        if let Some(opened) = open() {
            return opened;
        }
    }
}

/// Waits until `next_ns` on the monotonic clock, or until `later` is notified.
pub(super) async fn until_due(later: &Notify, next_ns: Option<i64>) {
    match next_ns {
        None => later.notified().await,
        Some(due_ns) => {
            let wait_ns = (due_ns - now_ns()).max(0) as u64;
            let _ = host::timeout(Duration::from_nanos(wait_ns), later.notified()).await;
        }
    }
}
