//! The effects, one file each, and the lists that name them in physical order. Nothing else names an effect.
//!
//! What a law acts on says where and on whom it acts. Effects of the unit are one list ([`UnitEffects`]), effects of a
//! gyro another ([`GyroEffects`]), faults of a gyro's wiring a third ([`WiringEffects`]); laws are called statically from
//! the list, in the hot loop. One effect stands beside the lists, as its terms are data: [`discovered`]. All numbers go
//! through [`Effects`]: configuration and its schema, courses, and whatever searches or moves an amplitude. State stands
//! apart from the numbers, so a number moved live never resets it, and an amplitude of 0 changes no bit.
//!
//! | acts on | when | method |
//! |---|---|---|
//! | [`SampleTiming`] | once per sample interval | [`UnitEffect::timing`] |
//! | the four [`GyroSubStep`]s together | in every sub-step | [`UnitEffect::apply`] |
//! | one [`GyroSubStep`] | once per sample interval, then in every sub-step | [`GyroEffect::begin`], [`GyroEffect::apply`] |
//! | the four counts | after rounding, before clipping | [`WiringEffect::apply`] |

mod angle_random_walk;
mod anisoinertia;
mod axis_swap;
mod clock_frequency;
pub mod discovered;
mod drift;
mod drift_random_walk;
mod drift_sensor_temperature;
mod lost_counts;
mod misalignment;
mod misalignment_thermal;
mod output_axis_acceleration;
mod pivot_clearance;
mod scale_factor;
mod scale_factor_asymmetry;
mod scale_factor_nonlinearity;
mod sign_inversion;
mod stuck_output;
mod time_offset;

pub use angle_random_walk::AngleRandomWalk;
pub use anisoinertia::Anisoinertia;
pub use axis_swap::AxisSwap;
pub use clock_frequency::ClockFrequency;
pub use drift::Drift;
pub use drift_random_walk::DriftRandomWalk;
pub use drift_sensor_temperature::DriftSensorTemperature;
use geu_protocol::Gyro;
pub use lost_counts::LostCounts;
pub use misalignment::Misalignment;
pub use misalignment_thermal::MisalignmentThermal;
pub use output_axis_acceleration::OutputAxisAcceleration;
pub use pivot_clearance::PivotClearance;
pub use scale_factor::ScaleFactor;
pub use scale_factor_asymmetry::ScaleFactorAsymmetry;
pub use scale_factor_nonlinearity::ScaleFactorNonlinearity;
pub use sign_inversion::SignInversion;
pub use stuck_output::StuckOutput;
pub use time_offset::TimeOffset;

use crate::attitude::MotionStep;
use crate::course::{Interval, TimeCourse};
use crate::number::{ParameterSet, ParameterSpec};
use crate::package::Axes;

/// What is said of an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EffectSpec {
    /// Key in the configuration.
    pub code: &'static str,
    /// A few words.
    pub title: &'static str,
    /// Those of its numbers that are amplitudes: 0 means absent, and courses move them. The others are shapes.
    pub amplitudes: &'static [Amplitude],
    /// The value the paper gives, in words.
    pub paper: &'static str,
    /// Section, table or equation of the paper.
    pub source: &'static str,
}

/// Limits that courses of an amplitude have. The amplitude itself is the number of the same index.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Amplitude {
    /// Largest `-ramp`, per day.
    pub per_day: f64,
    /// Largest `-temperature`, per K.
    pub per_k: f64,
}

/// A definition: numbers and what is said of them together.
pub trait Effect: ParameterSet + Default {
    /// What is said of it.
    const SPEC: EffectSpec;
    /// Whether it draws random numbers: its amplitude is a deviation, and has no signature in the counts.
    const IS_NOISE: bool = false;

    /// A number that does not go with the others, each within its own limits, and what was expected of it. Asked with the
    /// amplitudes at the largest that they reach.
    fn consistency_error(&self) -> Option<(&'static str, String)> {
        None
    }
}

