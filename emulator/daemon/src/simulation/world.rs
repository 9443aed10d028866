//! A host in one process: its scheduler, clock and chance.

use std::cell::RefCell;
use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};
use std::fmt::Display;
use std::future::Future;
use std::ops::RangeInclusive;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::pin::{Pin, pin};
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};
use std::task::{Context, Poll, Wake, Waker};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Time of one turn of a thread or task, ns.
const TURN_NS: RangeInclusive<i64> = 500..=10_000;
/// Time from the end of a sleep to the turn of the thread, ns.
const WAKE_UP_NS: RangeInclusive<i64> = 1_000..=150_000;
/// The runtime's timers have a resolution of 1 ms.
const TIMER_NS: RangeInclusive<i64> = 0..=1_200_000;
/// Time for which something may have a turn all the time: clients send with pauses, so the unit must come to rest.
const MAX_BUSY_NS: i64 = 200_000_000;
/// Calls of the host in one turn: it loops without waiting.
const MAX_CALLS: u64 = 200_000;
/// Probability to lose the turn at a lock.
const LOSES_TURN: f64 = 0.1;
/// Probability, while others have turns, that threads that wait for another have one too.
const LOOKS: f64 = 0.2;
/// Time for which the runtime may wait for a lock, ns.
const MAX_LOCK_NS: i64 = 2_000_000;
/// Time for which one turn may take, on the real clock: a thread is blocked by what the host does not simulate.
const REAL_TIMEOUT: Duration = Duration::from_secs(60);

/// The task of the run itself.
const MAIN: usize = usize::MAX;

pub(crate) type ThreadId = usize;

thread_local! {
    static CURRENT: RefCell<Option<Host>> = const { RefCell::new(None) };
}

/// The simulated host of this thread.
pub(crate) fn host() -> Option<Host> {
    CURRENT.with_borrow(Clone::clone)
}

/// A simulated host, as a thread of it sees it.
#[derive(Clone)]
pub(crate) struct Host {
    shared: Arc<Shared>,
    /// `None` on the thread of the runtime.
    baton: Option<Arc<Baton>>,
}

struct Shared {
    now_ns: AtomicI64,
    random: Mutex<ChaCha8Rng>,
    tasks: Mutex<Vec<Option<Task>>>,
    /// When all were waiting for the last time.
    rest_ns: AtomicI64,
    /// Tasks that were woken, sorted: some channels wake theirs in a random order.
    woken: Mutex<BTreeSet<usize>>,
    timers: Mutex<BinaryHeap<Reverse<Timer>>>,
    threads: Mutex<Vec<SimulatedThread>>,
    /// Turns, timers and moved bytes: what others wait for may have changed.
    changes: AtomicU64,
    calls: AtomicU64,
    failure: Mutex<Option<String>>,
    /// Digest of the order of all turns.
    digest: AtomicU64,
}

type Task = Pin<Box<dyn Future<Output = ()> + Send>>;

#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct TimerKey(i64, u64);

struct Timer(TimerKey, Waker);

impl PartialEq for Timer {
    fn eq(&self, other: &Timer) -> bool {
        self.0 == other.0
    }
}

impl Eq for Timer {}

impl PartialOrd for Timer {
    fn partial_cmp(&self, other: &Timer) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Timer {
    fn cmp(&self, other: &Timer) -> std::cmp::Ordering {
        self.0.cmp(&other.0)
    }
}

/// A thread, which runs only between its resumption and its next wait.
struct SimulatedThread {
    name: String,
    state: State,
    resume: Sender<()>,
    waits: Receiver<State>,
}

enum State {
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
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
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
struct Baton {
    resumed: Mutex<Receiver<()>>,
    waits: Sender<State>,
}

/// Ends a thread of a run that was given up.
struct GivenUp;

struct TaskWaker {
    task: usize,
    shared: Arc<Shared>,
}

impl Wake for TaskWaker {
    fn wake(self: Arc<TaskWaker>) {
        own(&self.shared.woken).insert(self.task);
    }
}

/// Locks what only one thread at a time uses.
fn own<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// What can have the next turn.
#[derive(Clone, Copy)]
enum Turn {
    Task(usize),
    Thread(ThreadId),
}

impl Host {
    /// A host of this thread, until dropped with [`Host::leave`].
    pub fn enter(seed: u64) -> Host {
        let shared = Shared {
            now_ns: AtomicI64::new(1_000_000_000),
            random: Mutex::new(ChaCha8Rng::seed_from_u64(seed)),
            tasks: Mutex::default(),
            rest_ns: AtomicI64::new(1_000_000_000),
            woken: Mutex::default(),
            timers: Mutex::default(),
            threads: Mutex::default(),
            changes: AtomicU64::new(1),
            calls: AtomicU64::new(0),
            failure: Mutex::default(),
            digest: AtomicU64::new(0),
        };
        let host = Host { shared: Arc::new(shared), baton: None };
        CURRENT.set(Some(host.clone()));
        host
    }

