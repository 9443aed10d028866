//! A run of the unit.

use std::fmt;
use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};

use geu_model::configuration::LinkLogFormat;
use geu_model::fault::acting::FaultEngine;
use geu_model::fault::catalogue::Transport;
use geu_model::{Configuration, Truth};

use super::cadence_loop::CadenceLoop;
use super::error::RunError;
use super::output::LinkOutput;
use super::session::{Session, await_readers};
use crate::cadence::Speed;
use crate::console;
use crate::control::{ControlListener, Server};
use crate::control_service::{ControlService, PublisherThread};
use crate::lateness::Histogram;
use crate::link::{Link, LinkAddress, LinkStatistics};
use crate::link_model::LinkModel;
use crate::patience::Stop;
use crate::recorder::{self, Destination, RecordError, Recorder};
use crate::recorder_thread::{Feed, RecorderThread, RecordingError};
use crate::running::{self, Registration, Running};
use crate::shared_unit::SharedUnit;
use crate::truth::{self, ExternalTruth, TruthStatistics};

/// The recording is written to its end until so long after the process was asked to end: with the last words on the
/// terminal that is less than a second.
const RECORD_AFTER_ASKED: Duration = Duration::from_millis(500);
/// And it is given so long at least.
const RECORD_AT_LEAST: Duration = Duration::from_millis(100);

/// How to run the unit.
#[derive(Debug, Clone)]
pub struct RunOptions {
    /// Links to open; all carry the same.
    pub links: Vec<LinkAddress>,
    /// On-board time against the wall clock.
    pub speed: Speed,
    /// Samples to run; without end where nothing is said.
    pub samples: Option<u64>,
    /// Spin so long before each deadline.
    pub spin: Duration,
    /// Ask for SCHED_FIFO.
    pub realtime: bool,
    /// Begin only when a client is attached to a pty or over TCP.
    pub wait_for_client: bool,
    /// The source of the truth, where that comes from outside.
    pub live: Option<Arc<ExternalTruth>>,
    /// Such a source is waited for so long at most, wall clock, wherever the run waits for it; without end where nothing
    /// is said.
    pub truth_wait: Option<Duration>,
}

/// A recording beside the links.
#[derive(Debug, Clone)]
pub struct Recording {
    /// Where it goes.
    pub destination: Destination,
    /// Encoding of the link in it; without one that of the first link.
    pub wire: Option<LinkLogFormat>,
}

/// What a run has done.
pub struct RunSummary {
    /// Samples that ended on board.
    pub samples: u64,
    /// Of these, not sent because the process was held up beyond the next deadline.
    pub missed: u64,
    /// Sent more than 5 ms after the deadline.
    pub late: u64,
    /// Lateness of the sends that have a deadline.
    pub lateness: Histogram,
    /// Commands received.
    pub commands: u64,
    /// Frames to the unit dropped without an answer.
    pub rejected: u64,
    /// What became of the samples of a truth from outside.
    pub truth: Option<TruthStatistics>,
    /// Why the unit did not move as that truth was told, in words; nothing where it did.
    pub truth_failure: Option<String>,
    /// Each link.
    pub links: Vec<Arc<LinkStatistics>>,
    /// How the faults and expectations of the plan stand.
    pub faults: FaultEngine,
    /// What became of the recording.
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

/// Runs the unit on `truth` until its samples are sent or `shutdown` resolves; links are removed when it returns. It can be
/// watched and driven through `listener`. Nothing of a recording that is replaced is touched before the links are open, and
/// the truth and the control interface are listened for.
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
    let (mut feed, mut recorded) = (None, None);
    if let Some(recording) = recording {
        recording.destination.check()?;
        let (told, planned) = PlannedRecording::new(recording, configuration, truth, &settings.links);
        (feed, recorded) = (Some(told), Some(planned));
    }
    let (mut control, mut observer, mut publisher) = (None, None, None);
    if let Some(listener) = listener {
        let (service, tells, thread) = ControlService::start()?;
        (control, observer, publisher) = (Some((listener, service)), Some(tells), Some(thread));
    }
    let unit = Arc::new(SharedUnit::new(configuration, truth, settings.speed, feed, observer));
    let ended = session.block_on(shutdown, run_unit(&session, &unit, settings, control, recorded));
    unit.close();
    publisher.into_iter().for_each(PublisherThread::finish);
    console::finish();
    ended
}

