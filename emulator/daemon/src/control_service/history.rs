//! The samples of the last ten minutes, for the charts of a client that connects late.
//!
//! All samples are kept, at any speed, of a unit with shorter intervals one each 0.5 s. The cadence thread adds them without waiting: while a client reads, they wait in a
//! queue of that thread.

use std::collections::VecDeque;
use std::sync::Mutex;

use serde::{Serialize, Serializer};
use serde_json::{Value, json};

use crate::host::lock;

/// Number of samples kept: ten minutes of on-board time, about 150 kB.
const KEPT: usize = 1200;

/// A sample as charts need it.
#[derive(Debug, Clone, Serialize)]
pub(super) struct HistorySample {
    /// On-board time at its end.
    pub t_s: f64,
    /// Number of samples that had ended, including this one.
    #[serde(rename = "half_second")]
    pub sample: u64,
    /// Outputs as angles, arcsec.
    #[serde(serialize_with = "whole")]
    pub increments: Vec<f64>,
    pub true_arcsec: Vec<f64>,
    /// Increments less true rotation, summed over all samples until this one.
    pub departure_arcsec: Vec<f64>,
    pub gyro_flags: u8,
}

/// Writes whole numbers without a fraction.
fn whole<S: Serializer>(numbers: &[f64], serializer: S) -> Result<S::Ok, S::Error> {
    let number = |number: &f64| if number.fract() == 0.0 { json!(*number as i64) } else { json!(number) };
    serializer.collect_seq(numbers.iter().map(number))
}

/// The samples kept, oldest first.
#[derive(Debug, Default)]
pub(super) struct History(Mutex<VecDeque<HistorySample>>);

impl History {
    /// Adds a sample. While the history is being read, samples stay in `waiting`.
    pub fn push(&self, waiting: &mut VecDeque<HistorySample>, sample: HistorySample) {
        waiting.push_back(sample);
        if waiting.len() > KEPT {
            waiting.pop_front();
        }
        if let Ok(mut kept) = self.0.try_lock() {
            kept.append(waiting);
            let excess = kept.len().saturating_sub(KEPT);
            kept.drain(..excess);
        }
    }

    pub fn json(&self) -> Value {
        let samples = lock(&self.0).clone();
        json!(samples)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn history_sample(sample: u64) -> HistorySample {
        HistorySample {
            t_s: sample as f64 * 0.5,
            sample,
            increments: vec![1.0, -2.0, 3.0, -4.0],
            true_arcsec: vec![0.5; 4],
            departure_arcsec: vec![0.0; 4],
            gyro_flags: 15,
        }
    }

    #[test]
    fn history_keeps_ten_minutes_and_never_waits_for_a_reader() {
        let (history, mut waiting) = (History::default(), VecDeque::new());
        (1..=3000).for_each(|sample| history.push(&mut waiting, history_sample(sample)));
        {
            let reader = lock(&history.0);
            (3001..=3010).for_each(|sample| history.push(&mut waiting, history_sample(sample)));
            assert_eq!(reader.back().map(|sample| sample.sample), Some(3000));
        }
        history.push(&mut waiting, history_sample(3011));
        let json = history.json();
        let samples = json.as_array().expect("a list");
        let numbers: Vec<u64> = samples.iter().filter_map(|sample| sample["half_second"].as_u64()).collect();
        assert_eq!(numbers, (1812..=3011).collect::<Vec<_>>());
        assert_eq!(samples[0]["increments"], json!([1, -2, 3, -4]));
    }
}
