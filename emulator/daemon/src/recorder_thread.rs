//! Recording beside the live links: a separate thread writes, so that neither the cadence thread nor a reply waits for a disk.
//!
//! Memory limits what may wait for the disk. A recording that cannot keep up ends there, with a message; the unit continues. The
//! reply to a command or to an injected fault waits until it is recorded, at most [`REPLY_TIMEOUT`].

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use geu_model::configuration::EndedEarly;
use serde_json::{Value, json};
use tokio::sync::{oneshot, watch};

use crate::console;
use crate::host::{self, Instant, Thread};
use geu_recorder::{End, RecordError, Recorder, UnitEvent};

/// Memory that may wait for the disk: at rest four hours, at a thousand commands per second some minutes.
const MAX_WAITING: usize = 64 << 20;
/// A run without deadlines waits for its recording if more waits for the disk.
const AMPLE_WAITING: usize = MAX_WAITING / 8;
/// Interval of flushes while events come without a pause.
const FLUSH_INTERVAL: Duration = Duration::from_millis(5);
/// Maximum time for which a reply waits for the recording: half of the time allowed for a reply.
const REPLY_TIMEOUT: Duration = Duration::from_millis(10);
const POLL_INTERVAL: Duration = Duration::from_micros(200);

/// A recording that is not complete.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// It ended before the run.
    #[error(
        "the recording in {} ended at sample {sample}: {reason}; `geu simulate {}/run.toml` repeats the recorded part",
        .directory.display(), .directory.display()
    )]
    EndedEarly {
        /// Directory of the recording.
        directory: PathBuf,
        /// Samples of the unit by then.
        sample: u64,
        /// Cause.
        reason: String,
    },
    /// The disk did not accept the rest in time.
    #[error(
        "the recording in {} is cut: {waiting} bytes were still waiting for the disk when the process ended; `geu simulate {}/run.toml` repeats the recorded part",
        .directory.display(), .directory.display()
    )]
    Cut {
        /// Directory of the recording.
        directory: PathBuf,
        /// Approximate number of bytes in memory.
        waiting: usize,
    },
}

/// State of a recording, shared by all threads.
pub(crate) struct Status {
    directory: PathBuf,
    waiting_bytes: AtomicUsize,
    /// Number of events that are written.
    written: watch::Sender<u64>,
    /// A reply timed out on the disk, which has written nothing since.
    is_stalled: AtomicBool,
    ended: OnceLock<EndedEarly>,
}

impl Status {
    fn new(directory: &Path) -> Arc<Status> {
        Arc::new(Status {
            directory: directory.to_owned(),
            waiting_bytes: AtomicUsize::new(0),
            written: watch::Sender::new(0),
            is_stalled: AtomicBool::new(false),
            ended: OnceLock::new(),
        })
    }

    /// True if no more waits for the disk than permitted, or the recording has ended for that.
    #[cfg(test)]
    pub fn is_bounded(&self) -> bool {
        self.waiting_bytes.load(Relaxed) <= MAX_WAITING || self.ended.get().is_some()
    }

    /// True if a run without deadlines may continue.
    pub fn has_ample_capacity(&self) -> bool {
        self.waiting_bytes.load(Relaxed) <= AMPLE_WAITING || self.ended.get().is_some()
    }

    /// JSON for the control interface.
    pub fn to_json(&self) -> Value {
        let mut status = json!({ "directory": self.directory.display().to_string(), "state": "running" });
        if let Some(EndedEarly { sample, reason }) = self.ended.get() {
            status["state"] = json!("ended");
            status["half_second"] = json!(sample);
            status["reason"] = json!(reason);
        }
        status
    }

    /// Waits until `count` events are written, for a limited time.
    pub async fn await_written(&self, count: u64) {
        if self.is_stalled.load(Relaxed) {
            return;
        }
        let mut written = self.written.subscribe();
        if host::timeout(REPLY_TIMEOUT, written.wait_for(|written| *written >= count)).await.is_none() {
            self.stall(|| self.lacks(count));
        }
    }

    /// Waits in the same way on a thread without a runtime.
    pub fn await_written_blocking(&self, count: u64) {
        let start = Instant::now();
        while !self.is_stalled.load(Relaxed) && self.lacks(count) {
            if start.elapsed() > REPLY_TIMEOUT {
                return self.stall(|| self.lacks(count));
            }
            host::sleep_thread(POLL_INTERVAL);
        }
    }

    fn lacks(&self, count: u64) -> bool {
        *self.written.borrow() < count
    }

    /// A reply timed out: no other waits until the next write, unless that has come by now.
    fn stall(&self, is_waiting: impl Fn() -> bool) {
        if !is_waiting() {
            return;
        }
        self.is_stalled.store(true, Relaxed);
        // The writer may have written between the check and the store, and would not clear the mark again.
        if !is_waiting() {
            self.is_stalled.store(false, Relaxed);
        }
    }