/// Temperatures at a moment, °C.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Temperatures {
    /// Of the electronics.
    pub electronics_c: f64,
    /// The electronics temperature at which the calibration holds.
    pub electronics_reference_c: f64,
    /// Of the sensor.
    pub sensor_c: f64,
}

/// Time as the unit keeps it over one sample interval.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SampleTiming {
    /// Relative error of the unit's clock, positive when it is fast.
    pub clock_error: f64,
    /// How much older than its time stamp the motion is that the counts tell.
    pub shift_s: f64,
}

/// One gyro over one sub-step, on its way from true rotation to counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GyroSubStep {
    /// Rotation about the input axis with its misalignment, arcsec.
    pub input_arcsec: f64,
    /// What the head senses beside that rotation, arcsec.
    pub added_arcsec: f64,
    /// D over the sub-step: what is sensed and not counted, arcsec.
    pub drift_arcsec: f64,
    /// SF: arcsec per count.
    pub scale_factor: f64,
    /// Counts that come from no rotation.
    pub added_counts: f64,
}

impl GyroSubStep {
    /// N of equation 1, as a real number, with the clock's factors (Casteren §3.2): SF falls by the clock's error, D per
    /// on-board sample by twice as much in all. A sub-step is already shorter by once the error; once remains.
    #[inline]
    pub fn counts(&self, timing: &SampleTiming) -> f64 {
        let clock = 1.0 - timing.clock_error;
        (self.input_arcsec + self.added_arcsec - self.drift_arcsec * clock) / (self.scale_factor * clock)
            + self.added_counts
    }
}

/// What a law of a head can know beside the head itself.
#[derive(Debug, Clone, Copy)]
pub struct EffectInputs<'a> {
    /// Motion over the sub-step.
    pub step: &'a MotionStep,
    /// Axes of the gyro.
    pub axes: &'a Axes,
    /// Temperatures, held over the sample interval.
    pub temperatures: &'a Temperatures,
    /// True time since the start of the run at the sub-step's end.
    pub end_s: f64,
}

/// An effect on the whole unit.
pub trait UnitEffect: Effect {
    /// What it remembers.
    type State: Clone + std::fmt::Debug + Default;
    /// Acts on the unit's time, once per sample interval.
    #[inline]
    fn timing(&self, _timing: &mut SampleTiming) {}
    /// Acts on the four heads over one sub-step, in the order of [`Gyro::ALL`].
    #[inline]
    fn apply(&self, _state: &mut Self::State, _heads: &mut [GyroSubStep; 4], _step: &MotionStep) {}
}

/// An effect on one gyro.
pub trait GyroEffect: Effect {
    /// What it remembers.
    type State: Clone + std::fmt::Debug;
    /// The state at the start of a run.
    fn start(seed: u64, gyro: Gyro) -> Self::State;
    /// Called once per sample interval, before the first sub-step; `length_s` is its true length.
    #[inline]
    fn begin(&self, _state: &mut Self::State, _length_s: f64) {}
    /// Acts over one sub-step.
    fn apply(&self, state: &mut Self::State, head: &mut GyroSubStep, surroundings: &EffectInputs);
}

/// A fault of one gyro's wiring.
pub trait WiringEffect: Effect {
    /// What it remembers.
    type State: Clone + std::fmt::Debug + Default;
    /// Acts on the four counts of a sample; `gyro` is the one that has the fault.
    fn apply(&self, state: &mut Self::State, gyro: Gyro, counts: &mut [f64; 4]);
}

/// Sees how counts come about. Columns are those of [`columns`], in order.
pub trait Probe: Default {
    /// Whether it looks at all; where it does not, nothing is worked out for it.
    const LOOKS: bool;
    /// A sub-step begins; `true_arcsec` is the true rotation about the gyro's input axis.
    fn begin(&mut self, true_arcsec: f64);
    /// What stands in `column` has acted; N is now `counts`.
    fn after(&mut self, column: usize, counts: f64);
    /// What stands in `column` has changed the count of the sample by `counts`.
    fn changed(&mut self, column: usize, counts: f64);
}

