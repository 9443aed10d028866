//! A run of the unit.

use std::fmt;
use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use geu_model::configuration::LinkLogFormat;
use geu_model::fault::catalogue::Transport;
use geu_model::fault::engine::FaultEngine;
use geu_model::{Configuration, Truth};

use super::cadence_loop::CadenceLoop;
use super::error::RunError;
use super::output::LinkOutput;
use super::session::{Session, await_readers};
use crate::cadence::Speed;
use crate::console;
use crate::control::{ControlListener, Server};
use crate::control_service::{ControlService, StatusSource};
use crate::host::{self, Instant, Thread};
use crate::lateness::Histogram;
use crate::link::{Link, LinkAddress, LinkStatistics};
use crate::patience::Stop;
use crate::recorder_thread::{Feed, RecorderThread, RecordingError};
use crate::running::{self, Registration, Running, RunningLink};
use crate::shared_unit::SharedUnit;
use crate::truth::{self, ExternalTruth, TruthStatistics};
use geu_recorder::link_model::LinkModel;
use geu_recorder::{Destination, Recorder, recorded, wire_beside};

/// Time to complete the recording after the request to end: less than a second together with the last messages.
const RECORD_AFTER_ASKED: Duration = Duration::from_millis(500);
/// Minimum time to complete the recording.
const MIN_RECORD_TIME: Duration = Duration::from_millis(100);

/// Options of a run.
#[derive(Debug, Clone)]
pub struct RunOptions {
    /// Links to open; all send the same samples.
    pub links: Vec<LinkAddress>,
    /// Ratio of on-board time to the wall clock.
    pub speed: Speed,
    /// Number of samples; `None`: unlimited.
    pub samples: Option<u64>,
    /// Busy-wait time before each deadline.
    pub spin: Duration,
    /// Request SCHED_FIFO.
    pub realtime: bool,
    /// Start when a client is attached to a pty or over TCP.
    pub wait_for_client: bool,
    /// The external truth, if any.
    pub live: Option<Arc<ExternalTruth>>,
    /// Wall-clock limit of each wait for the external truth; `None`: unlimited.
    pub truth_wait: Option<Duration>,
}

/// A recording beside the links.
#[derive(Debug, Clone)]
pub struct Recording {
    /// Directory.
    pub destination: Destination,
    /// Encoding of the recorded link; `None`: that of the first link.
    pub wire: Option<LinkLogFormat>,
}

/// Result of a run.
pub struct RunSummary {
    /// Samples that ended on board.
    pub samples: u64,
    /// Samples not sent because the process stalled beyond the next deadline.
    pub missed: u64,
    /// Sent more than 5 ms after the deadline.
    pub late: u64,
    /// Lateness of the sends that have a deadline.
    pub lateness: Histogram,
    /// Commands received.
    pub commands: u64,
    /// Frames to the unit dropped without a reply.
    pub rejected: u64,
    /// Counts of the samples of an external truth.
    pub truth: Option<TruthStatistics>,
    /// Reason why the unit did not follow the external truth, if it did not.
    pub truth_failure: Option<String>,
    /// Statistics of each link.
    pub links: Vec<Arc<LinkStatistics>>,
    /// Final state of faults and expectations.
    pub faults: FaultEngine,
    /// Result of the recording.
    pub recording: Result<(), RecordingError>,
}

impl fmt::Display for RunSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "samples {}, late {}, missed {}", self.samples, self.late, self.missed)?;
        if self.lateness.count() > 0 {
            writeln!(f, "lateness     {}", self.lateness)?;
        }
        writeln!(f, "commands     {} received, {} frames dropped (CRC, length, kind)", self.commands, self.rejected)?;
        self.truth.iter().try_for_each(|counts| writeln!(f, "truth        {counts}"))?;
        self.links.iter().try_for_each(|link| writeln!(f, "link         {link}"))
    }
}

/// Runs the unit on `truth` until its samples are sent or `shutdown` resolves; links are removed when it returns. `listener`
/// serves the control interface. A recording is replaced only after the links, the external truth and the control interface
/// are open.
///
/// # Errors
/// A link that cannot be opened, a recording that cannot begin.
pub fn run(
    configuration: &Configuration,
    truth: &Truth,
    settings: &RunOptions,
    recording: Option<&Recording>,
    listener: Option<ControlListener>,
    shutdown: impl Future<Output = io::Result<()>>,
) -> Result<RunSummary, RunError> {
    let session = Session::new(&settings.links, settings.speed, settings.wait_for_client)?;
    let (feed, recorded) = match recording {
        Some(recording) => {
            recording.destination.check()?;
            let (feed, thread, kind) = plan_recording(recording, configuration, truth, &settings.links);
            (Some(feed), Some((thread, kind)))
        }
        None => (None, None),
    };
    let (mut control, mut observer, mut publisher) = (None, None, None);
    if let Some(listener) = listener {
        let (service, events, thread) = ControlService::start(&configuration.device)?;
        (control, observer, publisher) = (Some((listener, service)), Some(events), Some(thread));
    }
    let unit = Arc::new(SharedUnit::new(configuration, truth, settings.speed, feed, observer));
    let ended = session.block_on(shutdown, run_unit(&session, &unit, settings, control, recorded));
    unit.close();
    // Ends with the unit's observer.
    let _ = publisher.map(Thread::join);
    console::finish();
    ended
}

