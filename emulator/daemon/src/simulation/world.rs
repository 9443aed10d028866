//! A host in one process: its scheduler, clock and random numbers.

use std::cell::RefCell;
use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};
use std::fmt::Display;
use std::future::Future;
use std::ops::RangeInclusive;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::{Pin, pin};
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard};
use std::task::{Context, Poll, Wake, Waker};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::threads::{Baton, SimulatedThread, State, ThreadId};

/// Time of one turn of a thread or task, ns.
const TURN_NS: RangeInclusive<i64> = 500..=10_000;
/// The runtime's timers have a resolution of 1 ms.
const TIMER_NS: RangeInclusive<i64> = 0..=1_200_000;
/// Time for which something may have a turn all the time: clients send with pauses, so the unit must come to rest.
const MAX_BUSY_NS: i64 = 200_000_000;
/// Calls of the host in one turn: it loops without waiting.
const MAX_CALLS: u64 = 200_000;
/// Probability, while others have turns, that threads that wait for another have one too.
const LOOKS: f64 = 0.2;

/// The task of the run itself.
const MAIN: usize = usize::MAX;

thread_local! {
    pub(super) static CURRENT: RefCell<Option<Host>> = const { RefCell::new(None) };
}

/// The simulated host of this thread.
pub(crate) fn host() -> Option<Host> {
    CURRENT.with_borrow(Clone::clone)
}

/// A simulated host, as a thread of it sees it.
#[derive(Clone)]
pub(crate) struct Host {
    pub(super) shared: Arc<Shared>,
    /// `None` on the thread of the runtime.
    pub(super) baton: Option<Arc<Baton>>,
}

pub(super) struct Shared {
    pub now_ns: AtomicI64,
    random: Mutex<ChaCha8Rng>,
    tasks: Mutex<Vec<Option<Task>>>,
    /// When all were waiting for the last time.
    rest_ns: AtomicI64,
    /// Woken tasks, sorted: some channels wake their receivers in a random order.
    woken: Mutex<BTreeSet<usize>>,
    timers: Mutex<BinaryHeap<Reverse<Timer>>>,
    pub threads: Mutex<Vec<SimulatedThread>>,
    /// Number of turns, timers and moved bytes.
    pub changes: AtomicU64,
    calls: AtomicU64,
    failure: Mutex<Option<String>>,
    /// Digest of the order of all turns.
    digest: AtomicU64,
}

type Task = Pin<Box<dyn Future<Output = ()> + Send>>;

/// Time, order of its start, and waker.
struct Timer(i64, u64, Waker);

impl PartialEq for Timer {
    fn eq(&self, other: &Timer) -> bool {
        (self.0, self.1) == (other.0, other.1)
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
        (self.0, self.1).cmp(&(other.0, other.1))
    }
}

struct TaskWaker {
    task: usize,
    shared: Arc<Shared>,
}

impl Wake for TaskWaker {
    fn wake(self: Arc<TaskWaker>) {
        own(&self.shared.woken).insert(self.task);
    }
}

/// Locks data that only one thread at a time uses.
pub(super) fn own<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// A candidate for the next turn.
#[derive(Clone, Copy)]
pub(super) enum Turn {
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
    pub fn happens(&self, probability: f64) -> bool {
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

    /// A condition that a thread waits for may have changed.
    pub fn changed(&self) {
        self.shared.changes.fetch_add(1, Relaxed);
    }

    /// The whole process stands still, as after SIGSTOP.
    pub fn stall(&self, duration: Duration) {
        self.shared.now_ns.fetch_add(duration.as_nanos() as i64, Relaxed);
        self.shared.rest_ns.store(self.shared.now_ns.load(Relaxed), Relaxed);
    }

    pub(super) fn call(&self) {
        assert!(self.shared.calls.fetch_add(1, Relaxed) < MAX_CALLS, "livelock: one turn loops without waiting");
    }

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
            timers.push(Reverse(Timer(wake_ns, order, context.waker().clone())));
            Poll::Pending
        })
    }

    /// Runs to the result of `main`, or to a violation, for which it returns `None`; `check` is called after each turn.
    pub fn run<T>(&self, main: impl Future<Output = T>, check: impl Fn(&Host)) -> Option<T> {
        let mut main = pin!(main);
        own(&self.shared.woken).insert(MAIN);
        while self.failure().is_none() {
            let mut turns: Vec<Turn> = own(&self.shared.woken).iter().map(|&task| Turn::Task(task)).collect();
            // A thread that waits for another looks again after some turns: to look costs much.
            let looks = turns.is_empty() || self.happens(LOOKS);
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

    /// Moves the clock to the next timer or wake-up.
    pub(super) fn pass_time(&self, only_threads: bool) {
        let threads = own(&self.shared.threads);
        let wake_ups = threads.iter().filter_map(|thread| match thread.state {
            State::Until { wake_ns, .. } => Some(wake_ns),
            _ => None,
        });
        let timer = own(&self.shared.timers).peek().map(|Reverse(timer)| timer.0).filter(|_| !only_threads);
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
        while timers.peek().is_some_and(|Reverse(timer)| timer.0 <= now_ns) {
            let Some(Reverse(Timer(_, _, waker))) = timers.pop() else { return };
            self.shared.changes.fetch_add(1, Relaxed);
            waker.wake();
        }
    }

    pub(super) fn turn(&self, turn: Turn) {
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
}

pub(super) fn panic_text(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("a panic").to_owned()
}
