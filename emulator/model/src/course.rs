//! Courses in time of an effect's amplitude: one mechanism for all effects.
//!
//! In the configuration a course is a suffix of the effect's code: `drift-step`, `scale-factor-temperature`. Values are
//! held over a sample interval; a step within it counts with the part of it that it holds.

use crate::effect::{Amplitude, EffectSpec};
use crate::number::{DefaultValue, ParameterSpec, Role, ValueFormat};
use crate::units::S_PER_DAY;

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TimeFunction {
    Step {
        /// Since the start of the first sample interval.
        time_s: f64,
    },
    /// Grows from 0 at the start; the size is per day.
    Ramp,
    /// Follows the electronics temperature above its reference; the size is per K.
    Temperature,
    Periodic {
        period_s: f64,
        phase_rad: f64,
    },
}

/// A course of one amplitude of one effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeCourse {
    /// Index of the effect in its list.
    pub effect: usize,
    /// Index of the amplitude among the effect's numbers.
    pub amplitude: usize,
    /// Size, in the amplitude's unit, per day or per K as the law says.
    pub size: f64,
    pub law: TimeFunction,
}

/// A kind of course: its suffix, and how its keys are made of the amplitude's.
pub struct TimeFunctionSpec {
    /// What it adds to the effect's code.
    pub suffix: &'static str,
    pub meaning: &'static str,
    key: fn(&str) -> String,
    limit: fn(&ParameterSpec, &Amplitude) -> (f64, f64),
    pub shapes: &'static [ParameterSpec],
    law: fn(&[f64]) -> TimeFunction,
}

const TIME: ParameterSpec = ParameterSpec {
    name: "time_s",
    form: ValueFormat::Real,
    role: Role::Onset,
    default: DefaultValue::Required,
    least: 0.0,
    greatest: 1e10,
    meaning: "from which it holds, since the start of the first sample interval",
};
const PERIOD: ParameterSpec = ParameterSpec {
    name: "period_s",
    form: ValueFormat::Real,
    role: Role::Period,
    default: DefaultValue::Required,
    least: 0.1,
    greatest: 1e10,
    meaning: "period",
};
const PHASE: ParameterSpec = ParameterSpec {
    name: "phase_rad",
    form: ValueFormat::Real,
    role: Role::Phase,
    default: DefaultValue::Value(0.0),
    least: -100.0,
    greatest: 100.0,
    meaning: "phase at the start of the first sample interval",
};

/// What is said of the size of a course.
#[derive(Debug, Clone, PartialEq)]
pub struct Size {
    /// Key, made from the amplitude's.
    pub name: String,
    pub form: ValueFormat,
    pub least: f64,
    pub greatest: f64,
}

pub const KINDS: &[TimeFunctionSpec] = &[
    TimeFunctionSpec {
        suffix: "-step",
        meaning: "holds from time_s on",
        key: str::to_owned,
        limit: |number, _| step_limits(number),
        shapes: &[TIME],
        law: |shapes| TimeFunction::Step { time_s: shapes[0] },
    },
    TimeFunctionSpec {
        suffix: "-ramp",
        meaning: "per day, from the start",
        key: |name| format!("{name}_per_day"),
        limit: |_, amplitude| (-amplitude.per_day, amplitude.per_day),
        shapes: &[],
        law: |_| TimeFunction::Ramp,
    },
    TimeFunctionSpec {
        suffix: "-temperature",
        meaning: "per K of electronics temperature above its reference",
        key: |name| format!("{name}_per_k"),
        limit: |_, amplitude| (-amplitude.per_k, amplitude.per_k),
        shapes: &[],
        law: |_| TimeFunction::Temperature,
    },
    TimeFunctionSpec {
        suffix: "-periodic",
        meaning: "amplitude times sin(2 pi t / period + phase)",
        key: |name| format!("amplitude_{name}"),
        limit: |number, _| step_limits(number),
        shapes: &[PERIOD, PHASE],
        law: |shapes| TimeFunction::Periodic { period_s: shapes[0], phase_rad: shapes[1] },
    },
];