pub(crate) async fn run_unit(
    session: &Session,
    unit: &Arc<SharedUnit>,
    settings: &RunOptions,
    control: Option<(ControlListener, Arc<ControlService>)>,
    recording: Option<(RecorderThread, Transport)>,
) -> Result<RunSummary, RunError> {
    let links = session.open_links(&settings.links, unit)?;
    if let Some(live) = &settings.live {
        truth::open(live, settings.wait_for_client && settings.speed != Speed::Max)?;
    }
    let statistics: Vec<_> = links.iter().map(|link| link.info().statistics.clone()).collect();
    let address = control.as_ref().map(|(listener, _)| listener.address());
    let _registration = register(&statistics, address);
    let (mut writer, recorded) = recording.unzip();
    if let Some(writer) = &mut writer {
        let was_asked = session.stop.is_asked();
        // A disk that hangs must not prevent the end.
        tokio::select! {
            opened = writer.open() => opened?,
            _ = session.stop.asked(), if !was_asked => {}
        }
    }
    // Only now: after one ready line all links and the recording are open.
    links.iter().filter(|link| link.is_ready()).for_each(|link| console::ready(&link.info().statistics.name));
    let server = control.map(|control| serve(control, session, unit, &links, recorded)).transpose()?;
    if let Some(address) = address {
        console::ready(&format!("control http://{address}/"));
    }
    let links = links.into_iter().map(|link| LinkOutput::new(link, unit.device.interval_ns())).collect();
    let (own_session, own_unit, own_settings) = (session.clone(), unit.clone(), settings.clone());
    let work = move || CadenceLoop::run(own_session, own_unit, own_settings, links);
    let (result, links) = session.keep_cadence(&statistics, &unit.device, || unit.completed(), work).await?;
    await_readers(&links).await;
    drop(links);
    drop(server);
    console::clear_status();
    unit.close();
    let recording = match writer {
        Some(writer) => writer.finish(recording_deadline(&session.stop)).await,
        None => Ok(()),
    };
    result?;
    let counts = session.monitor.counts();
    Ok(RunSummary {
        samples: unit.running().0,
        missed: counts.missed,
        late: counts.late,
        lateness: counts.lateness,
        commands: unit.commands.load(Relaxed),
        rejected: unit.rejected.load(Relaxed),
        truth: settings.live.as_ref().map(|live| live.counts()),
        truth_failure: settings.live.as_ref().and_then(|live| live.failure()),
        links: statistics,
        faults: unit.faults(),
        recording,
    })
}

/// Serves the control interface; `recorded` is the transport of the recorded link.
fn serve(
    (listener, service): (ControlListener, Arc<ControlService>),
    session: &Session,
    unit: &Arc<SharedUnit>,
    links: &[Box<dyn Link>],
    recorded: Option<Transport>,
) -> Result<Server, RunError> {
    let models: Vec<_> = links.iter().map(|link| (link.info().model.clone(), link.info().statistics.clone())).collect();
    service.set_source(StatusSource::new(unit, &models, recorded, &session.monitor));
    Ok(listener.serve(service)?)
}

/// Prepares a recording, and returns the transport of the recorded link.
fn plan_recording(
    recording: &Recording,
    configuration: &Configuration,
    truth: &Truth,
    links: &[LinkAddress],
) -> (Feed, RecorderThread, Transport) {
    let links: Vec<LinkModel> = links.iter().map(|link| link.model(&configuration.device)).collect();
    let wire = wire_beside(recording.wire, &links, &configuration.device);
    let kind = recorded(wire, configuration, &links).kind;
    let (destination, configuration, truth) = (recording.destination.clone(), configuration.clone(), truth.clone());
    let directory = recording.destination.directory();
    let create = move || Recorder::create(&destination, &configuration, &truth, wire, &links, None);
    let (feed, thread) = RecorderThread::new(directory, create);
    (feed, thread, kind)
}

/// Resolves when a recording must be complete after a request to end.
async fn recording_deadline(stop: &Stop) {
    let start = Instant::now();
    let end = (stop.asked().await + RECORD_AFTER_ASKED).max(start + MIN_RECORD_TIME);
    host::sleep(end - Instant::now()).await;
}

/// Registers this emulator for clients; it runs without registration if that fails.
fn register(links: &[Arc<LinkStatistics>], control: Option<SocketAddr>) -> Option<Registration> {
    #[cfg(test)]
    if crate::simulation::host().is_some() {
        return None;
    }
    let link = |statistics: &Arc<LinkStatistics>| {
        let (kind, address) = statistics.name.split_once(' ').unwrap_or((&statistics.name, ""));
        // A client may have another working directory.
        let absolute = Some(kind).filter(|kind| *kind == "pty").and_then(|_| std::path::absolute(address).ok());
        let address = absolute.map_or_else(|| address.to_owned(), |path| path.display().to_string());
        RunningLink { address, kind: kind.to_owned() }
    };
    let links = links.iter().map(link).collect();
    let running = Running { pid: std::process::id(), links, control: control.map(|address| address.to_string()) };
    running::register(&running).inspect_err(|error| console::say(error)).ok()
}
