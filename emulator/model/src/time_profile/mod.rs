//! Time profiles, one kind per file, and the list of them: how an effect's amplitude or a fault's offset varies with time.
//!
//! Effects and faults use the same kinds. An effect names a time course by a suffix of its code (`drift-step`), a fault by a
//! key in its `course` (`{ step = 1.0 }`). Each use has its own parameters and limits. Values are held over a sample
//! interval. Reading, display, schema and help all use this list.

use crate::effect::{Amplitude, EffectSpec};
use crate::parameter_spec::{DefaultValue, ParameterSpec, REAL, Role, ValueFormat, number};

/// Largest number of shape parameters of a profile.
const MAX_SHAPES: usize = 2;

/// Factor of the size over a sample interval, from the shape parameters, the interval and a function that draws a normally
/// distributed value for a sample, counted from the start of the profile.
type Value = fn(&[f64], &Interval, &dyn Fn(u64) -> f64) -> f64;

/// A kind of time profile as effects or as faults use it.
pub struct TimeProfileSpec {
    /// Suffix of an effect's code (`-step`), or key in the course of a fault (`step`).
    pub name: &'static str,
    pub meaning: &'static str,
    pub shapes: &'static [ParameterSpec],
    value: Value,
    /// For effects: key of the size, from the amplitude's key.
    key: fn(&str) -> String,
    /// For effects: limits of the size.
    limits: fn(&ParameterSpec, &Amplitude) -> (f64, f64),
    /// For effects: largest value of a course of this size.
    largest: fn(f64) -> f64,
    /// For effects: value that a course of this size has grown to after this time, s, and grows further from.
    grown: fn(f64, f64) -> f64,
    pub follows_temperature: bool,
}

impl TimeProfileSpec {
    /// A constant profile, bounded by its size.
    const CONSTANT: TimeProfileSpec = TimeProfileSpec {
        name: "",
        meaning: "",
        shapes: &[],
        value: |_, _, _| 1.0,
        key: str::to_owned,
        limits: |number, _| step_limits(number),
        largest: f64::abs,
        grown: |_, _| 0.0,
        follows_temperature: false,
    };

    /// Key, format and limits of the size for an amplitude; `None` if the amplitude cannot have this course: the
    /// name of a gyro has steps only, a flag steps and pulses.
    pub fn size(&self, effect: &EffectSpec, numbers: &[ParameterSpec], amplitude: usize) -> Option<Size> {
        let number = &numbers[amplitude];
        let (min, max) = self.size_limits(effect, numbers, amplitude)?;
        let key = (self.key)(number.name);
        // Beside a shape of the same key.
        let is_taken = self.shapes.iter().any(|shape| shape.name == key);
        let name = if is_taken { format!("amplitude_{key}") } else { key };
        Some(Size { name, form: number.form, min, max })
    }

    /// Limits of that size.
    pub fn size_limits(&self, effect: &EffectSpec, numbers: &[ParameterSpec], amplitude: usize) -> Option<(f64, f64)> {
        let number = &numbers[amplitude];
        let has_course = match self.name {
            "-step" => true,
            "-pulse" => matches!(number.form, ValueFormat::Real | ValueFormat::Flag),
            _ => number.form == ValueFormat::Real,
        };
        has_course.then(|| (self.limits)(number, &effect.amplitudes[amplitude]))
    }

    /// The profile with these values of [`TimeProfileSpec::shapes`].
    pub fn with(&'static self, shapes: &[f64]) -> TimeProfile {
        let mut profile = TimeProfile { spec: self, shapes: [f64::INFINITY; MAX_SHAPES] };
        for (own, &value) in profile.shapes.iter_mut().zip(shapes).filter(|(_, value)| !value.is_nan()) {
            *own = value;
        }
        profile
    }
}

/// Profiles are equal by name: each name is in the list once.
impl PartialEq for TimeProfileSpec {
    fn eq(&self, other: &TimeProfileSpec) -> bool {
        self.name == other.name
    }
}

