//! The effects, one file each, and the lists that name them in physical order. Nothing else names an effect.
//!
//! What a law acts on says where and on whom it acts. Effects of the unit are one list ([`UnitEffects`]), effects of a
//! gyro another ([`HeadEffects`]); their laws are called statically from the list, in the hot loop. All numbers go
//! through [`Effects`]: configuration and its schema, courses, and whatever searches or moves an amplitude.
//!
//! | acts on | when | trait |
//! |---|---|---|
//! | [`Timing`] | once per half second | [`TimingLaw`] |
//! | [`Head`] | once per half second ([`HeadLaw::begin`]), and in every sub-step ([`HeadLaw::apply`]) | [`HeadLaw`] |

mod angle_random_walk;
mod clock_frequency;
mod drift;
mod drift_random_walk;
mod drift_sensor_temperature;
mod misalignment;
mod scale_factor;

pub use angle_random_walk::AngleRandomWalk;
pub use clock_frequency::ClockFrequency;
pub use drift::Drift;
pub use drift_random_walk::DriftRandomWalk;
pub use drift_sensor_temperature::DriftSensorTemperature;
use geu_protocol::Gyro;
pub use misalignment::Misalignment;
pub use scale_factor::ScaleFactor;

use crate::attitude::Step;
use crate::course::{Course, Interval};
use crate::number::{Number, Numbers};
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

impl EffectSpec {
    /// Index among the numbers of the amplitude of that name.
    pub fn amplitude(&self, numbers: &[Number], name: &str) -> Option<usize> {
        numbers.iter().take(self.amplitudes.len()).position(|number| number.name == name)
    }
}

/// A definition: numbers and what is said of them together.
pub trait Effect: Numbers + Default {
    /// What is said of it.
    const SPEC: EffectSpec;
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

/// Time as the unit keeps it over one half second.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Timing {
    /// Relative error of the unit's clock, positive when it is fast.
    pub clock_error: f64,
}

/// One gyro over one sub-step, on its way from true rotation to counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Head {
    /// Rotation about the input axis with its misalignment, arcsec.
    pub input_arcsec: f64,
    /// What the head senses beside that rotation, arcsec.
    pub added_arcsec: f64,
    /// D over the sub-step: what is sensed and not counted, arcsec.
    pub drift_arcsec: f64,
    /// SF: arcsec per count.
    pub scale_factor: f64,
}

impl Head {
    /// N of equation 1, as a real number.
    #[inline]
    pub fn counts(&self) -> f64 {
        (self.input_arcsec + self.added_arcsec - self.drift_arcsec) / self.scale_factor
    }
}

/// What a law of a head can know beside the head itself.
#[derive(Debug, Clone, Copy)]
pub struct Surroundings<'a> {
    /// Motion over the sub-step.
    pub step: &'a Step,
    /// Axes of the gyro.
    pub axes: &'a Axes,
    /// Temperatures, held over the half second.
    pub temperatures: &'a Temperatures,
}

/// An effect on the unit's time.
pub trait TimingLaw: Effect {
    /// Acts, once per half second.
    fn apply(&self, timing: &mut Timing);
}

/// An effect on one gyro.
pub trait HeadLaw: Effect {
    /// What it remembers, apart from its parameters, so that a number moved live never resets it.
    type State: Clone + std::fmt::Debug;
    /// The state at the start of a run.
    fn start(seed: u64, gyro: Gyro) -> Self::State;
    /// Called once per half second, before the first sub-step; `length_s` is its true length.
    #[inline]
    fn begin(&self, _state: &mut Self::State, _length_s: f64) {}
    /// Acts over one sub-step.
    fn apply(&self, state: &mut Self::State, head: &mut Head, surroundings: &Surroundings);
}