    /// Ends all tasks and threads.
    pub fn leave(self) {
        let tasks: Vec<_> = own(&self.shared.tasks).drain(..).collect();
        drop(tasks);
        own(&self.shared.timers).clear();
        own(&self.shared.threads).clear();
        CURRENT.set(None);
    }

    pub fn now_ns(&self) -> i64 {
        self.call();
        self.shared.now_ns.load(Relaxed)
    }

    /// A uniform random number.
    pub fn draw(&self, range: RangeInclusive<i64>) -> i64 {
        own(&self.shared.random).random_range(range)
    }

    /// True with this probability.
    pub fn chance(&self, probability: f64) -> bool {
        own(&self.shared.random).random_bool(probability)
    }

    pub fn digest(&self) -> u64 {
        self.shared.digest.load(Relaxed)
    }

    /// Adds a number to the digest.
    pub fn note(&self, number: u64) {
        let digest = (self.digest() ^ number).wrapping_mul(0x100_0000_01b3).rotate_left(17);
        self.shared.digest.store(digest, Relaxed);
    }

    /// The first violation counts.
    pub fn fail(&self, message: impl Display) {
        own(&self.shared.failure).get_or_insert_with(|| message.to_string());
    }

    pub fn failure(&self) -> Option<String> {
        own(&self.shared.failure).clone()
    }

    /// What others wait for may have changed.
    pub fn changed(&self) {
        self.shared.changes.fetch_add(1, Relaxed);
    }

    /// The whole process stands still, as after SIGSTOP.
    pub fn stall(&self, duration: Duration) {
        self.shared.now_ns.fetch_add(duration.as_nanos() as i64, Relaxed);
        self.shared.rest_ns.store(self.shared.now_ns.load(Relaxed), Relaxed);
    }

    fn call(&self) {
        assert!(self.shared.calls.fetch_add(1, Relaxed) < MAX_CALLS, "livelock: one turn loops without waiting");
    }

