//! Runs of the model on a recorded motion.

use std::sync::Arc;

use geu_model::effect::discovered::Formula;
use geu_model::{Configuration, GyroUnit, MeasuredTemperatures, Truth};
use geu_protocol::Gyros;

use crate::time_origin::shift_origin;

use super::model_cache::CachedRun;
use super::series::{ModelRun, Series, Shifts, TIMING, TIMING_UNIT_S};
use super::{BLOCK, MeasuredData, nodes};

impl MeasuredData {
    /// Runs a model without its noise on this motion at these temperatures: at each node the accumulated counts before rounding, and the
    /// delay of the sample's end against the nominal one.
    pub fn run(&self, configuration: &Configuration, shifts: Shifts) -> ModelRun {
        self.run_all(std::slice::from_ref(configuration), shifts).remove(0)
    }

    /// Runs several models. Neighbours that differ in their gyros alone follow the motion together, which takes less time.
    pub fn run_all(&self, configurations: &[Configuration], shifts: Shifts) -> Vec<ModelRun> {
        let mut all: Vec<CachedRun> = configurations.iter().map(|own| self.runs.known(own, shifts)).collect();
        let runs = configurations.iter().zip(&mut all);
        let mut missing: Vec<_> = runs.filter(|(_, run)| run.channels.iter().any(Option::is_none)).collect();
        for same in missing.chunk_by_mut(|(_, one), (_, other)| one.unit == other.unit) {
            let unit = |(configuration, run): &(&Configuration, &mut CachedRun)| {
                self.unit(self.gyros().filter(|gyro| run.channels[gyro].is_none()), configuration, shifts)
            };
            let counted = self.count(same.iter().map(unit).collect(), shifts.lag_s);
            for ((_, run), counted) in same.iter_mut().zip(counted) {
                run.channels.iter_mut().zip(counted).for_each(|(known, counted)| {
                    known.get_or_insert_with(|| Arc::new(counted));
                });
                self.runs.keep(run.clone());
            }
        }
        all.into_iter().map(|run| run.channels.map(Option::unwrap_or_default)).collect()
    }

    /// Runs units that differ in their gyros alone.
    fn count(&self, mut units: Vec<GyroUnit>, lag_s: f64) -> Vec<Series> {
        let known = self.runs.sub_steps(&units[0], lag_s, self.samples);
        let known = known.as_ref().map(|known| &known[..]);
        let heads = self.gyros().heads();
        let interval_ns = self.interval_s() * 1e9;
        let has = |channel: usize| channel < heads || channel == TIMING;
        let start =
            || std::array::from_fn(|channel| if has(channel) { vec![0.0; self.samples + 1] } else { Vec::new() });
        let mut all: Vec<Series> = units.iter().map(|_| start()).collect();
        for node in 1..=self.samples {
            let nominal_ns = (node as f64 * interval_ns).round() as i64;
            let late_ns = GyroUnit::count_samples(&mut units, known) - nominal_ns;
            for (series, unit) in all.iter_mut().zip(&units) {
                series.iter_mut().zip(unit.accumulated_counts()).for_each(|(channel, counts)| channel[node] = counts);
                series[TIMING][node] = late_ns as f64 * 1e-9 / TIMING_UNIT_S;
            }
        }
        all
    }

    /// The model's unit on this motion, which counts only these gyros.
    fn unit(&self, gyros: Gyros, configuration: &Configuration, shifts: Shifts) -> GyroUnit {
        let reference = self.runs.delayed(&self.reference, shifts.lag_s);
        let temperatures = self.runs.temperatures(&configuration.electronics, shifts.temperature_s, || {
            let mut electronics = configuration.electronics.clone();
            electronics.follow(self.table(&self.counts.electronics_c, shifts.temperature_s));
            let sensor = self.table(&self.counts.sensor_c, 0.0);
            MeasuredTemperatures::new(&electronics, &sensor, self.samples, self.interval_s())
        });
        let model = self.without_noise(configuration);
        GyroUnit::following(&model, &Truth::Recorded(reference), temperatures, gyros)
    }

    /// Angle that a term with each formula and a coefficient of 1 adds on each gyro, arcsec, averaged over blocks.
    pub fn terms(&self, configuration: &Configuration, formulas: &[Formula]) -> Vec<[Arc<[f64]>; TIMING]> {
        let mut unit = self.unit(self.gyros().with_mask(0), configuration, Shifts::default());
        let mut sums = vec![0.0; formulas.len()];
        let mut averages = vec![std::array::from_fn::<_, TIMING, _>(|_| Vec::new()); formulas.len()];
        for block in 0..self.block_count() {
            let mut at_nodes = vec![[0.0; BLOCK]; formulas.len()];
            for node in 0..BLOCK {
                unit.add_terms(formulas, &mut sums);
                at_nodes.iter_mut().zip(&sums).for_each(|(nodes, sum)| nodes[node] = *sum);
            }
            for (averages, at_nodes) in averages.iter_mut().zip(&at_nodes) {
                for (gyro, averages) in averages.iter_mut().enumerate().take(self.gyros().heads()) {
                    averages.push(self.average(gyro, block, |node| at_nodes[node - nodes(block).start]));
                }
            }
        }
        averages.into_iter().map(|averages| averages.map(Arc::from)).collect()
    }

    /// The configuration as the model of this recording: without noise and wiring faults, which exact checks have corrected.
    fn without_noise(&self, configuration: &Configuration) -> Configuration {
        let mut model = configuration.without_noise();
        model.gyros.iter_mut().for_each(|gyro| gyro.wiring = Default::default());
        if self.start_s != 0.0 {
            shift_origin(&mut model, self.start_s);
        }
        model
    }

    /// Temperatures at nodes, which were recorded with this delay.
    fn table(&self, celsius: &[f64], late_s: f64) -> Vec<(f64, f64)> {
        let node_s = |node: usize| node as f64 * self.interval_s() - late_s;
        (0..celsius.len()).map(node_s).zip(celsius.iter().copied()).collect()
    }
}
