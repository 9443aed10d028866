//! Runs of the model on a recorded motion.
//!
//! A diagnosis asks for the same run again and again, or for one that differs in one gyro. So the last runs are kept, and a gyro is
//! counted only where none of them has it: what it counts depends on the unit, on its own numbers, and on how the times lie.

use std::sync::{Arc, Mutex, PoisonError};

use geu_model::attitude::Recorded;
use geu_model::configuration::GyroConfiguration;
use geu_model::units::{HALF_SECOND_NS, HALF_SECOND_S};
use geu_model::{Configuration, Truth, Unit};

use crate::later::begin_later;

use super::{CHANNELS, Measured, Series, Shifts, TIMING, TIMING_UNIT_S};

/// Runs that are kept: with more, hardly any other is found again.
const KEPT: usize = 8;

/// What was run lately on one recording.
#[derive(Debug, Default)]
pub(super) struct Runs {
    /// The last one of use last.
    kept: Mutex<Vec<Run>>,
    /// The motion moved by a lag: the last one asked for.
    lagging: Mutex<Option<(f64, Arc<Recorded>)>>,
}

/// A copy of a recording becomes another one, on which nothing was run.
impl Clone for Runs {
    fn clone(&self) -> Runs {
        Runs::default()
    }
}

/// One run.
#[derive(Debug, Clone)]
struct Run {
    /// The configuration, its gyros apart.
    unit: Configuration,
    gyros: [GyroConfiguration; 4],
    shifts: Shifts,
    channels: [Arc<Vec<f64>>; CHANNELS],
}

impl Run {
    /// Whether the unit and the times were these.
    fn is_of(&self, unit: &Configuration, shifts: Shifts) -> bool {
        self.shifts == shifts && self.unit == *unit
    }
}

impl Runs {
    /// The channels that were run like this, of whatever runs.
    fn known(
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

    fn keep(&self, run: Run) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        // Another thread may have asked for the same.
        kept.retain(|other| !(other.is_of(&run.unit, run.shifts) && other.gyros == run.gyros));
        if kept.len() >= KEPT {
            kept.remove(0);
        }
        kept.push(run);
    }
}

impl Measured {
    /// A model without its noise, on this motion and at these temperatures, at each node: accumulated counts before rounding, and
    /// how much later than nominal its half seconds end.
    pub fn run(&self, configuration: &Configuration, shifts: Shifts) -> Series {
        let mut unit = configuration.clone();
        let gyros = std::mem::take(&mut unit.gyros);
        let known = self.runs.known(&unit, &gyros, shifts);
        if known.iter().all(Option::is_some) {
            return known.map(|channel| channel.map(|channel| channel.to_vec()).unwrap_or_default());
        }
        let series = self.run_on(std::array::from_fn(|gyro| known[gyro].is_none()), configuration, shifts);
        let mut series = series.into_iter();
        let channels = known.map(|known| {
            let run = series.next().unwrap_or_default();
            known.unwrap_or_else(|| Arc::new(run))
        });
        let series = channels.each_ref().map(|channel| channel.to_vec());
        self.runs.keep(Run { unit, gyros, shifts, channels });
        series
    }

    /// A run that counts these gyros alone.
    fn run_on(
        &self,
        gyros: [bool; 4],
        configuration: &Configuration,
        Shifts { lag_s, temperature_s }: Shifts,
    ) -> Series {
        let reference = self.reference_at(lag_s);
        let mut unit = Unit::on(&self.quiet(configuration, temperature_s), &Truth::Recorded(reference));
        unit.follow_sensor(table(&self.counts.sensor_c, 0.0));
        unit.count_only(gyros);
        let mut series: Series = std::array::from_fn(|_| Vec::with_capacity(self.half_seconds + 1));
        for channel in &mut series {
            channel.push(0.0);
        }
        for node in 1..=self.half_seconds {
            let ended = unit.end_half_second();
            for (channel, counts) in series.iter_mut().zip(unit.accumulated_counts()) {
                channel.push(counts);
            }
            let late_ns = ended.end_ns - node as i64 * HALF_SECOND_NS;
            series[TIMING].push(late_ns as f64 * 1e-9 / TIMING_UNIT_S);
        }
        series
    }

    /// The motion as recorded times tell it that are so much late; the last one asked for is kept.
    fn reference_at(&self, lag_s: f64) -> Arc<Recorded> {
        if lag_s == 0.0 {
            return self.reference.clone();
        }
        let mut kept = self.runs.lagging.lock().unwrap_or_else(PoisonError::into_inner);
        match &*kept {
            Some((own_s, reference)) if *own_s == lag_s => reference.clone(),
            _ => {
                let start_s = self.reference.start_s() + lag_s;
                let reference = Arc::new(Recorded::clone(&self.reference).starting_at(start_s));
                *kept = Some((lag_s, reference.clone()));
                reference
            }
        }
    }

    /// The configuration as the model of this recording: no noise, no wiring faults (exact checks have mended the rows), temperatures
    /// as measured.
    fn quiet(&self, configuration: &Configuration, temperature_s: f64) -> Configuration {
        let mut quiet = configuration.clone();
        quiet.unit = quiet.unit.without_noise();
        for gyro in &mut quiet.gyros {
            gyro.effects = std::mem::take(&mut gyro.effects).without_noise();
            gyro.wiring = Default::default();
        }
        (quiet.electronics.numbers.amplitude_k, quiet.electronics.numbers.trend_k_per_day) = (0.0, 0.0);
        if self.start_s != 0.0 {
            begin_later(&mut quiet, self.start_s);
        }
        quiet.electronics.table = table(&self.counts.electronics_c, temperature_s);
        quiet
    }
}

/// Temperatures at nodes that were told so much later than they were.
fn table(celsius: &[f64], late_s: f64) -> Vec<(f64, f64)> {
    (0..celsius.len()).map(|node| node as f64 * HALF_SECOND_S - late_s).zip(celsius.iter().copied()).collect()
}
