//! Cache of model runs on a recorded motion.
//!
//! A diagnosis repeats runs, or changes one gyro of them. The counts of a gyro depend on the unit, on its own configuration and on the
//! time shifts, so that a gyro is counted again only if no cached run has it.

use std::sync::{Arc, Mutex, PoisonError};

use geu_model::attitude::RecordedAttitude;
use geu_model::configuration::GyroConfiguration;
use geu_model::temperature::ElectronicsCourse;
use geu_model::{Configuration, FollowedSamples, GyroUnit, MeasuredTemperatures, SomeSamples};

use super::series::{CHANNELS, Shifts, TIMING};

/// Cached runs: a run for each free parameter of a few alternating states.
const KEPT: usize = 24;

/// Longest recording of which the motion is kept, two days: it takes 460 bytes a sample.
const MAX_KEPT_SAMPLES: usize = 345_600;
/// Samples that all gyros count before the next ones: their motion fits into the cache of a core.
const AT_ONCE: usize = 100;

/// The last runs on one recording.
#[derive(Debug, Default)]
pub(super) struct ModelCache {
    /// In the order of use.
    kept: Mutex<Vec<CachedRun>>,
    /// The motion delayed by the last lag.
    delayed: Mutex<Option<(f64, Arc<RecordedAttitude>)>>,
    /// The samples on that motion, for units that keep time.
    followed: Mutex<Option<(f64, Arc<FollowedSamples>)>>,
    /// The measured temperatures with the last delay and the reference temperature.
    temperatures: Mutex<Option<([f64; 2], Arc<MeasuredTemperatures>)>>,
}

/// A copy of a recording may change: it starts with an empty cache.
impl Clone for ModelCache {
    fn clone(&self) -> ModelCache {
        ModelCache::default()
    }
}

/// One run; `None` for a channel that is to be counted.
#[derive(Debug, Clone)]
pub(super) struct CachedRun {
    /// The configuration without its gyros.
    pub(super) unit: Configuration,
    gyros: Vec<GyroConfiguration>,
    shifts: Shifts,
    pub(super) channels: [Option<Arc<Vec<f64>>>; CHANNELS],
}

impl CachedRun {
    /// True if the unit of the other and the time shifts are the same.
    fn is_of_unit(&self, other: &CachedRun) -> bool {
        self.shifts == other.shifts && self.unit == other.unit
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

    /// Passes the next samples of a unit on the motion delayed by a lag to `count`, some at a time.
    pub(super) fn follow(&self, mut unit: GyroUnit, lag_s: f64, samples: usize, mut count: impl FnMut(SomeSamples)) {
        if !unit.keeps_time() || samples > MAX_KEPT_SAMPLES {
            for from in (0..samples).step_by(AT_ONCE) {
                unit.follow(AT_ONCE.min(samples - from)).chunks(AT_ONCE).for_each(&mut count);
            }
            return;
        }
        let followed = {
            let mut kept = self.followed.lock().unwrap_or_else(PoisonError::into_inner);
            match &*kept {
                Some((own_s, followed)) if *own_s == lag_s => followed.clone(),
                _ => {
                    *kept = None;
                    kept.insert((lag_s, Arc::new(unit.follow(samples)))).1.clone()
                }
            }
        };
        followed.chunks(AT_ONCE).for_each(count);
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

    /// A run with its cached channels.
    pub(super) fn known(&self, configuration: &Configuration, shifts: Shifts) -> CachedRun {
        let mut unit = configuration.clone();
        let gyros = std::mem::take(&mut unit.gyros);
        let mut run = CachedRun { unit, gyros, shifts, channels: Default::default() };
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let matches: Vec<bool> = kept.iter().map(|other| run.is_of_unit(other)).collect();
        let mut is_used = vec![false; kept.len()];
        run.channels = std::array::from_fn(|channel| {
            let is_empty = channel != TIMING && channel >= run.gyros.len();
            if is_empty {
                return Some(Arc::default());
            }
            let has = |place: &usize| {
                matches[*place] && (channel == TIMING || kept[*place].gyros[channel] == run.gyros[channel])
            };
            let place = (0..kept.len()).rev().find(has)?;
            is_used[place] |= channel != TIMING;
            kept[place].channels[channel].clone()
        });
        // Used runs go last.
        let mut used = is_used.into_iter();
        let (last, mut first): (Vec<CachedRun>, Vec<CachedRun>) =
            kept.drain(..).partition(|_| used.next() == Some(true));
        first.extend(last);
        *kept = first;
        run
    }

    /// Adds a run, in place of the one unused for longest.
    pub(super) fn keep(&self, run: CachedRun) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        // Another thread may have run the same.
        kept.retain(|other| !(other.is_of_unit(&run) && other.gyros == run.gyros));
        if kept.len() >= KEPT {
            kept.remove(0);
        }
        kept.push(run);
    }
}
