//! Recording beside the live links: a thread of its own writes, and nobody who keeps time or answers waits for a disk.
//!
//! What waits for the disk is bounded by memory. A recording that cannot keep up ends there, and says so; the unit goes
//! on. A command or a live fault is answered when it was written, or after [`ANSWER_WITHIN`], whichever is first.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::{Duration, Instant};

use geu_model::configuration::EndedEarly;
use geu_model::units::on_board_s;
use serde_json::{Value, json};
use tokio::sync::{oneshot, watch};
use tokio::time::timeout;

use crate::console;
use crate::recorder::{End, RecordError, Recorder, UnitEvent};

/// Memory that may wait for the disk: at rest four hours, at a thousand commands a second some minutes.
const MOST_WAITING: usize = 64 << 20;
/// A run without deadlines waits for its recording where more waits for the disk.
const AMPLE_WAITING: usize = MOST_WAITING / 8;
/// While events come without a pause they are handed to the system so often.
const FLUSH: Duration = Duration::from_millis(5);
/// An answer waits so long at most until what it answers is written: half of what a reply may take.
const ANSWER_WITHIN: Duration = Duration::from_millis(10);
/// Between two looks whether something was written.
const LOOK_AGAIN: Duration = Duration::from_micros(200);

/// A recording that is not complete.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// It ended before the run.
    #[error(
        "the recording in {} ended at sample {sample}: {reason}; `geu simulate {}/run.toml` makes again what was recorded",
        .directory.display(), .directory.display()
    )]
    EndedEarly {
        /// Of the recording.
        directory: PathBuf,
        /// Samples of the unit by then.
        sample: u64,
        /// Why.
        reason: String,
    },
    /// The disk did not take the rest in time.
    #[error(
        "the recording in {} is cut: {waiting} bytes were still waiting for the disk when the process ended; `geu simulate {}/run.toml` makes again what was recorded",
        .directory.display(), .directory.display()
    )]
    Cut {
        /// Of the recording.
        directory: PathBuf,
        /// Bytes in memory, about.
        waiting: usize,
    },
}

/// How a recording stands, as all see it.
pub(crate) struct Status {
    directory: PathBuf,
    waiting_bytes: AtomicUsize,
    /// Events that the system has.
    written: watch::Sender<u64>,
    /// Somebody waited in vain for the disk, and it has written nothing since.
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

    /// Whether a run without deadlines may go on.
    pub fn has_ample_room(&self) -> bool {
        self.waiting_bytes.load(Relaxed) <= AMPLE_WAITING || self.ended.get().is_some()
    }

    /// As the control interface tells it.
    pub fn told(&self) -> Value {
        match self.ended.get() {
            None => json!({ "directory": self.directory.display().to_string(), "state": "running" }),
            Some(EndedEarly { sample, reason }) => json!({
                "directory": self.directory.display().to_string(), "state": "ended", "half_second": sample,
                "reason": reason,
            }),
        }
    }

    /// Waits until the system has so many events, but not for long.
    pub async fn await_written(&self, count: u64) {
        if self.is_stalled.load(Relaxed) {
            return;
        }
        let mut written = self.written.subscribe();
        if timeout(ANSWER_WITHIN, written.wait_for(|written| *written >= count)).await.is_err() {
            self.stall(|| !self.has_written(count));
        }
    }

    /// The same for whoever cannot wait otherwise. `count` gives nothing as long as it is not known.
    pub fn await_written_blocking(&self, count: impl Fn() -> Option<u64>) {
        let start = Instant::now();
        let is_waited_for = || count().is_none_or(|count| !self.has_written(count));
        while !self.is_stalled.load(Relaxed) && is_waited_for() {
            if start.elapsed() > ANSWER_WITHIN {
                return self.stall(is_waited_for);
            }
            thread::sleep(LOOK_AGAIN);
        }
    }

    fn has_written(&self, count: u64) -> bool {
        *self.written.borrow() >= count
    }

    /// The time of an answer is over: nobody waits again until something is written, unless it has been by now.
    fn stall(&self, is_waited_for: impl Fn() -> bool) {
        if !is_waited_for() {
            return;
        }
        self.is_stalled.store(true, Relaxed);
        // The writer may have written between the look and the store; then nobody else would take the mark away.
        if !is_waited_for() {
            self.is_stalled.store(false, Relaxed);
        }
    }

    fn wrote(&self, count: u64) {
        self.written.send_replace(count);
        self.is_stalled.store(false, Relaxed);
    }

