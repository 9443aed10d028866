//! Work on all cores, its results in the order of the work.

use std::collections::VecDeque;
use std::sync::OnceLock;
use std::sync::mpsc::{Receiver, sync_channel};

use rayon::{ThreadPool, ThreadPoolBuilder};

/// The threads of this process for readers and writers, as many as cores or `RAYON_NUM_THREADS`; `None` if it is one, or if no
/// threads can be started.
///
/// Calculations use other threads: a calculation that waits here would otherwise wait for itself.
pub fn pool() -> Option<&'static ThreadPool> {
    static POOL: OnceLock<Option<ThreadPool>> = OnceLock::new();
    let build = || {
        let pool = ThreadPoolBuilder::new().thread_name(|index| format!("reading {index}")).build().ok();
        pool.filter(|pool| pool.current_num_threads() > 1)
    };
    POOL.get_or_init(build).as_ref()
}

/// Results of work in a pool, in the order in which it was started.
pub struct Ordered<T> {
    pool: &'static ThreadPool,
    pending: VecDeque<Receiver<T>>,
}

impl<T: Send + 'static> Ordered<T> {
    pub fn new(pool: &'static ThreadPool) -> Ordered<T> {
        Ordered { pool, pending: VecDeque::new() }
    }

    pub fn start(&mut self, work: impl FnOnce() -> T + Send + 'static) {
        let (sender, receiver) = sync_channel(1);
        self.pending.push_back(receiver);
        // The receiver is gone if the results are no longer wanted.
        self.pool.spawn(move || drop(sender.send(work())));
    }

    /// True if there is work for every thread, and some that waits.
    pub fn is_full(&self) -> bool {
        self.pending.len() >= self.pool.current_num_threads() + 2
    }
}

impl<T> Iterator for Ordered<T> {
    type Item = T;

    /// Waits for the next result; `None` after the last one.
    fn next(&mut self) -> Option<T> {
        // A panic in the pool ends the process.
        self.pending.pop_front()?.recv().ok()
    }
}
