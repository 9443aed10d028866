//! Cache of model runs on a recorded motion.
//!
//! A diagnosis repeats runs, or changes one gyro of them. The counts of a gyro depend on the unit, on its own configuration and on the
//! time shifts, so that a gyro is counted again only if no cached run has it.

use std::sync::{Arc, Mutex, PoisonError};

use geu_model::attitude::RecordedAttitude;
use geu_model::configuration::GyroConfiguration;
use geu_model::temperature::ElectronicsCourse;
use geu_model::{Configuration, MeasuredTemperatures};

use super::series::{CHANNELS, Shifts, TIMING};

/// Cached runs: a run for each free parameter of a few alternating states.
const KEPT: usize = 24;

/// The last runs on one recording.
#[derive(Debug, Default)]
pub(super) struct ModelCache {
    /// In the order of use.
    kept: Mutex<Vec<Run>>,
    /// The motion delayed by the last lag.
    delayed: Mutex<Option<(f64, Arc<RecordedAttitude>)>>,
    /// The measured temperatures with the last delay and the reference temperature.
    temperatures: Mutex<Option<([f64; 2], Arc<MeasuredTemperatures>)>>,
}

/// A copy of a recording may change: it starts with an empty cache.
impl Clone for ModelCache {
    fn clone(&self) -> ModelCache {
        ModelCache::default()
    }
}

/// One run.
#[derive(Debug, Clone)]
pub(super) struct Run {
    /// The configuration without its gyros.
    pub(super) unit: Configuration,
    pub(super) gyros: [GyroConfiguration; 4],
    pub(super) shifts: Shifts,
    pub(super) channels: [Arc<Vec<f64>>; CHANNELS],
}

impl Run {
    /// True for a run of this unit with these time shifts.
    fn is_of(&self, unit: &Configuration, shifts: Shifts) -> bool {
        self.shifts == shifts && self.unit == *unit
    }
}

impl ModelCache {
    /// The motion delayed by a lag.
    pub(super) fn delayed(&self, motion: &Arc<RecordedAttitude>, lag_s: f64) -> Arc<RecordedAttitude> {
        let mut kept = self.delayed.lock().unwrap_or_else(PoisonError::into_inner);
        match &*kept {
            _ if lag_s == 0.0 => motion.clone(),
            Some((own_s, delayed)) if *own_s == lag_s => delayed.clone(),
            _ => {
                let delayed = Arc::new(RecordedAttitude::clone(motion).starting_at(motion.start_s() + lag_s));
                *kept = Some((lag_s, delayed.clone()));
                delayed
            }
        }
    }

    /// The measured temperatures with a delay.
    pub(super) fn temperatures(
        &self,
        electronics: &ElectronicsCourse,
        late_s: f64,
        measured: impl FnOnce() -> MeasuredTemperatures,
    ) -> Arc<MeasuredTemperatures> {
        let key = [late_s, electronics.numbers.reference_c];
        let mut kept = self.temperatures.lock().unwrap_or_else(PoisonError::into_inner);
        match &*kept {
            Some((own, temperatures)) if *own == key => temperatures.clone(),
            _ => {
                let temperatures = Arc::new(measured());
                *kept = Some((key, temperatures.clone()));
                temperatures
            }
        }
    }

    /// Cached channels of such a run.
    pub(super) fn known(
        &self,
        unit: &Configuration,
        gyros: &[GyroConfiguration; 4],
        shifts: Shifts,
    ) -> [Option<Arc<Vec<f64>>>; CHANNELS] {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let matches: Vec<bool> = kept.iter().map(|run| run.is_of(unit, shifts)).collect();
        let mut is_used = vec![false; kept.len()];
        let known = std::array::from_fn(|channel| {
            let has =
                |place: &usize| matches[*place] && (channel == TIMING || kept[*place].gyros[channel] == gyros[channel]);
            let place = (0..kept.len()).rev().find(has)?;
            is_used[place] |= channel != TIMING;
            Some(kept[place].channels[channel].clone())
        });
        // Used runs go last.
        let mut used = is_used.into_iter();
        let (last, mut first): (Vec<Run>, Vec<Run>) = kept.drain(..).partition(|_| used.next() == Some(true));
        first.extend(last);
        *kept = first;
        known
    }

    /// Adds a run, in place of the one unused for longest.
    pub(super) fn keep(&self, run: Run) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        // Another thread may have run the same.
        kept.retain(|other| !(other.is_of(&run.unit, run.shifts) && other.gyros == run.gyros));
        if kept.len() >= KEPT {
            kept.remove(0);
        }
        kept.push(run);
    }
}
