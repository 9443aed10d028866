//! Common parts of a run and a replay: a runtime beside the cadence thread, links, and an end on request.

use std::future::Future;
use std::io;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use geu_model::CompletedSample;
use geu_model::device::Device;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::oneshot;

use super::error::RunError;
use super::output::LinkOutput;
use crate::cadence::Speed;
use crate::host::{self, Instant, Thread};
use crate::lateness::CadenceMonitor;
use crate::link::{self, Link, LinkAddress, LinkStatistics};
use crate::patience::{LAST_WORDS, Patience, Stop};
use crate::shared_unit::SharedUnit;
use crate::{console, descriptors};

/// The cadence thread wakes up this long before a deadline: longer than the model and a wake-up take.
pub(super) const LEAD_NS: i64 = 800_000;
/// Time for which a run faster than real time waits for a reader, before the reader loses a sample.
const READER_TIMEOUT: Duration = Duration::from_secs(2);
/// A link that has been empty for this time is empty.
const EMPTY_TIME: Duration = Duration::from_millis(25);
const STATUS_INTERVAL: Duration = Duration::from_millis(500);
/// Poll interval of states without notification.
pub(super) const POLL_INTERVAL: Duration = Duration::from_millis(5);

/// Resolves when the process is asked to end: SIGINT, SIGTERM, SIGHUP or SIGQUIT.
///
/// # Errors
/// Signal handlers that cannot be installed.
pub async fn asked_to_end() -> io::Result<()> {
    let (mut interrupt, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
    let (mut hangup, mut quit) = (signal(SignalKind::hangup())?, signal(SignalKind::quit())?);
    tokio::select! {
        _ = interrupt.recv() => {}
        _ = terminate.recv() => {}
        _ = hangup.recv() => {}
        _ = quit.recv() => {}
    }
    Ok(())
}

/// A run: its end, and its lateness.
#[derive(Clone)]
pub(crate) struct Session {
    pub stop: Arc<Stop>,
    pub monitor: Arc<CadenceMonitor>,
    pub speed: Speed,
    waits_for_client: bool,
}

impl Session {
    /// # Errors
    /// A run that waits for a client on links to which none attaches, or too few descriptors.
    pub fn new(links: &[LinkAddress], speed: Speed, waits_for_client: bool) -> Result<Session, RunError> {
        let has_clients = |link: &LinkAddress| matches!(link, LinkAddress::Pty(_) | LinkAddress::Tcp(_));
        if waits_for_client && !links.iter().any(has_clients) {
            return Err(RunError::NoClientLink);
        }
        descriptors::take_all()?;
        Ok(Session { stop: Arc::default(), monitor: Arc::default(), speed, waits_for_client })
    }

    /// Runs `body`, and asks the run to end when `shutdown` resolves. The tasks of the links end with it.
    pub fn block_on<T>(
        &self,
        shutdown: impl Future<Output = io::Result<()>>,
        body: impl Future<Output = Result<T, RunError>>,
    ) -> Result<T, RunError> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let ended = runtime.block_on(self.until_end(shutdown, body));
        // The last task removes the symlink of a pty. Not awaited: a name resolver may take half a minute.
        runtime.shutdown_background();
        ended
    }

    /// Resolves when `body` does, and asks the run to end when `shutdown` resolves.
    pub async fn until_end<T>(
        &self,
        shutdown: impl Future<Output = io::Result<()>>,
        body: impl Future<Output = Result<T, RunError>>,
    ) -> Result<T, RunError> {
        let (mut shutdown, mut body) = (pin!(shutdown), pin!(body));
        loop {
            // `shutdown` first, so that a signal during the opening of links is not the default end of the process.
            tokio::select! {
                biased;
                asked = &mut shutdown, if !self.stop.is_asked() => {
                    asked?;
                    self.stop.ask();
                }
                ended = &mut body => return ended,
            }
        }
    }

    pub fn open_links(&self, links: &[LinkAddress], unit: &Arc<SharedUnit>) -> Result<Vec<Box<dyn Link>>, RunError> {
        let speedup = match self.speed {
            Speed::Times(factor) => factor,
            Speed::Max => f64::INFINITY,
        };
        links.iter().map(|address| Ok(link::open(address, unit, speedup)?)).collect()
    }

    /// Runs `work` on the cadence thread to its end, and shows the sample of `last_sample` in the status line.
    pub async fn keep_cadence<T: Send + 'static>(
        &self,
        links: &[Arc<LinkStatistics>],
        device: &Device,
        last_sample: impl Fn() -> Option<CompletedSample>,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, RunError> {
        let (done, mut is_done) = oneshot::channel();
        let thread = Thread::spawn("geu-cadence", move || {
            let worked = work();
            let _ = done.send(());
            worked
        })?;
        let (wants_status, mut is_woken) = (console::wants_status(), false);
        loop {
            tokio::select! {
                biased;
                _ = &mut is_done => break,
                _ = self.stop.asked(), if !is_woken => {
                    is_woken = true;
                    thread.unpark();
                }
                () = host::sleep(STATUS_INTERVAL), if wants_status => {
                    let clients = links.iter().map(|link| link.clients.load(Relaxed)).sum();
                    console::show_status(device, last_sample(), clients, &self.monitor.counts().lateness);
                }
            }
        }
        Ok(thread.join())
    }

    pub fn is_stopped(&self) -> bool {
        self.stop.is_asked()
    }

    /// Waits on the cadence thread until a client is attached, if the run waits for one.
    pub fn await_client(&self, links: &[LinkOutput]) {
        while self.waits_for_client && !self.is_stopped() && !links.iter().any(LinkOutput::has_client) {
            host::park_thread(POLL_INTERVAL);
        }
    }

    /// Time for which readers are awaited: zero in real time.
    pub fn patience(&self) -> Patience {
        let is_faster = self.speed.is_faster_than_real();
        Patience::new(if is_faster { READER_TIMEOUT } else { Duration::ZERO }, &self.stop)
    }
}

/// Waits, for a limited time, until readers have read all data. Data between a pty and its reader is invisible for moments, so
/// the link must be empty for some time.
pub(super) async fn await_readers(links: &[LinkOutput]) {
    let (give_up, mut empty_since) = (Instant::now() + LAST_WORDS, Instant::now());
    while Instant::now() < give_up && empty_since.elapsed() < EMPTY_TIME {
        host::sleep(POLL_INTERVAL).await;
        if !links.iter().all(|output| output.link.is_drained()) {
            empty_since = Instant::now();
        }
    }
}