/// Sees nothing, at no cost.
impl Probe for () {
    const LOOKS: bool = false;
    #[inline]
    fn begin(&mut self, _true_arcsec: f64) {}
    #[inline]
    fn after(&mut self, _column: usize, _counts: f64) {}
    #[inline]
    fn changed(&mut self, _column: usize, _counts: f64) {}
}

/// Columns of a trace: the calibration, the effects of the three lists with the discovered one before those of a gyro,
/// self-test, power, faults of heads, saturation.
pub const COLUMNS: usize = 6 + UnitEffects::SPECS.len() + GyroEffects::SPECS.len() + WiringEffects::SPECS.len();
/// Column of the calibration.
pub const CALIBRATION_COLUMN: usize = 0;
/// First column of [`UnitEffects`].
pub const UNIT_COLUMNS: usize = 1;
/// Column of what the terms of [`discovered`] add.
pub const DISCOVERED_COLUMN: usize = UNIT_COLUMNS + UnitEffects::SPECS.len();
/// First column of [`GyroEffects`].
pub const HEAD_COLUMNS: usize = DISCOVERED_COLUMN + 1;
/// First column of [`WiringEffects`].
pub const WIRING_COLUMNS: usize = HEAD_COLUMNS + GyroEffects::SPECS.len();
/// Column of the counts that a self-test adds.
pub const SELF_TEST_COLUMN: usize = COLUMNS - 4;
/// Column of what a stopped gyro does not count.
pub const POWER_COLUMN: usize = COLUMNS - 3;
/// Column of what named faults of a gyro change.
pub const FAULT_COLUMN: usize = COLUMNS - 2;
/// Column of what clipping to 16 bits takes away.
pub const SATURATION_COLUMN: usize = COLUMNS - 1;

/// Codes of the columns, in order.
pub fn columns() -> Vec<&'static str> {
    let codes = |specs: &'static [EffectSpec]| specs.iter().map(|spec| spec.code);
    std::iter::once("calibration")
        .chain(codes(UnitEffects::SPECS))
        .chain([discovered::CODE])
        .chain(codes(GyroEffects::SPECS))
        .chain(codes(WiringEffects::SPECS))
        .chain(["self-test", "gyro-power", "fault", "saturation"])
        .collect()
}

/// A list of effects as data.
pub trait Effects: Copy + Default {
    /// What is said of each, in physical order.
    fn specs(&self) -> &'static [EffectSpec];
    /// The numbers of the effect at `index` of [`Effects::specs`].
    fn numbers(&self, index: usize) -> &dyn ParameterSet;
    /// The numbers of the effect at `index` of [`Effects::specs`].
    fn numbers_mut(&mut self, index: usize) -> &mut dyn ParameterSet;
    /// See [`Effect::consistency_error`], of the effect at `index` of [`Effects::specs`].
    fn consistency_error(&self, index: usize) -> Option<(&'static str, String)>;
    /// See [`Effect::IS_NOISE`], of the effect at `index` of [`Effects::specs`].
    fn is_noise(&self, index: usize) -> bool;
}

/// A list of effects with the courses of their amplitudes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EffectConfiguration<E> {
    /// The constant part.
    pub constant: E,
    /// What is added to it in time.
    pub courses: Vec<TimeCourse>,
}

impl<E: Effects> EffectConfiguration<E> {
    /// The effects as they stand over one sample interval.
    #[inline]
    pub fn at(&self, interval: &Interval) -> E {
        let mut effects = self.constant;
        for course in &self.courses {
            let numbers = effects.numbers_mut(course.effect);
            let ParameterSpec { least, greatest, .. } = numbers.specs()[course.amplitude];
            let amplitude = numbers.value_mut(course.amplitude);
            // Limits are what the model is good for: a course that grows without end stays at them.
            *amplitude = (*amplitude + course.value(interval)).clamp(least, greatest);
        }
        effects
    }

