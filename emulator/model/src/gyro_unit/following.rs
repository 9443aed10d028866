//! A unit that follows a recording: its temperatures were measured, and its counts alone matter.
//!
//! The motion is the same for all models of a recording: [`GyroUnit::follow`] resolves it once, and any number of gyros count along it.

use std::sync::Arc;

use super::{GyroUnit, Truth, unit_effects};
use crate::attitude::{MotionState, MotionStep};
use crate::configuration::{Configuration, GyroConfiguration};
use crate::device::Head;
use crate::effect::discovered::{self, Formula, Regressor};
use crate::effect::{
    EffectConfiguration, EffectInputs, Effects, GyroEffects, GyroSubStep, HeadStates, SampleTiming, Temperatures,
    UnitEffects, UnitStates,
};
use crate::package::{ResolvedGyro, SubStep, calibrated};
use crate::temperature::{ElectronicsCourse, SENSOR_NOMINAL_C, interpolate};
use crate::time_profile::TimeCourse;

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
    pub(crate) fn at(&self, t_s: f64) -> Temperatures {
        let sample = (t_s / self.interval_s) as usize;
        self.samples[sample.min(self.samples.len() - 1)]
    }
}

/// Sample intervals of a unit, in order: what its gyros have in common.
#[derive(Debug, Clone)]
pub struct FollowedSamples {
    intervals: Vec<FollowedInterval>,
    /// Motion at the start, and at the end of each sub-step; there are equally many in each sample.
    states: Vec<MotionState>,
    turns: Vec<Turn>,
}

/// One sample interval.
#[derive(Debug, Clone, Copy)]
struct FollowedInterval {
    /// True time since the start of the first one.
    start_s: f64,
    end_s: f64,
    end_ns: i64,
}

/// The turn over a sub-step.
#[derive(Debug, Clone, Copy)]
struct Turn {
    angle_control_arcsec: [f64; 3],
    length_s: f64,
    end_s: f64,
}

/// Consecutive ones of [`FollowedSamples`].
#[derive(Debug, Clone, Copy)]
pub struct SomeSamples<'a> {
    intervals: &'a [FollowedInterval],
    steps: SubSteps<'a>,
}

/// Consecutive sub-steps.
#[derive(Debug, Clone, Copy)]
pub struct SubSteps<'a> {
    states: &'a [MotionState],
    turns: &'a [Turn],
}

impl FollowedSamples {
    /// At most `most` samples at a time.
    pub fn chunks(&self, most: usize) -> impl Iterator<Item = SomeSamples<'_>> {
        let all =
            SomeSamples { intervals: &self.intervals, steps: SubSteps { states: &self.states, turns: &self.turns } };
        let steps = all.steps.chunks(most * all.steps_of_sample());
        self.intervals.chunks(most).zip(steps).map(|(intervals, steps)| SomeSamples { intervals, steps })
    }
}

impl<'a> SubSteps<'a> {
    fn chunks(self, most: usize) -> impl Iterator<Item = SubSteps<'a>> {
        let SubSteps { states, turns } = self;
        turns
            .chunks(most)
            .zip((0..).step_by(most))
            .map(move |(turns, from)| SubSteps { states: &states[from..=from + turns.len()], turns })
    }

    /// Length of all of them, s.
    #[inline]
    pub fn length_s(&self) -> f64 {
        self.turns.iter().map(|turn| turn.length_s).sum()
    }

    #[inline]
    pub fn iter(&self) -> impl Iterator<Item = SubStep> + 'a {
        self.turns.iter().zip(self.states.windows(2)).map(|(turn, states)| {
            let Turn { angle_control_arcsec, length_s, end_s } = *turn;
            SubStep { counted: MotionStep { start: states[0], end: states[1], length_s, angle_control_arcsec }, end_s }
        })
    }
}