    fn wrote(&self, count: u64) {
        self.written.send_replace(count);
        self.is_stalled.store(false, Relaxed);
    }

    /// Ends the recording, with a message; the first reason counts.
    fn end(&self, sample: u64, reason: String) {
        if self.ended.set(EndedEarly { sample, reason: reason.clone() }).is_ok() {
            // Releases the replies that wait.
            self.wrote(u64::MAX);
            console::say(format_args!(
                "the recording in {} ends at sample {sample}: {reason}; emulation continues without it",
                self.directory.display()
            ));
        }
    }
}

/// The sender of events to the recording; it never waits.
pub(crate) struct Feed {
    events: Sender<UnitEvent>,
    /// Number of events.
    pub count: u64,
    samples: u64,
    /// State of the recording.
    pub status: Arc<Status>,
}

impl Feed {
    /// Adds an event; `false` if the recording has ended.
    pub fn push(&mut self, event: UnitEvent) -> bool {
        let bytes = event.bytes();
        let waiting = self.status.waiting_bytes.fetch_add(bytes, Relaxed);
        if waiting + bytes > MAX_WAITING {
            self.status.end(self.samples, format!("the disk does not keep up: {waiting} bytes wait for it"));
        }
        self.count += 1;
        self.samples += u64::from(matches!(event, UnitEvent::Sample(..)));
        self.status.ended.get().is_none() && self.events.send(event).is_ok()
    }
}

/// A feed without a writer, for which no reply waits.
#[cfg(test)]
pub(crate) fn unwritten_feed() -> (Feed, Receiver<UnitEvent>) {
    let (feed, events) = feed(Path::new("nowhere"));
    feed.status.is_stalled.store(true, Relaxed);
    (feed, events)
}

fn feed(directory: &Path) -> (Feed, Receiver<UnitEvent>) {
    let (sender, events) = channel();
    (Feed { events: sender, count: 0, samples: 0, status: Status::new(directory) }, events)
}

/// The destination of the events of a recording.
pub(crate) trait Writer {
    fn event(&mut self, event: &UnitEvent) -> Result<(), RecordError>;
    fn flush(&mut self) -> Result<(), RecordError>;
    /// Number of samples written.
    fn samples(&self) -> u64;
    fn end(self, end: End) -> Result<(), RecordError>;
}

impl Writer for Recorder {
    fn event(&mut self, event: &UnitEvent) -> Result<(), RecordError> {
        Recorder::event(self, event)
    }

    fn flush(&mut self) -> Result<(), RecordError> {
        Recorder::flush(self)
    }

    fn samples(&self) -> u64 {
        Recorder::samples(self)
    }

    fn end(self, end: End) -> Result<(), RecordError> {
        Recorder::end(self, end)
    }
}

/// Opens the recording, reports that, and writes it to its end.
type Write = Box<dyn FnOnce(oneshot::Sender<Result<(), RecordError>>) + Send>;

/// The thread that writes a recording.
pub(crate) struct RecorderThread {
    /// `None` once the thread runs.
    planned: Option<Write>,
    is_done: Option<oneshot::Receiver<()>>,
    status: Arc<Status>,
}

impl RecorderThread {
    /// Prepares a recording into `directory`, which `create` opens; events wait until [`RecorderThread::open`].
    pub fn new<W: Writer>(
        directory: &Path,
        create: impl FnOnce() -> Result<W, RecordError> + Send + 'static,
    ) -> (Feed, RecorderThread) {
        let (feed, events) = feed(directory);
        let (status, own) = (feed.status.clone(), feed.status.clone());
        let run = move |opened: oneshot::Sender<_>| match create() {
            Err(error) => drop(opened.send(Err(error))),
            Ok(writer) => {
                let _ = opened.send(Ok(()));
                write(writer, &events, &own);
            }
        };
        (feed, RecorderThread { planned: Some(Box::new(run)), is_done: None, status })
    }

    /// Opens the recording on the thread that writes: a disk may hang.
    ///
    /// # Errors
    /// A recording that cannot begin.
    pub async fn open(&mut self) -> Result<(), RecordError> {
        let Some(run) = self.planned.take() else { return Ok(()) };
        let ((opened, is_open), (done, is_done)) = (oneshot::channel(), oneshot::channel());
        let thread = Thread::spawn("geu-recording", move || {
            run(opened);
            let _ = done.send(());
        });
        thread.map_err(|source| RecordError::Thread { directory: self.status.directory.clone(), source })?;
        self.is_done = Some(is_done);
        is_open.await.expect("the writer does not panic")
    }

    /// Waits until all is written or the recording has failed, at most until `deadline` resolves.
    ///
    /// # Errors
    /// A recording that is not complete.
    pub async fn finish(self, deadline: impl Future<Output = ()>) -> Result<(), RecordingError> {
        let is_done = match self.is_done {
            None => true,
            Some(done) => tokio::select! {
                biased;
                _ = done => true,
                () = deadline => false,
            },
        };
        let directory = self.status.directory.clone();
        match self.status.ended.get().cloned() {
            Some(EndedEarly { sample, reason }) => Err(RecordingError::EndedEarly { directory, sample, reason }),
            None if is_done => Ok(()),
            None => Err(RecordingError::Cut { directory, waiting: self.status.waiting_bytes.load(Relaxed) }),
        }
    }
}

