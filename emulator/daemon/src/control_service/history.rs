//! The last ten minutes of the run, so that a client that comes late can draw them.
//!
//! Every sample is kept, at any speed. The thread that keeps time adds them and never waits: while somebody reads, they
//! wait on its side.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard};

use serde_json::{Value, json};

/// Samples kept: ten minutes of on-board time, about 150 kB.
const KEPT: usize = 1200;

/// A sample as charts need it.
#[derive(Debug, Clone, Copy)]
pub(super) struct HistorySample {
    /// On-board time at its end.
    pub t_s: f64,
    /// How many had ended, with this one.
    pub sample: u64,
    pub increments: [i16; 4],
    pub true_arcsec: [f64; 4],
    pub departure_arcsec: [f64; 4],
    pub gyro_flags: u8,
}

impl HistorySample {
    fn json(&self) -> Value {
        json!({
            "t_s": self.t_s, "half_second": self.sample, "increments": self.increments,
            "true_arcsec": self.true_arcsec, "departure_arcsec": self.departure_arcsec, "gyro_flags": self.gyro_flags,
        })
    }
}

/// The end that is read.
#[derive(Debug, Clone, Default)]
pub(super) struct History(Arc<Mutex<VecDeque<HistorySample>>>);

impl History {
    /// Those kept, the oldest first.
    pub fn json(&self) -> Value {
        let samples: Vec<HistorySample> = lock(&self.0).iter().copied().collect();
        samples.iter().map(HistorySample::json).collect()
    }
}

/// The end that is written.
#[derive(Debug)]
pub(super) struct Historian {
    history: History,
    waiting: VecDeque<HistorySample>,
}

impl Historian {
    pub fn new(history: History) -> Historian {
        Historian { history, waiting: VecDeque::new() }
    }

    pub fn push(&mut self, sample: HistorySample) {
        keep(&mut self.waiting, sample);
        if let Ok(mut kept) = self.history.0.try_lock() {
            self.waiting.drain(..).for_each(|sample| keep(&mut kept, sample));
        }
    }
}

fn keep(samples: &mut VecDeque<HistorySample>, sample: HistorySample) {
    if samples.len() == KEPT {
        samples.pop_front();
    }
    samples.push_back(sample);
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().expect("nothing panics with it")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(sample: u64) -> HistorySample {
        let t_s = sample as f64 * 0.5;
        HistorySample {
            t_s,
            sample,
            increments: [1, -2, 3, -4],
            true_arcsec: [0.5; 4],
            departure_arcsec: [0.0; 4],
            gyro_flags: 15,
        }
    }

    #[test]
    fn the_last_ten_minutes_are_kept_and_a_reader_holds_nobody_up() {
        let history = History::default();
        let mut historian = Historian::new(history.clone());
        (1..=3000).for_each(|sample| historian.push(self::sample(sample)));
        {
            let reader = lock(&history.0);
            (3001..=3010).for_each(|sample| historian.push(self::sample(sample)));
            assert_eq!(reader.back().map(|sample| sample.sample), Some(3000));
        }
        historian.push(sample(3011));
        let told = history.json();
        let told = told.as_array().expect("a list");
        let numbers: Vec<u64> = told.iter().filter_map(|sample| sample["half_second"].as_u64()).collect();
        assert_eq!(numbers, (1812..=3011).collect::<Vec<_>>());
        assert_eq!(told[0]["increments"], json!([1, -2, 3, -4]));
    }
}
