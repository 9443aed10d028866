//! Threads of a host: each runs only between its resumption and its next wait.

use std::fmt::{self, Display};
use std::ops::RangeInclusive;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};
use std::time::Duration;

use super::world::{CURRENT, Host, Turn, own, panic_text};

/// Time from the end of a sleep to the turn of the thread, ns.
const WAKE_UP_NS: RangeInclusive<i64> = 1_000..=150_000;
/// Probability to lose the turn at a lock.
const LOSES_TURN: f64 = 0.1;
/// Time for which the runtime may wait for a lock, ns.
const MAX_LOCK_NS: i64 = 2_000_000;
/// Limit of one turn on the real clock: beyond, a thread is blocked by something that the host does not simulate.
const REAL_TIMEOUT: Duration = Duration::from_secs(60);

pub(crate) type ThreadId = usize;

/// A thread, which runs only between its resumption and its next wait.
pub(super) struct SimulatedThread {
    pub name: String,
    pub state: State,
    resume: Sender<()>,
    waits: Receiver<State>,
}

pub(super) enum State {
    Ready,
    Until {
        wake_ns: i64,
        is_parked: bool,
    },
    /// Until this number of changes is exceeded.
    Change(u64),
    Done,
    Panicked(String),
}

impl Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            State::Ready => "has a turn",
            State::Until { .. } => "sleeps",
            State::Change(_) => "waits for another",
            State::Done => "has ended",
            State::Panicked(_) => "panicked",
        })
    }
}

/// The other side of a [`SimulatedThread`].
pub(super) struct Baton {
    resumed: Mutex<Receiver<()>>,
    waits: Sender<State>,
}

/// Ends a thread of a run that was given up.
struct GivenUp;

impl Baton {
    fn await_turn(&self) {
        if own(&self.resumed).recv().is_err() {
            resume_unwind(Box::new(GivenUp));
        }
    }
}

impl Host {
    /// A thread, and its work between turns.
    pub fn add_thread<T>(
        &self,
        name: &str,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> (ThreadId, impl FnOnce() -> T + Send + 'static) {
        let ((resume, resumed), (waits, waited)) = (channel(), channel());
        let mut threads = own(&self.shared.threads);
        let id = threads.len();
        threads.push(SimulatedThread { name: name.to_owned(), state: State::Ready, resume, waits: waited });
        let baton = Arc::new(Baton { resumed: Mutex::new(resumed), waits });
        let host = Host { shared: self.shared.clone(), baton: Some(baton.clone()) };
        let run = move || {
            CURRENT.set(Some(host));
            baton.await_turn();
            let result = catch_unwind(AssertUnwindSafe(work));
            let state = match &result {
                Ok(_) => State::Done,
                Err(panic) => State::Panicked(panic_text(&**panic)),
            };
            CURRENT.set(None);
            let _ = baton.waits.send(state);
            result.unwrap_or_else(|panic| resume_unwind(panic))
        };
        (id, run)
    }

    pub fn unpark(&self, id: ThreadId) {
        let thread = &mut own(&self.shared.threads)[id];
        if let State::Until { is_parked: true, .. } = thread.state {
            thread.state = State::Ready;
        }
    }

    pub fn sleep_thread_until(&self, wake_ns: i64) {
        self.wait(State::Until { wake_ns: wake_ns + self.draw(WAKE_UP_NS), is_parked: false });
    }

    pub fn park_thread_until(&self, wake_ns: i64) {
        self.wait(State::Until { wake_ns: wake_ns + self.draw(WAKE_UP_NS), is_parked: true });
    }

    pub fn yield_thread(&self) {
        self.wait(State::Ready);
    }

    /// The next message; `None` once there are no senders.
    pub fn receive<T>(&self, messages: &Receiver<T>) -> Option<T> {
        loop {
            let changes = self.shared.changes.load(Relaxed);
            match messages.try_recv() {
                Ok(message) => return Some(message),
                Err(TryRecvError::Disconnected) => return None,
                Err(TryRecvError::Empty) => self.wait(State::Change(changes)),
            }
        }
    }

    /// Passes the turn on.
    fn wait(&self, state: State) {
        let baton = self.baton.as_ref().expect("the runtime waits for nothing");
        if std::thread::panicking() {
            return;
        }
        let _ = baton.waits.send(state);
        baton.await_turn();
    }

    /// At any lock a thread may lose its turn, and threads may run beside the runtime.
    pub fn lock<'a, T>(&self, mutex: &'a Mutex<T>) -> MutexGuard<'a, T> {
        if self.happens(LOSES_TURN) {
            match self.baton {
                Some(_) => self.wait(State::Ready),
                None => drop(self.run_beside()),
            }
        }
        let start_ns = self.now_ns();
        loop {
            match mutex.try_lock() {
                Ok(guard) => return guard,
                Err(TryLockError::Poisoned(_)) => panic!("a thread panicked while it held a lock"),
                Err(TryLockError::WouldBlock) => {}
            }
            match self.baton {
                Some(_) => self.wait(State::Change(self.shared.changes.load(Relaxed))),
                None => self.wait_for_lock(start_ns),
            }
        }
    }

    /// The runtime waits for a lock: only threads run.
    fn wait_for_lock(&self, start_ns: i64) {
        let waited_ns = self.now_ns() - start_ns;
        assert!(waited_ns <= MAX_LOCK_NS, "the runtime has waited {waited_ns} ns for a lock");
        if !self.run_beside() {
            self.pass_time(true);
        }
    }

    /// A thread has a turn beside the runtime; false if none is ready.
    fn run_beside(&self) -> bool {
        let threads = self.ready_threads(true);
        let any = !threads.is_empty();
        if any {
            self.turn(threads[self.draw(0..=threads.len() as i64 - 1) as usize]);
        }
        any
    }

    pub(super) fn ready_threads(&self, looks: bool) -> Vec<Turn> {
        let (now_ns, changes) = (self.shared.now_ns.load(Relaxed), self.shared.changes.load(Relaxed));
        let is_ready = |thread: &SimulatedThread| match thread.state {
            State::Ready => true,
            State::Until { wake_ns, .. } => wake_ns <= now_ns,
            State::Change(seen) => looks && changes > seen,
            State::Done | State::Panicked(_) => false,
        };
        let threads = own(&self.shared.threads);
        (0..threads.len()).filter(|&id| is_ready(&threads[id])).map(Turn::Thread).collect()
    }

    pub(super) fn resume(&self, id: ThreadId) {
        let (name, waits) = {
            let mut threads = own(&self.shared.threads);
            threads[id].state = State::Ready;
            let _ = threads[id].resume.send(());
            // Taken out, so that the thread can start others.
            let waits = std::mem::replace(&mut threads[id].waits, channel().1);
            (threads[id].name.clone(), waits)
        };
        let state = waits.recv_timeout(REAL_TIMEOUT).unwrap_or_else(|_| {
            State::Panicked("blocked by something that the host does not simulate, or loops".to_owned())
        });
        if let State::Panicked(message) = &state {
            self.fail(format_args!("{name}: {message}"));
        }
        if !matches!(state, State::Change(_)) {
            self.shared.changes.fetch_add(1, Relaxed);
        }
        let thread = &mut own(&self.shared.threads)[id];
        (thread.state, thread.waits) = (state, waits);
    }
}
