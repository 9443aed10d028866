//! Results that recur: orders of the search, passes and exchanges reach the same states.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

/// Results kept. A fitted state takes some kilobytes beside its signatures, which states share; a list of candidates takes as much.
const KEPT: usize = 512;

/// The last results, by the hash of all that each depends on.
#[derive(Debug)]
pub struct Recent<T>(Mutex<VecDeque<(u64, T)>>);

impl<T> Default for Recent<T> {
    fn default() -> Recent<T> {
        Recent(Mutex::default())
    }
}

impl<T: Clone> Recent<T> {
    /// The result, if it is known.
    pub fn find(&self, key: u64) -> Option<T> {
        let kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.iter().rev().find(|(own, _)| *own == key).map(|(_, result)| result.clone())
    }

    /// Adds a result, in place of the oldest.
    pub fn keep(&self, key: u64, result: &T) {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.len() >= KEPT {
            kept.pop_front();
        }
        kept.push_back((key, result.clone()));
    }
}