impl<'a> SomeSamples<'a> {
    /// Scheduled end of each, true time since the start of the first sample interval, ns.
    pub fn ends_ns(&self) -> impl ExactSizeIterator<Item = i64> + 'a {
        self.intervals.iter().map(|interval| interval.end_ns)
    }

    fn steps_of_sample(&self) -> usize {
        (self.steps.turns.len() / self.intervals.len().max(1)).max(1)
    }

    /// Temperatures, interval and sub-steps of each sample.
    fn iter(
        &self,
        measured: &'a MeasuredTemperatures,
    ) -> impl Iterator<Item = (Temperatures, &'a FollowedInterval, SubSteps<'a>)> {
        let samples = self.intervals.iter().zip(self.steps.chunks(self.steps_of_sample()));
        samples.map(|(own, steps)| (measured.at(0.5 * (own.start_s + own.end_s)), own, steps))
    }

    /// Adds to the sum of each formula what a term with a coefficient of 1 makes a gyro sense, arcsec, and passes the place of the formula and
    /// its sum at the end of each sample to `push`.
    pub fn add_terms(
        &self,
        head: &Head,
        measured: &MeasuredTemperatures,
        formulas: &[Formula],
        sums: &mut [f64],
        mut push: impl FnMut(usize, f64),
    ) {
        let steps = self.steps.turns.len();
        let mut values = Regressor::ALL.map(|_| Vec::with_capacity(steps));
        for (temperatures, _, steps) in self.iter(measured) {
            for step in steps.iter() {
                // A formula has the control axes.
                let inputs = EffectInputs::new(&step, head, &temperatures);
                values.iter_mut().zip(Regressor::ALL).for_each(|(own, regressor)| own.push(regressor.value(&inputs)));
            }
        }
        let each = self.steps_of_sample();
        let mut products = vec![0.0; steps];
        for (place, (formula, sum)) in formulas.iter().zip(sums).enumerate() {
            formula.values(|regressor| &values[regressor.index()], &mut products);
            for (products, turns) in products.chunks(each).zip(self.steps.turns.chunks(each)) {
                products.iter().zip(turns).for_each(|(product, turn)| *sum += product * turn.length_s);
                push(place, *sum);
            }
        }
    }
}

/// A gyro that counts along [`FollowedSamples`]. Effects that are absent are not computed, nor are wiring faults, power and saturation.
#[derive(Debug, Clone)]
pub struct FollowingGyro<'a> {
    model: &'a Configuration,
    measured: &'a MeasuredTemperatures,
    head: &'a Head,
    configuration: &'a GyroConfiguration,
    /// Effects that are present, as bits in the order of [`GyroEffects::SPECS`].
    active: u32,
    states: HeadStates,
    /// Memory of the effects of the unit, if there are any.
    unit: Option<UnitStates>,
    /// Accumulated counts as a real number.
    accumulated: f64,
    heads: Vec<GyroSubStep>,
}

