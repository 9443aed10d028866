//! Recording beside the live links: a thread of its own writes, so that a slow disk never delays a half second.

use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crate::console;
use crate::record::{Event, RecordError, Recorder};

/// Half seconds that may wait for the disk: eight minutes in real time.
const QUEUE: usize = 1000;

/// A process that is killed loses so much of its recording at most, and what waits for the disk.
const FLUSH: Duration = Duration::from_secs(2);

/// The thread that writes.
pub(crate) struct Writer {
    thread: JoinHandle<Result<(), RecordError>>,
}

impl Writer {
    /// Begins to write what is sent.
    pub fn start(mut recorder: Recorder) -> (SyncSender<Event>, Writer) {
        let (sender, events) = sync_channel(QUEUE);
        let thread = thread::spawn(move || {
            let mut flushed = Instant::now();
            for event in events {
                let written = recorder.event(&event);
                let is_due = flushed.elapsed() >= FLUSH;
                if is_due {
                    flushed = Instant::now();
                }
                if let Err(error) = written.and_then(|()| if is_due { recorder.flush() } else { Ok(()) }) {
                    console::say(format_args!("recording ends here, the unit goes on: {error}"));
                    return Err(error);
                }
            }
            recorder.finish()
        });
        (sender, Writer { thread })
    }

    /// Waits until all is written.
    ///
    /// # Errors
    /// The file that could not be written.
    pub fn finish(self) -> Result<(), RecordError> {
        self.thread.join().expect("the writer does not panic")
    }
}
