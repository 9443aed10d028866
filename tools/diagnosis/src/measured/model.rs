//! The model on a recorded motion.

use std::sync::{Arc, PoisonError};

use geu_model::attitude::RecordedAttitude;
use geu_model::units::{SAMPLE_INTERVAL_NS, SAMPLE_INTERVAL_S};
use geu_model::{Configuration, GyroUnit, Truth};

use crate::later::shift_origin;

use super::MeasuredData;
use super::runs::Run;
use super::series::{Series, Shifts, TIMING, TIMING_UNIT_S};

impl MeasuredData {
    /// A model without its noise, on this motion and at these temperatures, at each node: accumulated counts before rounding, and
    /// how much later than nominal its samples end.
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
        let mut unit = GyroUnit::on(&self.quiet(configuration, temperature_s), &Truth::Recorded(reference));
        unit.follow_sensor(table(&self.counts.sensor_c, 0.0));
        unit.count_only(gyros);
        let mut series: Series = std::array::from_fn(|_| Vec::with_capacity(self.samples + 1));
        for channel in &mut series {
            channel.push(0.0);
        }
        for node in 1..=self.samples {
            let ended = unit.end_sample();
            for (channel, counts) in series.iter_mut().zip(unit.accumulated_counts()) {
                channel.push(counts);
            }
            let late_ns = ended.end_ns - node as i64 * SAMPLE_INTERVAL_NS;
            series[TIMING].push(late_ns as f64 * 1e-9 / TIMING_UNIT_S);
        }
        series
    }

    /// The motion as recorded times tell it that are so much late; the last one asked for is kept.
    fn reference_at(&self, lag_s: f64) -> Arc<RecordedAttitude> {
        if lag_s == 0.0 {
            return self.reference.clone();
        }
        let mut kept = self.runs.lagging.lock().unwrap_or_else(PoisonError::into_inner);
        match &*kept {
            Some((own_s, reference)) if *own_s == lag_s => reference.clone(),
            _ => {
                let start_s = self.reference.start_s() + lag_s;
                let reference = Arc::new(RecordedAttitude::clone(&self.reference).starting_at(start_s));
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
            shift_origin(&mut quiet, self.start_s);
        }
        quiet.electronics.table = table(&self.counts.electronics_c, temperature_s);
        quiet
    }
}

/// Temperatures at nodes that were told so much later than they were.
fn table(celsius: &[f64], late_s: f64) -> Vec<(f64, f64)> {
    (0..celsius.len()).map(|node| node as f64 * SAMPLE_INTERVAL_S - late_s).zip(celsius.iter().copied()).collect()
}
