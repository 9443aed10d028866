//! The emulator: one thread keeps time and sends, the calling thread runs everything that waits for somebody else.

mod output;
pub mod replay;

use std::fmt;
use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use geu_model::configuration::WireForm;
use geu_model::fault::acting::{Acting, Faults};
use geu_model::fault::{Fault, asks_in_vain};
use geu_model::units::HALF_SECOND_NS;
use geu_model::{Configuration, Ended, Truth};
use tokio::signal::unix::{SignalKind, signal};

use crate::cadence::{Sleeper, Speed, ask_for_realtime, doze_until, now_ns};
use crate::console;
use crate::control::{ControlError, ControlListener};
use crate::control_service::{ControlService, PublisherThread};
use crate::descriptors::{self, TooFew};
use crate::lateness::{Histogram, Time};
use crate::link::{self, LinkAddress, LinkError, LinkStatistics};
use crate::link_model::LinkModel;
use crate::patience::{LAST_WORDS, Patience, Stop};
use crate::recorder::{self, Destination, RecordError, Recorder};
use crate::recorder_thread::{Feed, RecorderThread, RecordingError, Status};
use crate::running::{self, Registration, Running};
use crate::shared_unit::SharedUnit;
use crate::truth::{Counts as TruthCounts, Live, SampleReport, TruthError};
use output::LinkOutput;

/// So long before its deadline a half second is ended and encoded: longer than the model and a wake-up take.
const LEAD_NS: i64 = 800_000;
/// A tick later than this is counted as late: what the interface control document allows as constant delay.
const LATE_NS: i64 = 5_000_000;
/// A reader at more than real speed is given so long to make room before it loses a half second.
const PATIENCE: Duration = Duration::from_secs(2);
/// What has looked empty for so long is.
const SURELY_EMPTY: Duration = Duration::from_millis(25);
/// The recording is written to its end until so long after the process was asked to end: with the last words on the
/// terminal that is less than a second.
const RECORD_AFTER_ASKED: Duration = Duration::from_millis(500);
/// And it is given so long at least.
const RECORD_AT_LEAST: Duration = Duration::from_millis(100);
/// Between two status lines.
const STATUS: Duration = Duration::from_millis(500);
/// Between two looks at something that nobody tells of.
const LOOK_AGAIN: Duration = Duration::from_millis(5);

/// How to run the unit.
#[derive(Debug, Clone)]
pub struct RunOptions {
    /// Links to open; all carry the same.
    pub links: Vec<LinkAddress>,
    /// On-board time against the wall clock.
    pub speed: Speed,
    /// Half seconds to run; without end where nothing is said.
    pub half_seconds: Option<u64>,
    /// Spin so long before each deadline.
    pub spin: Duration,
    /// Ask for SCHED_FIFO.
    pub realtime: bool,
    /// Begin only when a client is attached to a pty or over TCP.
    pub wait_for_client: bool,
    /// The source of the truth, where that comes from outside.
    pub live: Option<Arc<Live>>,
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
    pub wire: Option<WireForm>,
}

/// A run that could not begin.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// A link cannot be opened.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// Too few descriptors.
    #[error(transparent)]
    Descriptors(#[from] TooFew),
    /// Nobody can attach to any of the links.
    #[error(
        "--wait: nobody attaches to a CAN interface or a serial port; expected a link with clients too: --pty or --tcp"
    )]
    NobodyToWaitFor,
    /// The control interface cannot be served.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// The truth from outside cannot be listened for.
    #[error(transparent)]
    Truth(#[from] TruthError),
    /// A condition asks about what the truth from outside does not tell.
    #[error("{0}; a simulator tells them by the direction to the sun in its first sample, \"sun\": [x, y, z]")]
    Untold(String),
    /// The recording cannot begin.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// No runtime, no thread.
    #[error("cannot start: {0}")]
    System(#[from] io::Error),
}

/// What a run has done.
pub struct RunSummary {
    /// Half seconds that ended on board.
    pub half_seconds: u64,
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
    pub truth: Option<TruthCounts>,
    /// Why the unit did not move as that truth was told, in words; nothing where it did.
    pub truth_failure: Option<String>,
    /// Each link.
    pub links: Vec<Arc<LinkStatistics>>,
    /// How the faults and expectations of the plan stand.
    pub faults: Faults,
    /// What became of the recording.
    pub recording: Result<(), RecordingError>,
}

impl fmt::Display for RunSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "half seconds {}, late {}, missed {}", self.half_seconds, self.late, self.missed)?;
        if self.lateness.count() > 0 {
            writeln!(f, "lateness     {}", self.lateness)?;
        }
        writeln!(f, "commands     {} received, {} frames dropped (CRC, length, kind)", self.commands, self.rejected)?;
        self.truth.iter().try_for_each(|counts| writeln!(f, "truth        {counts}"))?;
        self.links.iter().try_for_each(|link| writeln!(f, "link         {link}"))
    }
}