impl std::fmt::Debug for TimeProfileSpec {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

/// Limits of a step: from any value of the parameter to any other.
pub fn step_limits(number: &ParameterSpec) -> (f64, f64) {
    (number.min.min(-number.max), number.max)
}

/// The time from which a course of an effect holds.
const fn onset(default: DefaultValue, help: &'static str) -> ParameterSpec {
    ParameterSpec { role: Role::Onset, ..number("time_s", "s", REAL, default, 0.0, 1e10, help) }
}

/// Share of the interval that lies after a moment.
fn share_after(time_s: f64, interval: &Interval) -> f64 {
    ((interval.end_s - time_s) / (interval.end_s - interval.start_s)).clamp(0.0, 1.0)
}

/// Key, format and limits of the size of a time course.
#[derive(Debug, Clone, PartialEq)]
pub struct Size {
    pub name: String,
    pub form: ValueFormat,
    pub min: f64,
    pub max: f64,
}

/// A sample interval as profiles use it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// Start, true time since the start of the run or of the fault.
    pub start_s: f64,
    pub end_s: f64,
    pub electronics_excess_k: f64,
    pub electronics_rate_k_per_h: f64,
}

impl Interval {
    fn middle_s(&self) -> f64 {
        0.5 * (self.start_s + self.end_s)
    }
}

/// A time profile with values of its shape parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeProfile {
    pub spec: &'static TimeProfileSpec,
    /// In the order of [`TimeProfileSpec::shapes`]; an absent one is infinite.
    shapes: [f64; MAX_SHAPES],
}

impl TimeProfile {
    /// Values of [`TimeProfileSpec::shapes`].
    pub fn shapes(&self) -> &[f64] {
        &self.shapes[..self.spec.shapes.len()]
    }

    /// Value of the first shape parameter with this role.
    pub fn shape_mut(&mut self, role: Role) -> Option<&mut f64> {
        let index = self.spec.shapes.iter().position(|shape| shape.role == role)?;
        Some(&mut self.shapes[index])
    }

    /// True if the profile repeats with a period and has a phase.
    pub fn is_periodic(&self) -> bool {
        self.spec.shapes.iter().any(|shape| shape.role == Role::Phase)
    }

    /// Factor of the size over a sample interval; `normal` draws a normally distributed value for a sample.
    #[inline]
    pub fn factor(&self, interval: &Interval, normal: &dyn Fn(u64) -> f64) -> f64 {
        (self.spec.value)(&self.shapes, interval, normal)
    }
}

/// A time course of one amplitude of one effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeCourse {
    /// Index of the effect in its list.
    pub effect: usize,
    /// Index of the amplitude among the effect's numbers.
    pub amplitude: usize,
    /// In the amplitude's unit, per day or per K as the profile defines.
    pub size: f64,
    pub profile: TimeProfile,
}

impl TimeCourse {
    /// Addition to the amplitude over the sample interval.
    #[inline]
    pub fn value(&self, interval: &Interval) -> f64 {
        self.size * self.profile.factor(interval, &|_| 0.0)
    }

    /// Largest addition over an unlimited time.
    pub fn largest(&self) -> f64 {
        (self.profile.spec.largest)(self.size)
    }

    /// Moves the origin of time by `by_s`. Returns the addition that the course has then grown to, which the amplitude
    /// must include to continue from.
    pub fn shift_origin(&mut self, by_s: f64) -> f64 {
        let period_s = self.profile.shape_mut(Role::Period).copied();
        if let Some(time_s) = self.profile.shape_mut(Role::Onset) {
            *time_s -= by_s;
        }
        if let (Some(phase_rad), Some(period_s)) = (self.profile.shape_mut(Role::Phase), period_s) {
            *phase_rad += std::f64::consts::TAU * by_s / period_s;
        }
        (self.profile.spec.grown)(self.size, by_s)
    }
}

macro_rules! time_profiles {
    ($($kind:ident: $($course:ident)? / $($fault:ident)?),* $(,)?) => {
        $(mod $kind;)*

        /// Time courses of effects.
        pub static COURSES: &[&TimeProfileSpec] = &[$($(&$kind::$course,)?)*];
        /// Profiles of faults.
        pub static FAULT_PROFILES: &[&TimeProfileSpec] = &[$($(&$kind::$fault,)?)*];
    };
}