/// Limits of a step: from any value to any other that the model is good for.
pub fn step_limits(number: &ParameterSpec) -> (f64, f64) {
    (number.least.min(-number.greatest), number.greatest)
}

impl TimeFunctionSpec {
    /// What is said of the size of an amplitude's course; nothing where there can be none: what is on or off, or names
    /// a gyro, can only be stepped.
    pub fn size(&self, effect: &EffectSpec, numbers: &[ParameterSpec], amplitude: usize) -> Option<Size> {
        let number = &numbers[amplitude];
        if number.form != ValueFormat::Real && self.suffix != "-step" {
            return None;
        }
        let (least, greatest) = (self.limit)(number, &effect.amplitudes[amplitude]);
        Some(Size { name: (self.key)(number.name), form: number.form, least, greatest })
    }

    /// The law with these values of [`TimeFunctionSpec::shapes`].
    pub fn law(&self, shapes: &[f64]) -> TimeFunction {
        (self.law)(shapes)
    }

    /// The kind of a law, and its values of [`TimeFunctionSpec::shapes`].
    pub fn of(law: &TimeFunction) -> (&'static TimeFunctionSpec, Vec<f64>) {
        let (index, shapes) = match *law {
            TimeFunction::Step { time_s } => (0, vec![time_s]),
            TimeFunction::Ramp => (1, vec![]),
            TimeFunction::Temperature => (2, vec![]),
            TimeFunction::Periodic { period_s, phase_rad } => (3, vec![period_s, phase_rad]),
        };
        (&KINDS[index], shapes)
    }
}

/// A sample as a course sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// Start, true time since the start of the first sample interval.
    pub start_s: f64,
    pub end_s: f64,
    pub electronics_excess_k: f64,
}

impl TimeCourse {
    /// What it adds to the amplitude over the sample interval.
    #[inline]
    pub fn value(&self, interval: &Interval) -> f64 {
        let Interval { start_s, end_s, electronics_excess_k } = *interval;
        let middle_s = 0.5 * (start_s + end_s);
        self.size
            * match self.law {
                TimeFunction::Step { time_s } => ((end_s - time_s) / (end_s - start_s)).clamp(0.0, 1.0),
                TimeFunction::Ramp => middle_s / S_PER_DAY,
                TimeFunction::Temperature => electronics_excess_k,
                TimeFunction::Periodic { period_s, phase_rad } => {
                    libm::sin(std::f64::consts::TAU * middle_s / period_s + phase_rad)
                }
            }
    }

    /// The largest that it ever adds.
    pub fn largest(&self) -> f64 {
        match self.law {
            TimeFunction::Step { .. } => self.size.max(0.0),
            TimeFunction::Ramp if self.size <= 0.0 => 0.0,
            TimeFunction::Ramp | TimeFunction::Temperature => f64::INFINITY,
            TimeFunction::Periodic { .. } => self.size.abs(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_within_a_sample_counts_with_its_part() {
        let course = TimeCourse { effect: 0, amplitude: 0, size: 8.0, law: TimeFunction::Step { time_s: 10.125 } };
        let value = |start_s: f64| course.value(&Interval { start_s, end_s: start_s + 0.5, electronics_excess_k: 0.0 });
        assert_eq!([value(9.5), value(10.0), value(10.5)], [0.0, 6.0, 8.0]);
    }

    #[test]
    fn kinds_and_laws_name_each_other() {
        for kind in KINDS {
            let shapes: Vec<f64> = (1..=kind.shapes.len()).map(|number| number as f64).collect();
            let (back, values) = TimeFunctionSpec::of(&kind.law(&shapes));
            assert_eq!((back.suffix, values), (kind.suffix, shapes));
        }
    }
}
