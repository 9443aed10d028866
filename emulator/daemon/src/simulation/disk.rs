//! A disk that is slow, stands still, or fails, and that loses unflushed data at a power cut.

use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard};

use super::world::{Host, host};
use crate::recorder_thread::Writer;
use geu_recorder::{End, RecordError, UnitEvent};

/// Stalls from this time on excuse a reply that does not wait for its record: the limit of that wait, with its jitter, ns.
const STALL_NS: i64 = 8_000_000;
/// A reply that was given during a stall may be read this long after it, ns.
const EXCUSED_NS: i64 = 1_500_000_000;

/// Behaviour of the disk.
#[derive(Debug, Clone, Copy)]
pub(super) struct Habits {
    /// Usual time of a flush, at most, ns.
    pub flush_ns: i64,
    /// Probability that a flush takes up to `stall_ns`.
    pub stalls: f64,
    pub stall_ns: i64,
    /// Probability that a write fails.
    pub fails: f64,
}

/// Flushed data.
#[derive(Default)]
pub(super) struct Disk(Mutex<Contents>);

#[derive(Default)]
pub(super) struct Contents {
    /// Commands, by link.
    pub commands: BTreeMap<String, u64>,
    /// Identifiers of injected and cleared faults.
    pub changes: Vec<String>,
    pub samples: u64,
    /// The disk works since then.
    busy_since_ns: Option<i64>,
    /// The last time at which it stood still.
    stalled_ns: Option<i64>,
    pub has_failed: bool,
    pub has_ended: bool,
}

impl Disk {
    pub fn contents(&self) -> MutexGuard<'_, Contents> {
        self.0.lock().expect("no panic while locked")
    }

    /// True if replies need not wait for their record: the disk stands still, or has of late, or has failed.
    pub fn is_excused(&self, now_ns: i64) -> bool {
        let contents = self.contents();
        let stands_still = contents.busy_since_ns.is_some_and(|since_ns| now_ns - since_ns >= STALL_NS);
        let has_stalled = contents.stalled_ns.is_some_and(|stalled_ns| now_ns - stalled_ns <= EXCUSED_NS);
        stands_still || has_stalled || contents.has_failed
    }

    /// The whole process stood still, with the disk.
    pub fn stood_still(&self, now_ns: i64) {
        self.contents().stalled_ns = Some(now_ns);
    }

    pub fn writer(self: &Arc<Disk>, habits: Habits) -> DiskWriter {
        DiskWriter { disk: self.clone(), habits, buffered: Vec::new(), samples: 0 }
    }
}

/// The recorder thread's side.
pub(super) struct DiskWriter {
    disk: Arc<Disk>,
    habits: Habits,
    /// Events that a power cut would lose.
    buffered: Vec<UnitEvent>,
    samples: u64,
}

impl DiskWriter {
    /// The disk works for a time.
    fn work(&self, host: &Host) -> Result<(), RecordError> {
        let longest_ns = if host.happens(self.habits.stalls) { self.habits.stall_ns } else { self.habits.flush_ns };
        let start_ns = host.now_ns();
        self.disk.contents().busy_since_ns = Some(start_ns);
        host.sleep_thread_until(start_ns + host.draw(0..=longest_ns));
        let now_ns = host.now_ns();
        let mut contents = self.disk.contents();
        contents.busy_since_ns = None;
        if now_ns - start_ns >= STALL_NS {
            contents.stalled_ns = Some(now_ns);
        }
        if host.happens(self.habits.fails) {
            contents.has_failed = true;
            let source = io::Error::from_raw_os_error(nix::libc::ENOSPC);
            return Err(RecordError::Write { path: "simulated".into(), source });
        }
        Ok(())
    }
}

impl Writer for DiskWriter {
    fn event(&mut self, event: &UnitEvent) -> Result<(), RecordError> {
        self.buffered.push(event.clone());
        self.samples += u64::from(matches!(event, UnitEvent::Sample(..)));
        let host = host().expect("simulated");
        // The buffer is full.
        if host.happens(0.01) { self.work(&host) } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<(), RecordError> {
        self.work(&host().expect("simulated"))?;
        let mut contents = self.disk.contents();
        for event in self.buffered.drain(..) {
            match event {
                UnitEvent::Sample(..) => contents.samples += 1,
                UnitEvent::Command { link, .. } => *contents.commands.entry(link).or_default() += 1,
                UnitEvent::Injected(fault) => contents.changes.push(fault.id),
                UnitEvent::Cleared { id, .. } => contents.changes.push(format!("{id} cleared")),
                _ => {}
            }
        }
        Ok(())
    }

    fn samples(&self) -> u64 {
        self.samples
    }

    fn end(mut self, end: End) -> Result<(), RecordError> {
        if matches!(end, End::Run | End::Early(_)) {
            self.flush()?;
        }
        self.disk.contents().has_ended = true;
        Ok(())
    }
}