// The list of time profiles, in the order of displays: as a course of effects, as a profile of faults.
time_profiles! {
    step: COURSE / FAULT,
    ramp: COURSE / FAULT,
    settling: COURSE / FAULT,
    temperature: COURSE /,
    temperature_rate: COURSE /,
    pulse: COURSE / FAULT,
    periodic: COURSE / FAULT,
    random: / FAULT,
}

/// The time course with this suffix, or the fault profile of this name.
pub fn from_name(name: &str) -> &'static TimeProfileSpec {
    let all = COURSES.iter().chain(FAULT_PROFILES);
    all.into_iter().find(|spec| spec.name == name).expect("a time profile of the list")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_shapes_fit() {
        let all: Vec<_> = COURSES.iter().chain(FAULT_PROFILES).collect();
        for (index, spec) in all.iter().enumerate() {
            assert!(all[..index].iter().all(|other| other.name != spec.name), "{spec:?}");
            assert!(spec.shapes.len() <= MAX_SHAPES, "{spec:?}");
        }
        assert!(COURSES.iter().all(|spec| spec.name.starts_with('-')));
    }

    /// Factors of a fault profile in five sample intervals.
    fn factors(name: &str, shapes: &[f64]) -> [f64; 5] {
        let profile = from_name(name).with(shapes);
        [0.25, 4.75, 5.25, 10.25, 12.25].map(|middle_s: f64| {
            let (start_s, end_s) = (middle_s - 0.25, middle_s + 0.25);
            profile.factor(
                &Interval { start_s, end_s, electronics_excess_k: 0.0, electronics_rate_k_per_h: 0.0 },
                &|sample| 100.0 + sample as f64,
            )
        })
    }

    #[test]
    fn fault_profiles_have_the_factors_that_their_names_state() {
        assert_eq!(factors("step", &[]), [1.0; 5]);
        assert_eq!(factors("ramp", &[10.0]), [0.025, 0.475, 0.525, 1.0, 1.0]);
        assert_eq!(factors("pulse", &[5.0, 10.0]), [1.0, 1.0, 0.0, 1.0, 1.0]);
        assert_eq!(factors("pulse", &[5.0, f64::NAN]), [1.0, 1.0, 0.0, 0.0, 0.0]);
        assert_eq!(factors("sine", &[1.0, 0.0])[0], 1.0);
        assert_eq!(factors("random", &[5.0]), [100.0, 100.0, 110.0, 120.0, 120.0]);
    }

    /// Values of a course of size 8 in the sample intervals from these times.
    fn values<const COUNT: usize>(name: &str, shapes: &[f64], starts_s: [f64; COUNT]) -> [f64; COUNT] {
        let course = TimeCourse { effect: 0, amplitude: 0, size: 8.0, profile: from_name(name).with(shapes) };
        starts_s.map(|start_s| {
            let (end_s, electronics_rate_k_per_h) = (start_s + 0.5, 0.25);
            course.value(&Interval { start_s, end_s, electronics_excess_k: 0.0, electronics_rate_k_per_h })
        })
    }

    #[test]
    fn steps_and_pulses_inside_a_sample_interval_count_with_their_share() {
        assert_eq!(values("-step", &[10.125], [9.5, 10.0, 10.5]), [0.0, 6.0, 8.0]);
        assert_eq!(values("-pulse", &[10.125, 1.0], [9.5, 10.0, 10.5, 11.0, 11.5]), [0.0, 6.0, 8.0, 2.0, 0.0]);
    }

    #[test]
    fn a_settling_course_decays_from_its_onset_and_counts_with_its_mean() {
        let [before, first, later] = values("-settling", &[10.25, 100.0], [9.5, 10.0, 110.25]);
        // Half of the interval, on average at exp(-0.00125); then a time constant and a quarter of a second later.
        assert_eq!(before, 0.0);
        assert!((first - 4.0 * (-0.00125f64).exp()).abs() < 1e-5, "{first}");
        assert!((later - 8.0 * (-1.0025f64).exp()).abs() < 1e-5, "{later}");
    }

    #[test]
    fn a_course_by_the_temperature_rate_is_proportional_to_it() {
        assert_eq!(values("-temperature-rate", &[], [0.0, 100.0]), [2.0, 2.0]);
    }
}