async fn run_unit(
    session: &Session,
    unit: &Arc<SharedUnit>,
    settings: &RunOptions,
    control: Option<(ControlListener, ControlService)>,
    recording: Option<PlannedRecording>,
) -> Result<RunSummary, RunError> {
    let links = session.open_links(&settings.links, unit)?;
    if let Some(live) = &settings.live {
        truth::open(live, settings.wait_for_client && settings.speed != Speed::Max)?;
    }
    let statistics: Vec<_> = links.iter().map(|link| link.info().statistics.clone()).collect();
    let address = control.as_ref().map(|(listener, _)| listener.address());
    let _registration = register(&statistics, address);
    let recorded = recording.as_ref().map(|recording| recording.model.kind);
    let mut writer = match recording {
        Some(recording) => Some(recording.open(&session.stop).await?),
        None => None,
    };
    // Only now: who waits for one line may count on all links, and on the recording.
    links.iter().filter(|link| link.is_ready()).for_each(|link| console::ready(&link.info().statistics.name));
    let server = control.map(|control| serve(control, session, unit, &links, recorded)).transpose()?;
    if let Some(address) = address {
        console::ready(&format!("control http://{address}/"));
    }
    let links = links.into_iter().map(LinkOutput::new).collect();
    let mut cadence = CadenceLoop::new(session.clone(), unit.clone(), settings.clone(), links);
    let work = move || (cadence.run(), cadence);
    let (kept, cadence) = session.keep_cadence(&statistics, || unit.completed(), work).await?;
    await_readers(&cadence.links).await;
    drop(cadence);
    drop(server);
    console::clear_status();
    unit.close();
    let recording = match &mut writer {
        Some(writer) => await_recording(writer, &session.stop).await,
        None => Ok(()),
    };
    kept?;
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

/// Serves the control interface; `recorded` is the kind of link that a recording is of.
fn serve(
    (listener, service): (ControlListener, ControlService),
    session: &Session,
    unit: &Arc<SharedUnit>,
    links: &[Box<dyn Link>],
    recorded: Option<Transport>,
) -> Result<Server, RunError> {
    let carried: Vec<_> =
        links.iter().map(|link| (link.info().model.clone(), link.info().statistics.clone())).collect();
    service.know(unit, &carried, recorded, &session.monitor);
    Ok(listener.serve(Arc::new(service))?)
}

/// A recording that begins once the links are open.
struct PlannedRecording {
    writer: RecorderThread,
    /// The link that is recorded.
    model: LinkModel,
    create: Box<dyn FnOnce() -> Result<Recorder, RecordError> + Send>,
}

impl PlannedRecording {
    fn new(
        recording: &Recording,
        configuration: &Configuration,
        truth: &Truth,
        links: &[LinkAddress],
    ) -> (Feed, PlannedRecording) {
        let links: Vec<LinkModel> = links.iter().map(LinkAddress::model).collect();
        let wire = recorder::form_beside(recording.wire, &links);
        let (feed, writer) = RecorderThread::new(recording.destination.directory());
        let model = recorder::recorded(wire, configuration, &links);
        let (destination, configuration, truth) = (recording.destination.clone(), configuration.clone(), truth.clone());
        let create = Box::new(move || Recorder::create(&destination, &configuration, &truth, wire, &links));
        (feed, PlannedRecording { writer, model, create })
    }

    /// Opens it. A disk that hangs is no reason not to end.
    async fn open(self, stop: &Stop) -> Result<RecorderThread, RunError> {
        let (PlannedRecording { mut writer, create, .. }, was_asked) = (self, stop.is_asked());
        tokio::select! {
            opened = writer.open(create) => opened?,
            _ = stop.asked(), if !was_asked => {}
        }
        Ok(writer)
    }
}

/// Waits until the recording is written, for a bounded time once the process was asked to end.
async fn await_recording(writer: &mut RecorderThread, stop: &Stop) -> Result<(), RecordingError> {
    let start = Instant::now();
    let too_late = async {
        let end = (stop.asked().await + RECORD_AFTER_ASKED).max(start + RECORD_AT_LEAST);
        tokio::time::sleep_until(end.into()).await;
    };
    tokio::select! {
        biased;
        () = writer.done() => writer.result(true),
        () = too_late => writer.result(false),
    }
}

/// Lets clients find this emulator; one that cannot be found runs all the same.
fn register(links: &[Arc<LinkStatistics>], control: Option<SocketAddr>) -> Option<Registration> {
    let link = |statistics: &Arc<LinkStatistics>| {
        let (kind, address) = statistics.name.split_once(' ').unwrap_or((&statistics.name, ""));
        // Whoever looks for it may stand elsewhere.
        let absolute = Some(kind).filter(|kind| *kind == "pty").and_then(|_| std::path::absolute(address).ok());
        let address = absolute.map_or_else(|| address.to_owned(), |path| path.display().to_string());
        (kind.to_owned(), address)
    };
    let links = links.iter().map(link).collect();
    let running = Running { pid: std::process::id(), links, control: control.map(|address| address.to_string()) };
    running::register(&running).inspect_err(|error| console::say(error)).ok()
}