/// Ends when the process is asked to: SIGINT, SIGTERM, SIGHUP or SIGQUIT.
///
/// # Errors
/// Signals that cannot be waited for.
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

/// Runs the unit on `truth` until its half seconds are over or `shutdown` resolves; links are removed when it returns.
/// Behind `listener` it can be watched and driven. Nothing of a recording that is replaced is touched before the links are
/// open, and the truth and the control interface are listened for.
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
    let has_clients = |link: &LinkAddress| matches!(link, LinkAddress::Pty(_) | LinkAddress::Tcp(_));
    if settings.wait_for_client && !settings.links.iter().any(has_clients) {
        return Err(RunError::NobodyToWaitFor);
    }
    descriptors::take_all()?;
    let (mut feed, mut recorded) = (None, None);
    if let Some(recording) = recording {
        recording.destination.check()?;
        let (told, planned) = PlannedRecording::new(recording, configuration, truth, &settings.links);
        (feed, recorded) = (Some(told), Some(planned));
    }
    let (mut bench, mut event_publisher, mut publisher) = (None, None, None);
    if let Some(listener) = listener {
        let (live, tells, shows) = ControlService::start()?;
        (bench, event_publisher, publisher) = (Some((listener, live)), Some(tells), Some(shows));
    }
    let unit = Arc::new(SharedUnit::new(configuration, truth, settings.speed, feed, event_publisher));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let ended = runtime.block_on(keep(&unit, settings, bench, recorded, shutdown));
    // Ends the tasks; with the last of them the symlink of a pty goes.
    // Without waiting for what it looks up by name: a resolver may take half a minute.
    runtime.shutdown_background();
    unit.close();
    publisher.into_iter().for_each(PublisherThread::finish);
    console::finish();
    ended
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
}

