//! The host of the unit: its clock, threads, tasks, timers and locks.
//!
//! In tests a simulated host can take its place ([`crate::simulation`]): one thread or task runs at a time, in an order that a
//! seed decides, on a clock that advances only while all of them wait.

use std::future::Future;
use std::io;
use std::ops::{Add, Sub};
use std::pin::pin;
use std::sync::mpsc::Receiver;
use std::sync::{Mutex, MutexGuard};
use std::thread;
use std::time::Duration;

use nix::errno::Errno;
use nix::sys::time::TimeSpec;
use nix::time::{ClockId, ClockNanosleepFlags, clock_gettime, clock_nanosleep};

#[cfg(test)]
use crate::simulation::host as simulated;

const NS_PER_S: i64 = 1_000_000_000;

/// Now on the monotonic clock, ns.
pub fn now_ns() -> i64 {
    #[cfg(test)]
    if let Some(host) = simulated() {
        return host.now_ns();
    }
    let now = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("every Linux has CLOCK_MONOTONIC");
    now.tv_sec() * NS_PER_S + now.tv_nsec()
}

/// A time on the monotonic clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Instant(i64);

impl Instant {
    pub fn now() -> Instant {
        Instant(now_ns())
    }

    pub fn elapsed(self) -> Duration {
        Instant::now() - self
    }
}

impl Add<Duration> for Instant {
    type Output = Instant;

    fn add(self, duration: Duration) -> Instant {
        Instant(self.0.saturating_add(ns(duration)))
    }
}

impl Sub for Instant {
    type Output = Duration;

    /// Zero if `earlier` is later.
    fn sub(self, earlier: Instant) -> Duration {
        Duration::from_nanos(self.0.saturating_sub(earlier.0).max(0) as u64)
    }
}

fn ns(duration: Duration) -> i64 {
    duration.as_nanos().min(i64::MAX as u128) as i64
}

/// Sleeps until an absolute time; never returns early.
pub(crate) fn sleep_thread_until(wake_ns: i64) {
    #[cfg(test)]
    if let Some(host) = simulated() {
        return host.sleep_thread_until(wake_ns);
    }
    let wake = TimeSpec::new(wake_ns.div_euclid(NS_PER_S), wake_ns.rem_euclid(NS_PER_S));
    while clock_nanosleep(ClockId::CLOCK_MONOTONIC, ClockNanosleepFlags::TIMER_ABSTIME, &wake) == Err(Errno::EINTR) {}
}

/// Sleeps on a thread without a runtime.
pub(crate) fn sleep_thread(duration: Duration) {
    #[cfg(test)]
    if let Some(host) = simulated() {
        return host.sleep_thread_until(now_ns() + ns(duration));
    }
    thread::sleep(duration);
}

/// Parks this thread; [`Thread::unpark`] returns early.
pub(crate) fn park_thread(duration: Duration) {
    #[cfg(test)]
    if let Some(host) = simulated() {
        return host.park_thread_until(now_ns() + ns(duration));
    }
    thread::park_timeout(duration);
}

/// Lets other threads run.
pub(crate) fn yield_thread() {
    #[cfg(test)]
    if let Some(host) = simulated() {
        return host.yield_thread();
    }
    thread::yield_now();
}

/// A thread beside the runtime.
pub(crate) struct Thread<T> {
    handle: thread::JoinHandle<T>,
    #[cfg(test)]
    simulated: Option<crate::simulation::ThreadId>,
}

impl<T: Send + 'static> Thread<T> {
    /// # Errors
    /// The thread cannot be started.
    pub fn spawn(name: &str, work: impl FnOnce() -> T + Send + 'static) -> io::Result<Thread<T>> {
        let builder = thread::Builder::new().name(name.to_owned());
        #[cfg(test)]
        if let Some(host) = simulated() {
            let (id, work) = host.add_thread(name, work);
            return Ok(Thread { handle: builder.spawn(work)?, simulated: Some(id) });
        }
        Ok(Thread {
            handle: builder.spawn(work)?,
            #[cfg(test)]
            simulated: None,
        })
    }

    pub fn unpark(&self) {
        #[cfg(test)]
        if let (Some(host), Some(id)) = (simulated(), self.simulated) {
            return host.unpark(id);
        }
        self.handle.thread().unpark();
    }

    /// The result of the thread, once it has ended.
    pub fn join(self) -> T {
        self.handle.join().expect("a thread of the unit does not panic")
    }
}

/// The next message; `None` once there are no senders.
pub(crate) fn receive<T>(messages: &Receiver<T>) -> Option<T> {
    #[cfg(test)]
    if let Some(host) = simulated() {
        return host.receive(messages);
    }
    messages.recv().ok()
}

/// Locks a mutex that is held for moments only.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    #[cfg(test)]
    if let Some(host) = simulated() {
        return host.lock(mutex);
    }
    mutex.lock().expect("no panic while locked")
}

/// Starts a task on the runtime.
pub(crate) fn spawn(task: impl Future<Output = ()> + Send + 'static) {
    #[cfg(test)]
    if let Some(host) = simulated() {
        return host.spawn(task);
    }
    tokio::spawn(task);
}

/// Waits on the runtime.
pub(crate) async fn sleep(duration: Duration) {
    #[cfg(test)]
    if let Some(host) = simulated() {
        return host.sleep_until(now_ns() + ns(duration)).await;
    }
    tokio::time::sleep(duration).await;
}

/// The result of a future; `None` if it takes longer than `limit`.
pub(crate) async fn timeout<T>(limit: Duration, future: impl Future<Output = T>) -> Option<T> {
    let (mut future, mut limit) = (pin!(future), pin!(sleep(limit)));
    tokio::select! {
        biased;
        result = &mut future => Some(result),
        () = &mut limit => None,
    }
}
