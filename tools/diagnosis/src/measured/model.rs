//! Runs of the model on a recorded motion.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use geu_model::effect::discovered::Formula;
use geu_model::{Configuration, FollowingGyro, GyroUnit, MeasuredTemperatures, Truth};

use crate::time_origin::shift_origin;

use super::model_cache::CachedRun;
use super::series::{CHANNELS, ModelRun, Series, Shifts, TIMING, TIMING_UNIT_S};
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
            let models: Vec<Configuration> = same.iter().map(|(own, _)| self.without_noise(own)).collect();
            let is_missing = |(_, run): &(&Configuration, &mut CachedRun)| run.channels.each_ref().map(Option::is_none);
            let counted = self.count(&models, &same.iter().map(is_missing).collect::<Vec<_>>(), shifts);
            for ((_, run), counted) in same.iter_mut().zip(counted) {
                run.channels.iter_mut().zip(counted).for_each(|(known, counted)| {
                    known.get_or_insert_with(|| Arc::new(counted));
                });
                self.runs.keep(run.clone());
            }
        }
        all.into_iter().map(|run| run.channels.map(Option::unwrap_or_default)).collect()
    }

    /// Runs models that differ in their gyros alone, on those channels that are missing of each.
    fn count(&self, models: &[Configuration], missing: &[[bool; CHANNELS]], shifts: Shifts) -> Vec<Series> {
        let measured = self.temperatures(&models[0], shifts);
        let unit = |model: &Configuration| {
            let reference = self.runs.delayed(&self.reference, shifts.lag_s);
            GyroUnit::following(model, &Truth::Recorded(reference), measured.clone())
        };
        let interval_ns = self.interval_s() * 1e9;
        let late = |node: usize, end_ns: i64| {
            let nominal_ns = (node as f64 * interval_ns).round() as i64;
            (end_ns - nominal_ns) as f64 * 1e-9 / TIMING_UNIT_S
        };
        let start = |missing: &[bool; CHANNELS]| missing.map(|own| vec![0.0; if own { self.samples + 1 } else { 0 }]);
        let mut all: Vec<Series> = missing.iter().map(start).collect();
        let first = unit(&models[0]);
        if !first.faults().is_empty() {
            for (series, mut unit) in all.iter_mut().zip(models.iter().map(unit)) {
                for node in 1..=self.samples {
                    let late = late(node, unit.end_sample().end_ns);
                    let counts = unit.accumulated_counts().enumerate();
                    for (channel, value) in counts.chain([(TIMING, late)]) {
                        series[channel].get_mut(node).into_iter().for_each(|own| *own = value);
                    }
                }
            }
            return all;
        }
        let heads = self.gyros().heads();
        let of_model = |model| -> Vec<FollowingGyro> {
            (0..heads).map(|gyro| FollowingGyro::new(model, gyro, &measured)).collect()
        };
        let mut gyros: Vec<Vec<FollowingGyro>> = models.iter().map(of_model).collect();
        let mut node = 1;
        self.runs.follow(first, shifts.lag_s, self.samples, |samples| {
            let nodes = node..node + samples.ends_ns().len();
            for (series, gyros) in all.iter_mut().zip(&mut gyros) {
                for (series, gyro) in series.iter_mut().zip(gyros) {
                    series.get_mut(nodes.clone()).into_iter().for_each(|counts| gyro.count(samples, counts));
                }
                let ends = nodes.clone().zip(samples.ends_ns());
                let times = series[TIMING].get_mut(nodes.clone()).unwrap_or_default().iter_mut();
                times.zip(ends).for_each(|(own, (node, end_ns))| *own = late(node, end_ns));
            }
            node = nodes.end;
        });
        all
    }

    /// The measured temperatures with a delay.
    fn temperatures(&self, configuration: &Configuration, shifts: Shifts) -> Arc<MeasuredTemperatures> {
        self.runs.temperatures(&configuration.electronics, shifts.temperature_s, || {
            let mut electronics = configuration.electronics.clone();
            electronics.follow(self.table(&self.counts.electronics_c, shifts.temperature_s));
            let sensor = self.table(&self.counts.sensor_c, 0.0);
            MeasuredTemperatures::new(&electronics, &sensor, self.samples, self.interval_s())
        })
    }

    /// Angle that a term with each formula and a coefficient of 1 adds on each gyro, arcsec, averaged over blocks.
    pub fn terms(&self, configuration: &Configuration, formulas: &[Formula]) -> Vec<[Arc<[f64]>; TIMING]> {
        let model = self.without_noise(configuration);
        let measured = self.temperatures(&model, Shifts::default());
        let unit = GyroUnit::following(&model, &Truth::Recorded(self.reference.clone()), measured.clone());
        let mut sums = vec![0.0; formulas.len()];
        // The same for all gyros without weights: that of the first one.
        let gyro_of = |gyro: usize| match &self.weights[gyro] {
            Some(_) => Some(gyro),
            None => self.weights.iter().position(Option::is_none),
        };
        let heads = self.gyros().heads();
        let averaged: BTreeSet<usize> = (0..heads).filter_map(gyro_of).collect();
        let start = || averaged.iter().map(|gyro| (*gyro, Vec::with_capacity(self.block_count()))).collect();
        let mut averages: Vec<BTreeMap<usize, Vec<f64>>> = formulas.iter().map(|_| start()).collect();
        let mut of_block = vec![Vec::with_capacity(BLOCK); formulas.len()];
        let mut push = |formula: usize, sum: f64| {
            let at_nodes = &mut of_block[formula];
            at_nodes.push(sum);
            if at_nodes.len() == BLOCK {
                for (gyro, averages) in &mut averages[formula] {
                    let first = nodes(averages.len()).start;
                    averages.push(self.average(*gyro, averages.len(), |node| at_nodes[node - first]));
                }
                at_nodes.clear();
            }
        };
        self.runs.follow(unit, 0.0, self.samples, |samples| {
            samples.add_terms(&model.device.heads[0], &measured, formulas, &mut sums, &mut push);
        });
        let of_gyros = |averages: BTreeMap<usize, Vec<f64>>| {
            let averages: BTreeMap<usize, Arc<[f64]>> =
                averages.into_iter().map(|(gyro, own)| (gyro, own.into())).collect();
            let of_gyro = |gyro: usize| averages.get(&gyro_of(gyro)?).filter(|_| gyro < heads).cloned();
            std::array::from_fn(|gyro| of_gyro(gyro).unwrap_or_default())
        };
        averages.into_iter().map(of_gyros).collect()
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
