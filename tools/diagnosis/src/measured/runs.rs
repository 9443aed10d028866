//! Runs of the model on a recorded motion that are kept.
//!
//! A diagnosis asks for the same run again and again, or for one that differs in one gyro. So the last runs are kept, and a gyro is
//! counted only where none of them has it: what it counts depends on the unit, on its own numbers, and on how the times lie.

use std::sync::{Arc, Mutex, PoisonError};

use geu_model::Configuration;
use geu_model::attitude::RecordedAttitude;
use geu_model::configuration::GyroConfiguration;

use super::series::{CHANNELS, Shifts, TIMING};

/// Runs that are kept: with more, hardly any other is found again.
const KEPT: usize = 8;

/// What was run lately on one recording.
#[derive(Debug, Default)]
pub(super) struct ModelCache {
    /// The last one of use last.
    kept: Mutex<Vec<Run>>,
    /// The motion moved by a lag: the last one asked for.
    pub(super) lagging: Mutex<Option<(f64, Arc<RecordedAttitude>)>>,
}

/// A copy of a recording becomes another one, on which nothing was run.
impl Clone for ModelCache {
    fn clone(&self) -> ModelCache {
        ModelCache::default()
    }
}

/// One run.
#[derive(Debug, Clone)]
pub(super) struct Run {
    /// The configuration, its gyros apart.
    pub(super) unit: Configuration,
    pub(super) gyros: [GyroConfiguration; 4],
    pub(super) shifts: Shifts,
    pub(super) channels: [Arc<Vec<f64>>; CHANNELS],
}

impl Run {
    /// Whether the unit and the times were these.
    fn is_of(&self, unit: &Configuration, shifts: Shifts) -> bool {
        self.shifts == shifts && self.unit == *unit
    }
}

impl ModelCache {
    /// The channels that were run like this, of whatever runs.
    pub(super) fn known(
        &self,
        unit: &Configuration,
        gyros: &[GyroConfiguration; 4],
        shifts: Shifts,
    ) -> [Option<Arc<Vec<f64>>>; CHANNELS] {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let alike: Vec<bool> = kept.iter().map(|run| run.is_of(unit, shifts)).collect();
        let mut is_used = vec![false; kept.len()];
        let known = std::array::from_fn(|channel| {
            let has =
                |place: &usize| alike[*place] && (channel == TIMING || kept[*place].gyros[channel] == gyros[channel]);
            let place = (0..kept.len()).rev().find(has)?;
            is_used[place] |= channel != TIMING;
            Some(kept[place].channels[channel].clone())
        });
        // What was of use once more goes last.
        let mut used = is_used.into_iter();
        let (last, mut first): (Vec<Run>, Vec<Run>) = kept.drain(..).partition(|_| used.next() == Some(true));
        first.extend(last);
        *kept = first;
        known
    }

    pub(super) fn keep(&self, run: Run) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        // Another thread may have asked for the same.
        kept.retain(|other| !(other.is_of(&run.unit, run.shifts) && other.gyros == run.gyros));
        if kept.len() >= KEPT {
            kept.remove(0);
        }
        kept.push(run);
    }
}