/// Sees a head on its way through a sub-step; what an effect contributes is what it changes.
pub trait Tap {
    /// The head has the calibration alone; `true_arcsec` is the true rotation about its input axis.
    fn calibrated(&mut self, true_arcsec: f64, head: &Head);
    /// The effect at `index` of the list has just acted.
    fn after(&mut self, index: usize, head: &Head);
    /// N with the clock's factors.
    fn closed(&mut self, counts: f64);
}

/// Sees nothing, at no cost.
impl Tap for () {
    #[inline]
    fn calibrated(&mut self, _true_arcsec: f64, _head: &Head) {}
    #[inline]
    fn after(&mut self, _index: usize, _head: &Head) {}
    #[inline]
    fn closed(&mut self, _counts: f64) {}
}

/// A list of effects as data.
pub trait Effects: Copy + Default {
    /// What is said of each, in physical order.
    fn specs(&self) -> &'static [EffectSpec];
    /// The numbers of the effect at `index` of [`Effects::specs`].
    fn numbers(&self, index: usize) -> &dyn Numbers;
    /// The numbers of the effect at `index` of [`Effects::specs`].
    fn numbers_mut(&mut self, index: usize) -> &mut dyn Numbers;
}

/// A list of effects with the courses of their amplitudes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Configured<E> {
    /// The constant part.
    pub constant: E,
    /// What is added to it in time.
    pub courses: Vec<Course>,
}

impl<E: Effects> Configured<E> {
    /// The effects as they stand over one half second.
    #[inline]
    pub fn at(&self, interval: &Interval) -> E {
        let mut effects = self.constant;
        for course in &self.courses {
            *effects.numbers_mut(course.effect).value_mut(course.amplitude) += course.value(interval);
        }
        effects
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
            fn numbers(&self, index: usize) -> &dyn Numbers {
                let Self { $($field),* } = self;
                [$($field as &dyn Numbers),*][index]
            }
            fn numbers_mut(&mut self, index: usize) -> &mut dyn Numbers {
                let Self { $($field),* } = self;
                [$($field as &mut dyn Numbers),*].into_iter().nth(index).expect("index of SPECS")
            }
        }
    };
}

macro_rules! head_effects {
    ($($field:ident: $type:ident),* $(,)?) => {
        effect_list! {
            /// The effects of one gyro, in physical order.
            HeadEffects { $($field: $type),* }
        }

        /// What the effects of one gyro remember.
        #[derive(Debug, Clone)]
        pub struct HeadStates { $($field: <$type as HeadLaw>::State),* }

        impl HeadStates {
            /// The states at the start of a run.
            pub fn start(seed: u64, gyro: Gyro) -> HeadStates {
                HeadStates { $($field: <$type as HeadLaw>::start(seed, gyro)),* }
            }
        }

        impl HeadEffects {
            /// Before the first sub-step of a half second of true length `length_s`.
            #[inline]
            pub fn begin(&self, states: &mut HeadStates, length_s: f64) {
                let Self { $($field),* } = self;
                $($field.begin(&mut states.$field, length_s);)*
            }

            /// Lets every effect act on the head, in order.
            #[inline]
            pub fn apply(&self, states: &mut HeadStates, head: &mut Head, surroundings: &Surroundings, tap: &mut impl Tap) {
                let Self { $($field),* } = self;
                let mut index = 0;
                $($field.apply(&mut states.$field, head, surroundings); tap.after(index, head); index += 1;)*
                let _ = index;
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

        impl UnitEffects {
            /// The unit's time over one half second.
            #[inline]
            pub fn timing(&self) -> Timing {
                let Self { $($field),* } = self;
                let mut timing = Timing::default();
                $($field.apply(&mut timing);)*
                timing
            }
        }
    };
}

unit_effects! {
    clock_frequency: ClockFrequency,
}

head_effects! {
    misalignment: Misalignment,
    angle_random_walk: AngleRandomWalk,
    drift: Drift,
    drift_sensor_temperature: DriftSensorTemperature,
    drift_random_walk: DriftRandomWalk,
    scale_factor: ScaleFactor,
}