    /// The same without a copy where nothing changes in time; otherwise it stands in `room`.
    #[inline]
    pub fn standing<'a>(&'a self, interval: &Interval, room: &'a mut Option<E>) -> &'a E {
        if self.courses.is_empty() { &self.constant } else { room.insert(self.at(interval)) }
    }

    /// The effects with each amplitude at the largest that it reaches.
    pub fn largest(&self) -> E {
        let mut effects = self.constant;
        for course in &self.courses {
            let numbers = effects.numbers_mut(course.effect);
            let ParameterSpec { least, greatest, .. } = numbers.specs()[course.amplitude];
            let amplitude = numbers.value_mut(course.amplitude);
            *amplitude = (*amplitude + course.largest()).clamp(least, greatest);
        }
        effects
    }

    /// The same without the effects that draw random numbers.
    #[must_use]
    pub fn without_noise(mut self) -> Self {
        let absent = E::default();
        for index in (0..absent.specs().len()).filter(|&index| absent.is_noise(index)) {
            for number in 0..absent.numbers(index).specs().len() {
                *self.constant.numbers_mut(index).value_mut(number) = absent.numbers(index).value(number);
            }
            self.courses.retain(|course| course.effect != index);
        }
        self
    }

    /// Whether the effect at `index` is there: an amplitude that is not 0, or a course.
    pub fn has(&self, index: usize) -> bool {
        let (numbers, amplitudes) = (self.constant.numbers(index), self.constant.specs()[index].amplitudes.len());
        (0..amplitudes).any(|amplitude| numbers.value(amplitude) != 0.0)
            || self.courses.iter().any(|course| course.effect == index)
    }
}