    /// The recording ends for this reason, and says so; the first reason counts.
    fn end(&self, sample: u64, reason: String) {
        if self.ended.set(EndedEarly { sample, reason: reason.clone() }).is_ok() {
            // Whoever waits for it waits no longer.
            self.wrote(u64::MAX);
            console::say(format_args!(
                "the recording in {} ends at sample {sample} ({} s): {reason}; the unit goes on without it",
                self.directory.display(),
                on_board_s(sample)
            ));
        }
    }

    fn failure(&self) -> Result<(), RecordingError> {
        match self.ended.get() {
            None => Ok(()),
            Some(EndedEarly { sample, reason }) => Err(RecordingError::EndedEarly {
                directory: self.directory.clone(),
                sample: *sample,
                reason: reason.clone(),
            }),
        }
    }
}

/// The end that tells what happens, without ever waiting.
pub(crate) struct Feed {
    events: Sender<UnitEvent>,
    told: u64,
    samples: u64,
    status: Arc<Status>,
}

impl Feed {
    /// Tells what happened; `false` where the recording has ended.
    pub fn tell(&mut self, event: UnitEvent) -> bool {
        let bytes = event.bytes();
        let waiting = self.status.waiting_bytes.fetch_add(bytes, Relaxed);
        if waiting + bytes > MOST_WAITING {
            self.status.end(self.samples, format!("the disk does not keep up: {waiting} bytes wait for it"));
        }
        self.told += 1;
        self.samples += u64::from(matches!(event, UnitEvent::Sample(..)));
        self.status.ended.get().is_none() && self.events.send(event).is_ok()
    }

    /// Events told so far.
    pub fn told(&self) -> u64 {
        self.told
    }

    /// How the recording stands.
    pub fn status(&self) -> &Arc<Status> {
        &self.status
    }
}

/// A feed that nobody writes to a disk and no answer waits for.
#[cfg(test)]
pub(crate) fn unwritten_feed() -> (Feed, Receiver<UnitEvent>) {
    let (feed, events) = feed(Path::new("nowhere"));
    feed.status.is_stalled.store(true, Relaxed);
    (feed, events)
}

/// A feed and what comes out of it.
fn feed(directory: &Path) -> (Feed, Receiver<UnitEvent>) {
    let (sender, events) = channel();
    (Feed { events: sender, told: 0, samples: 0, status: Status::new(directory) }, events)
}

/// The thread that writes, before and after it begins.
pub(crate) struct RecorderThread {
    events: Option<Receiver<UnitEvent>>,
    is_done: Option<oneshot::Receiver<()>>,
    status: Arc<Status>,
}

impl RecorderThread {
    /// What is told from now on waits until [`RecorderThread::open`].
    pub fn new(directory: &Path) -> (Feed, RecorderThread) {
        let (feed, events) = feed(directory);
        let status = feed.status.clone();
        (feed, RecorderThread { events: Some(events), is_done: None, status })
    }

    /// Opens the recording on the thread that writes: a disk may hang.
    ///
    /// # Errors
    /// A recording that cannot begin.
    pub async fn open(
        &mut self,
        create: impl FnOnce() -> Result<Recorder, RecordError> + Send + 'static,
    ) -> Result<(), RecordError> {
        let Some(events) = self.events.take() else { return Ok(()) };
        let ((opened, is_open), (done, is_done)) = (oneshot::channel(), oneshot::channel());
        let status = self.status.clone();
        let thread = thread::Builder::new().name("geu-recording".to_owned()).spawn(move || {
            match create() {
                Err(error) => drop(opened.send(Err(error))),
                Ok(recorder) => {
                    let _ = opened.send(Ok(()));
                    write(recorder, &events, &status);
                }
            }
            let _ = done.send(());
        });
        thread.map_err(|source| RecordError::Thread { directory: self.status.directory.clone(), source })?;
        self.is_done = Some(is_done);
        is_open.await.expect("the writer does not panic")
    }

    /// Resolves when all is written, or the recording has failed.
    pub async fn done(&mut self) {
        if let Some(is_done) = &mut self.is_done {
            let _ = is_done.await;
            self.is_done = None;
        }
    }

    /// What became of it; `is_done`: the thread has ended.
    ///
    /// # Errors
    /// A recording that is not complete.
    pub fn result(&self, is_done: bool) -> Result<(), RecordingError> {
        self.status.failure()?;
        if is_done {
            return Ok(());
        }
        let waiting = self.status.waiting_bytes.load(Relaxed);
        Err(RecordingError::Cut { directory: self.status.directory.clone(), waiting })
    }
}