impl<'a> FollowingGyro<'a> {
    /// The gyro of this number at the start of a run at these temperatures.
    pub fn new(model: &'a Configuration, gyro: usize, measured: &'a MeasuredTemperatures) -> FollowingGyro<'a> {
        let (head, configuration) = (&model.device.heads[gyro], &model.gyros[gyro]);
        FollowingGyro {
            model,
            measured,
            head,
            configuration,
            active: configuration.effects.active(),
            states: HeadStates::start(model.seed, head.gyro),
            unit: (model.unit.active() != 0).then(UnitStates::default),
            accumulated: 0.0,
            heads: Vec::new(),
        }
    }

    /// Counts the next samples, effect by effect; the accumulated counts before rounding at the end of each go to `counts`.
    pub fn count(&mut self, samples: SomeSamples, counts: &mut [f64]) {
        let FollowingGyro { model, measured, head, configuration, .. } = *self;
        let GyroConfiguration { calibration, effects, discovered, .. } = configuration;
        let mut heads = std::mem::take(&mut self.heads);
        heads.clear();
        let turns = samples.steps.turns.iter();
        heads.extend(turns.map(|turn| calibrated(head, calibration, turn.angle_control_arcsec, turn.length_s)));
        let each = samples.steps_of_sample();
        let of_unit = |own: &FollowedInterval| unit_effects(model, own.start_s, |t_s| measured.at(t_s));
        if let Some(states) = &mut self.unit {
            let gyro = ResolvedGyro { head, calibration, effects: &effects.constant, discovered: &[] };
            for ((_, interval, steps), heads) in samples.iter(measured).zip(heads.chunks_mut(each)) {
                let unit = of_unit(interval);
                for (step, head) in steps.iter().zip(heads.chunks_mut(1)) {
                    unit.apply(states, head, &[gyro], &step.counted, &mut [()]);
                }
            }
        }
        if !discovered.is_empty() {
            for ((temperatures, _, steps), heads) in samples.iter(measured).zip(heads.chunks_mut(each)) {
                for (step, own) in steps.iter().zip(heads) {
                    discovered::apply(discovered, own, &EffectInputs::new(&step, head, &temperatures));
                }
            }
        }
        let all = || {
            let interval = |own: &FollowedInterval, at: &Temperatures| at.interval(own.start_s, own.end_s);
            samples.iter(measured).map(move |(at, own, steps)| (at, interval(own, &at), steps))
        };
        GyroEffects::apply_over(effects, self.active, &mut self.states, head, all, &mut heads);
        for ((counts, interval), heads) in counts.iter_mut().zip(samples.intervals).zip(heads.chunks(each)) {
            let timing = self.unit.as_ref().map_or_else(SampleTiming::default, |_| of_unit(interval).shared_timing());
            self.accumulated += heads.iter().fold(0.0, |sum, head| sum + head.counts(&timing));
            *counts = self.accumulated;
        }
        self.heads = heads;
    }
}

impl GyroUnit {
    /// A unit at these temperatures, at the start of its first sample interval.
    pub fn following(configuration: &Configuration, truth: &Truth, measured: Arc<MeasuredTemperatures>) -> GyroUnit {
        GyroUnit::at_start(configuration, truth, Some(measured))
    }

    /// True if no effect or fault moves its sample intervals or its motion.
    pub fn keeps_time(&self) -> bool {
        let EffectConfiguration { constant, courses, .. } = &self.configuration.unit;
        // Whatever its sign: a course may take away from an amplitude.
        let alone = |course: &TimeCourse| {
            let mut effects = UnitEffects::default();
            *effects.numbers_mut(course.effect).value_mut(course.amplitude) = 1.0;
            effects
        };
        let mut all = std::iter::once(*constant).chain(courses.iter().map(alone));
        self.faults().is_empty() && all.all(|effects| effects.shared_timing() == SampleTiming::default())
    }

    /// Follows the next samples without counting them: for a unit without faults on a motion that is known.
    pub fn follow(&mut self, samples: usize) -> FollowedSamples {
        let mut steps = std::mem::take(&mut self.steps);
        let mut states = Vec::with_capacity(1 + samples * steps.len());
        let mut turns = Vec::with_capacity(samples * steps.len());
        states.push(*self.motion.now());
        let follow = |_| {
            let (start_s, end_s) = (self.start_fs as f64 * 1e-15, self.end_fs as f64 * 1e-15);
            self.advance::<()>(start_s, end_s, &mut steps);
            states.extend(steps.iter().map(|step| step.counted.end));
            turns.extend(steps.iter().map(|SubStep { counted, end_s }| Turn {
                angle_control_arcsec: counted.angle_control_arcsec,
                length_s: counted.length_s,
                end_s: *end_s,
            }));
            let followed = FollowedInterval { start_s, end_s, end_ns: self.running_end_ns() };
            self.begin_next();
            followed
        };
        let intervals = (0..samples).map(follow).collect();
        self.steps = steps;
        FollowedSamples { intervals, states, turns }
    }

    /// Accumulated counts of each head as real numbers: before rounding, wiring faults, self-test, power and
    /// saturation.
    pub fn accumulated_counts(&self) -> impl Iterator<Item = f64> + '_ {
        self.channels.iter().map(|channel| channel.accumulated)
    }

    /// Continues with other numbers from the next sample on: for a model of which parameters are found while it runs.
    pub fn reconfigure(&mut self, change: impl FnOnce(&mut Configuration)) {
        change(Arc::make_mut(&mut self.configuration));
    }
}