    // Threads.

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
        if self.chance(LOSES_TURN) {
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

    // Tasks.

    pub fn spawn(&self, task: impl Future<Output = ()> + Send + 'static) {
        let mut tasks = own(&self.shared.tasks);
        tasks.push(Some(Box::pin(task)));
        own(&self.shared.woken).insert(tasks.len() - 1);
    }

    pub fn sleep_until(&self, wake_ns: i64) -> impl Future<Output = ()> + Send + use<> {
        let (host, wake_ns) = (Host { baton: None, ..self.clone() }, wake_ns + self.draw(TIMER_NS));
        std::future::poll_fn(move |context| {
            if host.now_ns() >= wake_ns {
                return Poll::Ready(());
            }
            let mut timers = own(&host.shared.timers);
            let order = host.shared.changes.fetch_add(1, Relaxed);
            timers.push(Reverse(Timer(TimerKey(wake_ns, order), context.waker().clone())));
            Poll::Pending
        })
    }

    // Scheduler.

    /// Runs to the result of `main`, or to a violation, for which it returns `None`; `check` is called after each turn.
    pub fn run<T>(&self, main: impl Future<Output = T>, check: impl Fn(&Host)) -> Option<T> {
        let mut main = pin!(main);
        own(&self.shared.woken).insert(MAIN);
        while self.failure().is_none() {
            let mut turns: Vec<Turn> = own(&self.shared.woken).iter().map(|&task| Turn::Task(task)).collect();
            // A thread that waits for another looks again after some turns: to look costs much.
            let looks = turns.is_empty() || self.chance(LOOKS);
            turns.extend(self.ready_threads(looks));
            if turns.is_empty() {
                self.pass_time(false);
                continue;
            }
            let turn = turns[self.draw(0..=turns.len() as i64 - 1) as usize];
            if matches!(turn, Turn::Task(MAIN)) {
                own(&self.shared.woken).remove(&MAIN);
                if let Some(result) = self.poll(main.as_mut(), MAIN) {
                    return Some(result);
                }
            }
            self.turn(turn);
            let busy_ns = self.shared.now_ns.load(Relaxed) - self.shared.rest_ns.load(Relaxed);
            if busy_ns > MAX_BUSY_NS {
                self.fail(format_args!("livelock: something had a turn all the time for {} ms", busy_ns / 1_000_000));
            }
            check(self);
        }
        None
    }

    fn ready_threads(&self, looks: bool) -> Vec<Turn> {
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

    /// Moves the clock to the next timer or wake-up.
    fn pass_time(&self, only_threads: bool) {
        let threads = own(&self.shared.threads);
        let wake_ups = threads.iter().filter_map(|thread| match thread.state {
            State::Until { wake_ns, .. } => Some(wake_ns),
            _ => None,
        });
        let timer = own(&self.shared.timers).peek().map(|Reverse(timer)| timer.0.0).filter(|_| !only_threads);
        let Some(next_ns) = wake_ups.chain(timer).min() else {
            let states: Vec<String> =
                threads.iter().map(|thread| format!("{} {}", thread.name, thread.state)).collect();
            drop(threads);
            return self.fail(format_args!("deadlock: nothing has a turn or waits for a time; {}", states.join(", ")));
        };
        drop(threads);
        self.shared.now_ns.fetch_max(next_ns, Relaxed);
        self.shared.rest_ns.store(self.shared.now_ns.load(Relaxed), Relaxed);
        self.fire_timers();
    }

    fn fire_timers(&self) {
        let now_ns = self.shared.now_ns.load(Relaxed);
        let mut timers = own(&self.shared.timers);
        while timers.peek().is_some_and(|Reverse(timer)| timer.0.0 <= now_ns) {
            let Some(Reverse(Timer(_, waker))) = timers.pop() else { return };
            self.shared.changes.fetch_add(1, Relaxed);
            waker.wake();
        }
    }

    fn turn(&self, turn: Turn) {
        self.shared.calls.store(0, Relaxed);
        match turn {
            Turn::Task(task) => {
                self.poll_task(task);
                self.changed();
            }
            Turn::Thread(id) => self.resume(id),
        }
        self.note(match turn {
            Turn::Task(task) => task as u64,
            Turn::Thread(id) => 1 << 32 | id as u64,
        });
        let turn_ns = self.draw(TURN_NS);
        self.shared.now_ns.fetch_add(turn_ns, Relaxed);
        self.fire_timers();
    }

    fn poll_task(&self, index: usize) {
        own(&self.shared.woken).remove(&index);
        let Some(mut task) = own(&self.shared.tasks).get_mut(index).and_then(Option::take) else { return };
        if self.poll(task.as_mut(), index).is_none() {
            own(&self.shared.tasks)[index] = Some(task);
        }
    }

    fn poll<T>(&self, task: Pin<&mut (impl Future<Output = T> + ?Sized)>, index: usize) -> Option<T> {
        self.shared.calls.store(0, Relaxed);
        let waker = Waker::from(Arc::new(TaskWaker { task: index, shared: self.shared.clone() }));
        match catch_unwind(AssertUnwindSafe(|| task.poll(&mut Context::from_waker(&waker)))) {
            Ok(Poll::Pending) => None,
            Ok(Poll::Ready(result)) => Some(result),
            Err(panic) => {
                self.fail(panic_text(&*panic));
                None
            }
        }
    }

    fn resume(&self, id: ThreadId) {
        let (name, waits) = {
            let mut threads = own(&self.shared.threads);
            threads[id].state = State::Ready;
            let _ = threads[id].resume.send(());
            // Taken out, so that the thread can start others.
            let waits = std::mem::replace(&mut threads[id].waits, channel().1);
            (threads[id].name.clone(), waits)
        };
        let state = waits
            .recv_timeout(REAL_TIMEOUT)
            .unwrap_or_else(|_| State::Panicked("blocked by what the host does not simulate, or loops".to_owned()));
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

impl Baton {
    fn await_turn(&self) {
        if own(&self.resumed).recv().is_err() {
            resume_unwind(Box::new(GivenUp));
        }
    }
}

pub(super) fn panic_text(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("a panic").to_owned()
}