macro_rules! effect_list {
    ($(#[$doc:meta])* $list:ident { $($field:ident: $type:ident),* $(,)? }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, Default, PartialEq)]
        pub struct $list { $(#[allow(missing_docs)] pub $field: $type),* }

        impl $list {
            /// What is said of each, in physical order.
            pub const SPECS: &'static [EffectSpec] = &[$(<$type as Effect>::SPEC),*];
        }

        impl Effects for $list {
            fn specs(&self) -> &'static [EffectSpec] { Self::SPECS }
            fn numbers(&self, index: usize) -> &dyn ParameterSet {
                let Self { $($field),* } = self;
                [$($field as &dyn ParameterSet),*][index]
            }
            fn numbers_mut(&mut self, index: usize) -> &mut dyn ParameterSet {
                let Self { $($field),* } = self;
                [$($field as &mut dyn ParameterSet),*].into_iter().nth(index).expect("index of SPECS")
            }
            fn consistency_error(&self, index: usize) -> Option<(&'static str, String)> {
                let Self { $($field),* } = self;
                [$($field.consistency_error()),*].into_iter().nth(index).expect("index of SPECS")
            }
            fn is_noise(&self, index: usize) -> bool {
                [$(<$type as Effect>::IS_NOISE),*][index]
            }
        }
    };
}

macro_rules! unit_effects {
    ($($field:ident: $type:ident),* $(,)?) => {
        effect_list! {
            /// The effects of the whole unit, in physical order.
            UnitEffects { $($field: $type),* }
        }

        /// What the effects of the unit remember.
        #[derive(Debug, Clone, Default)]
        pub struct UnitStates { $($field: <$type as UnitEffect>::State),* }

        impl UnitEffects {
            /// The unit's time over one sample interval after each effect, in order.
            #[inline]
            pub fn timing(&self) -> [SampleTiming; UnitEffects::SPECS.len()] {
                let Self { $($field),* } = self;
                let mut timing = SampleTiming::default();
                [$({ $field.timing(&mut timing); timing }),*]
            }

            /// Lets every effect act on the heads, in order.
            #[inline]
            pub fn apply<T: Probe>(&self, states: &mut UnitStates, heads: &mut [GyroSubStep; 4], step: &MotionStep, taps: &mut [T; 4]) {
                let Self { $($field),* } = self;
                let mut column = UNIT_COLUMNS;
                $(
                    $field.apply(&mut states.$field, heads, step);
                    look(taps, heads, column);
                    column += 1;
                )*
                let _ = column;
            }
        }
    };
}

#[inline]
fn look<T: Probe>(taps: &mut [T; 4], heads: &[GyroSubStep; 4], column: usize) {
    if T::LOOKS {
        for (tap, head) in taps.iter_mut().zip(heads) {
            tap.after(column, head.counts(&SampleTiming::default()));
        }
    }
}

macro_rules! head_effects {
    ($($field:ident: $type:ident),* $(,)?) => {
        effect_list! {
            /// The effects of one gyro, in physical order.
            GyroEffects { $($field: $type),* }
        }

        /// What the effects of one gyro remember.
        #[derive(Debug, Clone)]
        pub struct HeadStates { $($field: <$type as GyroEffect>::State),* }

        impl HeadStates {
            /// The states at the start of a run.
            pub fn start(seed: u64, gyro: Gyro) -> HeadStates {
                HeadStates { $($field: <$type as GyroEffect>::start(seed, gyro)),* }
            }
        }

        impl GyroEffects {
            /// Before the first sub-step of a sample of true length `length_s`.
            #[inline]
            pub fn begin(&self, states: &mut HeadStates, length_s: f64) {
                let Self { $($field),* } = self;
                $($field.begin(&mut states.$field, length_s);)*
            }

            /// Lets every effect act on the head, in order.
            #[inline]
            pub fn apply<T: Probe>(&self, states: &mut HeadStates, head: &mut GyroSubStep, surroundings: &EffectInputs, tap: &mut T) {
                let Self { $($field),* } = self;
                let mut column = HEAD_COLUMNS;
                $(
                    $field.apply(&mut states.$field, head, surroundings);
                    if T::LOOKS {
                        tap.after(column, head.counts(&SampleTiming::default()));
                    }
                    column += 1;
                )*
                let _ = column;
            }
        }
    };
}

macro_rules! wiring_effects {
    ($($field:ident: $type:ident),* $(,)?) => {
        effect_list! {
            /// The faults of one gyro's wiring, in order.
            WiringEffects { $($field: $type),* }
        }

        /// What the wiring faults of the four gyros remember.
        #[derive(Debug, Clone, Default)]
        pub struct WiringStates { $($field: [<$type as WiringEffect>::State; 4]),* }

        impl WiringEffects {
            /// Lets the faults of all four gyros act on the counts, fault by fault.
            #[inline]
            pub fn apply<T: Probe>(gyros: &[WiringEffects; 4], states: &mut WiringStates, counts: &mut [f64; 4], taps: &mut [T; 4]) {
                let mut column = WIRING_COLUMNS;
                $(
                    let before = *counts;
                    for gyro in Gyro::ALL {
                        gyros[gyro as usize].$field.apply(&mut states.$field[gyro as usize], gyro, counts);
                    }
                    if T::LOOKS {
                        for index in 0..4 {
                            taps[index].changed(column, counts[index] - before[index]);
                        }
                    }
                    column += 1;
                )*
                let _ = column;
            }
        }
    };
}

unit_effects! {
    time_offset: TimeOffset,
    misalignment_thermal: MisalignmentThermal,
    clock_frequency: ClockFrequency,
}

head_effects! {
    misalignment: Misalignment,
    output_axis_acceleration: OutputAxisAcceleration,
    anisoinertia: Anisoinertia,
    pivot_clearance: PivotClearance,
    scale_factor_nonlinearity: ScaleFactorNonlinearity,
    angle_random_walk: AngleRandomWalk,
    drift: Drift,
    drift_sensor_temperature: DriftSensorTemperature,
    drift_random_walk: DriftRandomWalk,
    scale_factor: ScaleFactor,
    scale_factor_asymmetry: ScaleFactorAsymmetry,
    lost_counts: LostCounts,
}

wiring_effects! {
    sign_inversion: SignInversion,
    axis_swap: AxisSwap,
    stuck_output: StuckOutput,
}