/// Waits until the recording is written, for a bounded time once the process was asked to end at `asked`.
async fn await_recording(
    writer: &mut RecorderThread,
    mut asked: Option<Instant>,
    mut shutdown: Pin<&mut impl Future<Output = io::Result<()>>>,
) -> Result<(), RecordingError> {
    let start = Instant::now();
    loop {
        let give_up = asked.map(|asked| (asked + RECORD_AFTER_ASKED).max(start + RECORD_AT_LEAST));
        let too_late = async {
            match give_up {
                Some(give_up) => tokio::time::sleep_until(give_up.into()).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            biased;
            () = writer.done() => return writer.result(true),
            () = too_late => return writer.result(false),
            _ = &mut shutdown, if asked.is_none() => asked = Some(Instant::now()),
        }
    }
}

async fn keep(
    unit: &Arc<SharedUnit>,
    settings: &RunOptions,
    bench: Option<(ControlListener, ControlService)>,
    recording: Option<PlannedRecording>,
    shutdown: impl Future<Output = io::Result<()>>,
) -> Result<RunSummary, RunError> {
    let mut shutdown = std::pin::pin!(shutdown);
    // Polled once now, so that a signal during the opening of links is not the default end of the process.
    let mut asked =
        tokio::select! { biased; asked = &mut shutdown => Some(asked), () = std::future::ready(()) => None };
    let speedup = match settings.speed {
        Speed::Times(factor) => factor,
        Speed::Max => f64::INFINITY,
    };
    let mut links = Vec::new();
    for address in &settings.links {
        links.push(link::open(address, unit, speedup)?);
    }
    if let Some(live) = &settings.live {
        live.open(settings.wait_for_client && settings.speed != Speed::Max)?;
    }
    let statistics: Vec<_> = links.iter().map(|link| link.statistics()).collect();
    let control = bench.as_ref().map(|(listener, _)| listener.address());
    let _registration = register(&statistics, control);
    let recorded = recording.as_ref().map(|recording| recording.model.kind);
    let mut writer = None;
    if let Some(PlannedRecording { writer: mut opening, create, .. }) = recording {
        // A disk that hangs is no reason not to end.
        tokio::select! {
            opened = opening.open(create) => opened?,
            again = &mut shutdown, if asked.is_none() => asked = Some(again),
        }
        writer = Some(opening);
    }
    // Only now: who waits for one line may count on all links, and on the recording.
    links.iter().filter(|link| link.is_ready()).for_each(|link| console::ready(&link.statistics().name));
    let monitor = Arc::new(CadenceMonitor::default());
    let mut server = None;
    if let Some((listener, bench)) = bench {
        let carried: Vec<_> = links.iter().map(|link| (link.model().clone(), link.statistics())).collect();
        bench.know(unit, &carried, recorded, &monitor);
        server = Some(listener.serve(Arc::new(bench))?);
    }
    if let Some(address) = control {
        console::ready(&format!("control http://{address}/"));
    }
    let links = links.into_iter().map(LinkOutput::new).collect();
    let mut keeper = CadenceLoop { unit: unit.clone(), settings: settings.clone(), links, monitor: monitor.clone() };
    let (done, mut is_done) = tokio::sync::oneshot::channel();
    let thread = thread::Builder::new().name("geu-cadence".to_owned()).spawn(move || {
        let kept = keeper.keep_time();
        let _ = done.send(());
        (keeper, kept)
    })?;

    let mut status = tokio::time::interval(STATUS);
    status.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    let wants_status = console::wants_status();
    let mut asked_at = None;
    if let Some(asked) = asked {
        asked?;
        asked_at = Some(Instant::now());
        monitor.stop.ask();
    }
    loop {
        tokio::select! {
            _ = &mut is_done => break,
            asked = &mut shutdown, if !monitor.stop.is_asked() => {
                asked?;
                asked_at = Some(Instant::now());
                monitor.stop.ask();
                thread.thread().unpark();
            }
            _ = status.tick(), if wants_status => {
                let clients = statistics.iter().map(|statistics| statistics.clients.load(Relaxed)).sum();
                console::show_status(unit.completed().as_ref(), clients, &monitor.lateness());
            }
        }
    }
    // The time keeper is done; it still holds the links.
    let (keeper, kept) = thread.join().expect("the time keeper does not panic");
    await_readers(&keeper.links).await;
    drop(keeper);
    drop(server);
    console::clear_status();
    unit.close();
    let recording = match &mut writer {
        Some(writer) => await_recording(writer, asked_at, shutdown).await,
        None => Ok(()),
    };
    kept?;
    Ok(RunSummary {
        half_seconds: unit.running().0,
        missed: monitor.counts().missed,
        late: monitor.counts().late,
        lateness: monitor.lateness(),
        commands: unit.commands.load(Relaxed),
        rejected: unit.rejected.load(Relaxed),
        truth: settings.live.as_ref().map(|live| live.counts()),
        truth_failure: settings.live.as_ref().and_then(|live| live.failure()),
        links: statistics,
        faults: unit.faults(),
        recording,
    })
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

/// Waits for what readers have not taken, for a while. What a pty hands on to its reader is for moments seen by nobody, so
/// it must look empty for some time.
async fn await_readers(links: &[LinkOutput]) {
    let (give_up, mut empty_since) = (Instant::now() + LAST_WORDS, Instant::now());
    while Instant::now() < give_up && empty_since.elapsed() < SURELY_EMPTY {
        tokio::time::sleep(LOOK_AGAIN).await;
        if !links.iter().all(|output| output.link.is_drained()) {
            empty_since = Instant::now();
        }
    }
}

/// How well time is kept, as both threads see it.
#[derive(Default)]
pub(crate) struct CadenceMonitor {
    pub stop: Arc<Stop>,
    counts: Mutex<CadenceCounts>,
}

#[derive(Default, Clone)]
pub(crate) struct CadenceCounts {
    pub late: u64,
    pub missed: u64,
    pub lateness: Histogram,
}

impl CadenceMonitor {
    pub fn counts(&self) -> CadenceCounts {
        self.counts.lock().expect("nothing panics with the counts").clone()
    }

    fn lateness(&self) -> Histogram {
        self.counts().lateness
    }

    /// Takes a send in.
    fn record(&self, late_ns: i64) {
        let mut counts = self.counts.lock().expect("nothing panics with the counts");
        counts.lateness.record(late_ns);
        counts.late += u64::from(late_ns > LATE_NS);
    }
}

/// The thread that keeps time.
struct CadenceLoop {
    unit: Arc<SharedUnit>,
    settings: RunOptions,
    links: Vec<LinkOutput>,
    monitor: Arc<CadenceMonitor>,
}

impl CadenceLoop {
    fn keep_time(&mut self) -> Result<(), RunError> {
        let sleeper = Sleeper::new(self.settings.spin);
        // Without deadlines there is nothing to be on time for, and a thread that never sleeps must not have priority.
        if self.settings.realtime && self.settings.speed != Speed::Max {
            match ask_for_realtime() {
                Ok(()) => console::say("real-time priority (SCHED_FIFO) granted"),
                Err(error) => console::say(format_args!(
                    "real-time priority (SCHED_FIFO) not granted: {error}; it needs CAP_SYS_NICE or `ulimit -r`; the unit runs without"
                )),
            }
        }
        while self.settings.wait_for_client && !self.is_stopped() && !self.has_client() {
            thread::park_timeout(LOOK_AGAIN);
        }
        let limit = if self.settings.speed.is_faster_than_real() { PATIENCE } else { Duration::ZERO };
        let patience = Patience::new(limit, &self.monitor.stop);
        if !self.has_first_sample() {
            return Ok(());
        }
        self.refuse_untold()?;
        let start_ns = now_ns();
        let (mut missed, mut last_end_ns) = (0, 0);
        while !self.is_stopped() {
            self.unit.step_aside();
            let (ended, running_end_ns) = self.unit.running();
            if self.settings.half_seconds.is_some_and(|half_seconds| ended >= half_seconds) {
                break;
            }
            let deadline_ns = self.settings.speed.wall_ns(running_end_ns).map(|wall_ns| start_ns + wall_ns);
            if let Some(deadline_ns) = deadline_ns {
                self.doze_and_send_late(start_ns, deadline_ns - LEAD_NS, &patience);
                if self.is_stopped() {
                    break;
                }
            }
            if !self.has_truth() {
                break;
            }
            // Without deadlines the unit waits for its recording as it does for readers.
            while !patience.is_none() && !self.is_stopped() && !self.has_room_in_recording() {
                thread::park_timeout(LOOK_AGAIN);
            }
            let frame = ended;
            let (ended, injected) = self.unit.end_half_second();
            last_end_ns = ended.end_ns;
            let acting: &[Acting] = injected.as_ref().map_or(&[], |injected| &injected.acting);
            if self.is_past_next_deadline(start_ns) {
                missed += 1;
                self.links.iter_mut().for_each(|output| output.put(None, frame, ended.end_ns, &[]));
                self.unit.complete_unsent();
                self.report(frame, &ended);
                continue;
            }
            self.tell_missed(std::mem::take(&mut missed));
            let half_second = Some(&ended.half_second).filter(|_| ended.cyclic);
            for output in &mut self.links {
                output.put(half_second, frame, ended.end_ns, acting);
                output.prepare(ended.end_ns, &patience);
            }
            if let Some(deadline_ns) = deadline_ns {
                sleeper.until(deadline_ns);
            }
            let now_ns = now_ns();
            // Commands wait for the completion: not for readers, whom a faster run waits for.
            if !patience.is_none() {
                self.unit.complete();
            }
            self.links.iter_mut().for_each(|output| output.send_prepared(&patience));
            self.unit.complete();
            self.report(frame, &ended);
            if let Some(deadline_ns) = deadline_ns {
                self.monitor.record(now_ns - deadline_ns);
            }
        }
        self.tell_missed(missed);
        let patience = Patience::new(limit.max(LAST_WORDS), &self.monitor.stop);
        self.links.iter_mut().for_each(|output| output.end(last_end_ns, &patience));
        Ok(())
    }

    /// Has a truth from outside begin; not where the run was stopped meanwhile, or the source did not come.
    fn has_first_sample(&self) -> bool {
        let RunOptions { live, truth_wait, speed, .. } = &self.settings;
        let begin = |live: &Arc<Live>| live.await_first(*speed == Speed::Max, *truth_wait, || self.is_stopped());
        live.as_ref().is_none_or(begin)
    }

    /// Conditions on what a truth from outside turns out not to tell.
    fn refuse_untold(&self) -> Result<(), RunError> {
        if self.settings.live.as_ref().is_none_or(|live| live.tells_sun()) {
            return Ok(());
        }
        let faults = self.unit.faults();
        let planned: Vec<Fault> = faults.planned.iter().map(|planned| (*planned.fault).clone()).collect();
        let expectations: Vec<_> = faults.watches.iter().map(|watch| watch.expectation.clone()).collect();
        match asks_in_vain(&planned, &expectations, "the truth of this run", self.unit.untold()) {
            Some(why) => Err(RunError::Untold(why)),
            None => Ok(()),
        }
    }

    /// Reports the end of a half second to a source of the truth that asked for it: the links have their bytes.
    fn report(&mut self, half_second: u64, ended: &Ended) {
        let Some(live) = self.settings.live.as_ref().filter(|live| live.wants_reports()) else {
            self.links.iter_mut().for_each(LinkOutput::forget_handed);
            return;
        };
        live.report(&SampleReport {
            half_second,
            end_s: ended.end_ns as f64 * 1e-9,
            sequence: ended.half_second.sequence,
            clock_count: ended.half_second.clock_count,
            links: self.links.iter_mut().map(LinkOutput::take_handed).collect(),
        });
    }

    /// Waits until `wake_ns`, and sends what becomes due meanwhile because a fault held it back.
    fn doze_and_send_late(&mut self, start_ns: i64, wake_ns: i64, patience: &Patience) {
        let speed = self.settings.speed;
        while !self.is_stopped() && now_ns() < wake_ns {
            let next_ns = self.links.iter().filter_map(|output| output.queue.next_ns()).min();
            let next = next_ns.and_then(|due_ns| Some((due_ns, start_ns + speed.wall_ns(due_ns)?)));
            match next.filter(|(_, wall_ns)| *wall_ns < wake_ns) {
                Some((due_ns, wall_ns)) if wall_ns <= now_ns() => {
                    self.links.iter_mut().for_each(|output| output.send_due(due_ns, patience));
                }
                Some((_, wall_ns)) => doze_until(wall_ns),
                None => doze_until(wake_ns),
            }
        }
    }

    /// Has the truth of the running half second, where it comes from outside; not where the run was stopped meanwhile.
    fn has_truth(&self) -> bool {
        let RunOptions { live, truth_wait, speed, .. } = &self.settings;
        let (needed_s, waits) = (self.unit.needs_truth_s(), *speed == Speed::Max);
        live.as_ref().is_none_or(|live| live.finish(needed_s, waits, *truth_wait, || self.is_stopped()))
    }

    fn is_stopped(&self) -> bool {
        self.monitor.stop.is_asked()
    }

    fn has_room_in_recording(&self) -> bool {
        self.unit.recording().is_none_or(Status::has_ample_room)
    }

    fn has_client(&self) -> bool {
        self.links.iter().any(LinkOutput::has_client)
    }

    /// Whether the half second that just ended on board comes so late that the next is due already. In real time it
    /// is not sent then: a burst would show the receiver a unit that does not exist. A faster run is for its bytes.
    fn is_past_next_deadline(&self, start_ns: i64) -> bool {
        if self.settings.speed.is_faster_than_real() {
            return false;
        }
        let (_, next_end_ns) = self.unit.running();
        self.settings.speed.wall_ns(next_end_ns).is_some_and(|wall_ns| now_ns() > start_ns + wall_ns)
    }

    fn tell_missed(&self, missed: u64) {
        if missed > 0 {
            self.monitor.counts.lock().expect("nothing panics with the counts").missed += missed;
            let held_up = Time(missed * HALF_SECOND_NS as u64);
            console::say(format_args!(
                "{missed} half seconds not sent: the process was held up for about {held_up}; the sequence goes on behind them"
            ));
        }
    }
}