/// Writes all events until the feed is dropped, and `run.toml`.
fn write(mut recorder: impl Writer, events: &Receiver<UnitEvent>, status: &Status) {
    let end = match write_events(&mut recorder, events, status) {
        Ok(()) => match status.ended.get() {
            None => End::Run,
            Some(EndedEarly { reason, .. }) => End::Early(reason.clone()),
        },
        Err(error) => {
            let reason = error.to_string();
            status.end(recorder.samples(), reason.clone());
            End::Failed(reason)
        }
    };
    let samples = recorder.samples();
    if let Err(error) = recorder.end(end) {
        status.end(samples, error.to_string());
    }
}

fn write_events(recorder: &mut impl Writer, events: &Receiver<UnitEvent>, status: &Status) -> Result<(), RecordError> {
    let (mut written, mut flushed) = (0, Instant::now());
    let mut next = host::receive(events);
    while let Some(event) = next {
        recorder.event(&event)?;
        written += 1;
        status.waiting_bytes.fetch_sub(event.bytes(), Relaxed);
        next = events.try_recv().ok();
        if next.is_none() || flushed.elapsed() >= FLUSH_INTERVAL {
            recorder.flush()?;
            status.wrote(written);
            flushed = Instant::now();
            next = next.or_else(|| host::receive(events));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use geu_model::configuration::LinkLogFormat;
    use geu_model::{Configuration, GyroUnit, Truth};

    use super::*;
    use geu_recorder::Destination;

    #[test]
    fn a_recording_that_cannot_keep_up_ends_with_its_sample_and_reason() {
        let temporary = tempfile::tempdir().expect("a directory");
        let (directory, configuration) = (temporary.path().join("run"), Configuration::reference());
        let (destination, planned) = (Destination::new(&directory, false), configuration.clone());
        let create =
            move || Recorder::create(&destination, &planned, &Truth::Scenario, LinkLogFormat::Serial, &[], None);
        let (mut feed, mut writer) = RecorderThread::new(&directory, create);
        let mut unit = GyroUnit::new(&configuration);
        // The thread does not run yet.
        let mut count = 0;
        loop {
            let (ended, traces) = unit.end_sample_traced();
            if !feed.push(UnitEvent::Sample(ended, traces, None)) {
                break;
            }
            count += 1;
        }
        assert!((10_000..100_000).contains(&count), "more than an hour, and bounded: {count} samples");
        let status = feed.status.to_json();
        assert_eq!((&status["state"], &status["half_second"]), (&json!("ended"), &json!(count)));
        assert!(status["reason"].as_str().expect("a reason").contains("does not keep up"), "{status}");
        assert!(feed.status.has_ample_capacity(), "a run does not wait for a recording that has ended");
        drop(feed);
        // The events until then are recorded when the disk responds again.
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        runtime.block_on(writer.open()).expect("it can begin");
        let error = runtime.block_on(writer.finish(std::future::pending())).expect_err("not complete").to_string();
        assert!(error.contains(&format!("ended at sample {count}")), "{error}");
        let text = std::fs::read_to_string(directory.join("run.toml")).expect("a run");
        let run = Configuration::parse("run.toml", &text, &[]).expect("a configuration").run;
        assert_eq!((run.duration_s, run.is_unfinished), (count as f64 * 0.5, false));
        assert_eq!(run.ended_early.map(|early| early.sample), Some(count));
        assert_eq!(std::fs::read(directory.join("link.bin")).expect("a link").len() as u64, count * 28);
    }

    #[test]
    fn a_write_at_the_timeout_is_no_stall() {
        let status = Status::new(Path::new("nowhere"));
        // Written before the first check, between it and the mark, and not at all.
        for (checks, is_stalled) in [(0, false), (1, false), (2, true)] {
            status.is_stalled.store(false, Relaxed);
            let checked = std::cell::Cell::new(0);
            status.stall(|| checked.replace(checked.get() + 1) < checks);
            assert_eq!(status.is_stalled.load(Relaxed), is_stalled, "{checks} checks");
        }
    }

    #[test]
    fn a_reply_waits_for_a_stalled_disk_once() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let status = Status::new(Path::new("nowhere"));
        let start = Instant::now();
        runtime.block_on(status.await_written(1));
        assert!(start.elapsed() >= REPLY_TIMEOUT);
        // Stalled now: a thousand more waits would take 10 s.
        (0..1000).for_each(|_| runtime.block_on(status.await_written(1)));
        status.await_written_blocking(1);
        assert!(start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
        status.wrote(1);
        runtime.block_on(status.await_written(1));
        assert!(!status.is_stalled.load(Relaxed), "replies wait again after a write");
    }
}
