//! A unit that follows a recording: its temperatures were measured, and its counts alone matter.

use std::sync::Arc;

use geu_protocol::Gyros;

use super::{GyroUnit, Truth};
use crate::configuration::Configuration;
use crate::device::{Head, MAX_HEADS};
use crate::effect::discovered::{Formula, Regressor};
use crate::effect::{EffectInputs, Temperatures};
use crate::package::{ComputedParts, SubStep};
use crate::temperature::{ElectronicsCourse, SENSOR_NOMINAL_C, interpolate};

/// Temperatures that were measured, in the middle of each sample interval.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredTemperatures {
    interval_s: f64,
    samples: Vec<Temperatures>,
}

impl MeasuredTemperatures {
    /// Temperatures of electronics with a course, and of a sensor with points (time since the start in s, °C) in order of time.
    pub fn new(
        electronics: &ElectronicsCourse,
        sensor: &[(f64, f64)],
        samples: usize,
        interval_s: f64,
    ) -> MeasuredTemperatures {
        let of_sample = |sample: usize| {
            let t_s = (sample as f64 + 0.5) * interval_s;
            let sensor_c = if sensor.is_empty() { SENSOR_NOMINAL_C } else { interpolate(sensor, t_s) };
            Temperatures::from_course(electronics, t_s, sensor_c)
        };
        MeasuredTemperatures { interval_s, samples: (0..samples.max(1)).map(of_sample).collect() }
    }

    /// In the sample interval that contains this time, held before the first and after the last.
    #[inline]
    pub(super) fn at(&self, t_s: f64) -> Temperatures {
        let sample = (t_s / self.interval_s) as usize;
        self.samples[sample.min(self.samples.len() - 1)]
    }
}

impl GyroUnit {
    /// A unit at these temperatures, at the start of its first sample interval, which counts these gyros alone; the others read nothing.
    /// Effects that are absent are not computed.
    pub fn following(
        configuration: &Configuration,
        truth: &Truth,
        measured: Arc<MeasuredTemperatures>,
        gyros: Gyros,
    ) -> GyroUnit {
        let unit = GyroUnit::at_start(configuration, truth, Some(measured));
        let has_plan = !unit.faults.is_empty();
        let of_gyro = |index: usize| {
            let effects = if has_plan { u32::MAX } else { configuration.gyros[index].effects.active() };
            ComputedParts { is_counted: gyros[index], effects }
        };
        GyroUnit { computed: (0..gyros.heads()).map(of_gyro).collect(), ..unit }
    }

    /// True if no effect or fault moves its sample intervals or its motion.
    pub fn keeps_time(&self) -> bool {
        self.configuration.unit.active() == 0 && self.faults().is_empty()
    }

    /// The sub-steps of the next samples.
    pub fn sub_steps(&self, samples: usize) -> Vec<SubStep> {
        let (mut unit, each) = (self.clone(), self.steps.len());
        let mut all = vec![SubStep::default(); samples * each];
        for steps in all.chunks_mut(each) {
            unit.advance::<()>(unit.start_fs as f64 * 1e-15, unit.end_fs as f64 * 1e-15, steps);
            unit.start_fs = unit.end_fs;
            unit.begin();
        }
        all
    }

    /// Ends the running sample interval of units that differ in their gyros alone and begins the next, without flags, wiring faults and
    /// self-test; returns its scheduled end, ns, or 0 without units. The first unit follows the motion for all of them, unless `known` has
    /// [`GyroUnit::sub_steps`] from its start on.
    pub fn count_samples(units: &mut [GyroUnit], known: Option<&[SubStep]>) -> i64 {
        let Some(first) = units.first_mut() else { return 0 };
        let end_ns = first.running_end_ns();
        if !first.faults().is_empty() {
            for unit in units {
                unit.end_sample();
            }
            return end_ns;
        }
        let (start_s, end_s) = (first.start_fs as f64 * 1e-15, first.end_fs as f64 * 1e-15);
        let temperatures = first.temperatures(0.5 * (start_s + end_s));
        let interval = temperatures.interval(start_s, end_s);
        let mut storage = std::mem::take(&mut first.steps);
        let place = first.ended as usize * storage.len();
        let (steps, truths) = match known {
            Some(known) => (&known[place..place + storage.len()], Vec::new()),
            None => {
                let truths = first.advance::<()>(start_s, end_s, &mut storage);
                (&storage[..], truths)
            }
        };
        debug_assert!(units.iter().all(|unit| unit.running_end_ns() == end_ns));
        for unit in units.iter_mut() {
            let counts = unit.count(&temperatures, &interval, steps, &truths, &mut [(); MAX_HEADS]);
            unit.channels.iter_mut().zip(counts).for_each(|(channel, counts)| channel.accumulated += counts);
            unit.begin_next();
        }
        units[0].steps = storage;
        end_ns
    }

    /// Adds to each sum what a term with that formula and a coefficient of 1 makes a gyro sense over the running sample interval, arcsec;
    /// then begins the next.
    pub fn add_terms(&mut self, formulas: &[Formula], sums: &mut [f64]) {
        let (start_s, end_s) = (self.start_fs as f64 * 1e-15, self.end_fs as f64 * 1e-15);
        let temperatures = self.temperatures(0.5 * (start_s + end_s));
        let mut steps = std::mem::take(&mut self.steps);
        self.advance::<()>(start_s, end_s, &mut steps);
        for SubStep { counted: step, end_s } in &steps {
            // A formula has the control axes.
            let Head { axes, full_scale_arcsec_s, .. } = &self.configuration.device.heads[0];
            let full_scale_arcsec_s = *full_scale_arcsec_s;
            let inputs = EffectInputs { step, axes, temperatures: &temperatures, end_s: *end_s, full_scale_arcsec_s };
            let values = Regressor::ALL.map(|regressor| regressor.value(&inputs));
            for (sum, formula) in sums.iter_mut().zip(formulas) {
                *sum += formula.value(|regressor| values[regressor.index()]) * step.length_s;
            }
        }
        self.steps = steps;
        self.begin_next();
    }

    /// Accumulated counts of each head as real numbers: before rounding, wiring faults, self-test, power and
    /// saturation.
    pub fn accumulated_counts(&self) -> impl Iterator<Item = f64> + '_ {
        self.channels.iter().map(|channel| channel.accumulated)
    }

    /// Continues with other numbers from the next sample on: for a model of which parameters are found while it runs.
    pub fn reconfigure(&mut self, change: impl FnOnce(&mut Configuration)) {
        change(Arc::make_mut(&mut self.configuration));
        self.computed.iter_mut().for_each(|own| own.effects = u32::MAX);
    }
}