/// Writes what is told until no more can come, and what makes the run again.
fn write(mut recorder: Recorder, events: &Receiver<UnitEvent>, status: &Status) {
    let end = match take(&mut recorder, events, status) {
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

fn take(recorder: &mut Recorder, events: &Receiver<UnitEvent>, status: &Status) -> Result<(), RecordError> {
    let (mut written, mut flushed) = (0, Instant::now());
    loop {
        let event = match events.try_recv() {
            Ok(event) => event,
            Err(TryRecvError::Disconnected) => return Ok(()),
            Err(TryRecvError::Empty) => {
                recorder.flush()?;
                status.wrote(written);
                flushed = Instant::now();
                match events.recv() {
                    Ok(event) => event,
                    Err(_) => return Ok(()),
                }
            }
        };
        recorder.event(&event)?;
        written += 1;
        status.waiting_bytes.fetch_sub(event.bytes(), Relaxed);
        if flushed.elapsed() >= FLUSH {
            recorder.flush()?;
            status.wrote(written);
            flushed = Instant::now();
        }
    }
}

#[cfg(test)]
mod tests {
    use geu_model::configuration::LinkLogFormat;
    use geu_model::{Configuration, GyroUnit, Truth};

    use super::*;
    use crate::recorder::Destination;

    #[test]
    fn a_recording_that_cannot_keep_up_ends_and_says_where_and_why() {
        let room = tempfile::tempdir().expect("a directory");
        let (directory, configuration) = (room.path().join("run"), Configuration::reference());
        let (mut feed, mut writer) = RecorderThread::new(&directory);
        let mut unit = GyroUnit::new(&configuration);
        // Nobody writes yet.
        let mut told = 0;
        loop {
            let (ended, traces) = unit.end_sample_traced();
            if !feed.tell(UnitEvent::Sample(ended, Box::new(traces), None)) {
                break;
            }
            told += 1;
        }
        assert!((10_000..100_000).contains(&told), "an hour at least, and bounded: {told} samples");
        let status = feed.status().told();
        assert_eq!((&status["state"], &status["half_second"]), (&json!("ended"), &json!(told)));
        assert!(status["reason"].as_str().expect("a reason").contains("does not keep up"), "{status}");
        assert!(feed.status().has_ample_room(), "nobody waits for a recording that has ended");
        drop(feed);
        // What was told until then is recorded when the disk comes back.
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let destination = Destination::new(&directory, false);
        let create =
            move || Recorder::create(&destination, &configuration, &Truth::Scenario, LinkLogFormat::Serial, &[]);
        runtime.block_on(writer.open(create)).expect("it can begin");
        runtime.block_on(writer.done());
        let error = writer.result(true).expect_err("not complete").to_string();
        assert!(error.contains(&format!("ended at sample {told}")), "{error}");
        let text = std::fs::read_to_string(directory.join("run.toml")).expect("a run");
        let run = Configuration::parse("run.toml", &text, &[]).expect("a configuration").run;
        assert_eq!((run.duration_s, run.is_unfinished), (on_board_s(told), false));
        assert_eq!(run.ended_early.map(|early| early.sample), Some(told));
        assert_eq!(std::fs::read(directory.join("link.bin")).expect("a link").len() as u64, told * 28);
    }

    #[test]
    fn what_was_written_as_the_time_was_over_is_no_stall() {
        let status = Status::new(Path::new("nowhere"));
        // Written before the first look, between it and the mark, and not at all.
        for (looks, is_stalled) in [(0, false), (1, false), (2, true)] {
            status.is_stalled.store(false, Relaxed);
            let looked = std::cell::Cell::new(0);
            status.stall(|| looked.replace(looked.get() + 1) < looks);
            assert_eq!(status.is_stalled.load(Relaxed), is_stalled, "{looks} looks in vain");
        }
    }

    #[test]
    fn an_answer_waits_for_the_disk_once_and_not_for_long() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let status = Status::new(Path::new("nowhere"));
        let start = Instant::now();
        runtime.block_on(status.await_written(1));
        assert!(start.elapsed() >= ANSWER_WITHIN);
        // Now it is known to stall: a thousand answers more would be 10 s.
        (0..1000).for_each(|_| runtime.block_on(status.await_written(1)));
        status.await_written_blocking(|| Some(1));
        assert!(start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
        status.wrote(1);
        runtime.block_on(status.await_written(1));
        assert!(!status.is_stalled.load(Relaxed), "it writes again, and is waited for again");
    }
}
