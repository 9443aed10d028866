//! Lists of effects: their common interface, their time courses, and the macros that declare them.

use super::{EffectSpec, GyroSubStep, Probe, SampleTiming};
use crate::parameter_spec::{ParameterSet, Widening};
use crate::time_profile::{Interval, TimeCourse};

/// A list of effects as data.
pub trait Effects: Copy + Default {
    /// Specifications in physical order.
    fn specs(&self) -> &'static [EffectSpec];
    /// The numbers of the effect at `index` of [`Effects::specs`].
    fn numbers(&self, index: usize) -> &dyn ParameterSet;
    /// The numbers of the effect at `index` of [`Effects::specs`].
    fn numbers_mut(&mut self, index: usize) -> &mut dyn ParameterSet;
    /// See [`super::Effect::consistency_error`], of the effect at `index` of [`Effects::specs`].
    fn consistency_error(&self, index: usize) -> Option<(&'static str, String)>;
    /// See [`super::Effect::IS_NOISE`], of the effect at `index` of [`Effects::specs`].
    fn is_noise(&self, index: usize) -> bool;
    /// See [`super::Effect::FILTERS_MOTION`], of the effect at `index` of [`Effects::specs`].
    fn filters_motion(&self, index: usize) -> bool;
    /// See [`super::Effect::NEEDS_OUTPUT_AXIS`], of the effect at `index` of [`Effects::specs`].
    fn needs_output_axis(&self, index: usize) -> bool;
}

/// A list of effects with the courses of their amplitudes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EffectConfiguration<E> {
    /// The constant part.
    pub constant: E,
    /// Time courses, which are added to it.
    pub courses: Vec<TimeCourse>,
    /// Factors of the limits at which they end.
    pub widening: Widening,
}

impl<E: Effects> EffectConfiguration<E> {
    /// The effects as they stand over one sample interval.
    #[inline]
    pub fn at(&self, interval: &Interval) -> E {
        self.with(|course| course.value(interval))
    }

    /// The effects over one sample interval, in `storage` if a time course changes them.
    #[inline]
    pub fn resolve<'a>(&'a self, interval: &Interval, storage: &'a mut Option<E>) -> &'a E {
        if self.courses.is_empty() { &self.constant } else { storage.insert(self.at(interval)) }
    }

    /// The effects with each amplitude at the largest that it reaches.
    pub fn largest(&self) -> E {
        self.with(TimeCourse::largest)
    }

    /// The effects with these values of the courses.
    #[inline]
    fn with(&self, value: impl Fn(&TimeCourse) -> f64) -> E {
        let mut effects = self.constant;
        for course in &self.courses {
            let numbers = effects.numbers_mut(course.effect);
            let spec = &numbers.specs()[course.amplitude];
            let (min, max) = self.widening.limits(spec, spec.min, spec.max);
            let amplitude = numbers.value_mut(course.amplitude);
            // Limits are what the model is good for: a course that grows without end stays at them.
            *amplitude = (*amplitude + value(course)).clamp(min, max);
        }
        effects
    }

    /// Removes the effects that draw random numbers.
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

    /// The effects with an amplitude other than 0 or a time course, as bits in the order of the list.
    pub fn active(&self) -> u32 {
        let present = (0..self.constant.specs().len()).filter(|&index| self.has(index));
        present.fold(0, |active, index| active | 1 << index)
    }

    /// True if the effect at `index` has an amplitude other than 0 or a time course.
    pub fn has(&self, index: usize) -> bool {
        let (numbers, amplitudes) = (self.constant.numbers(index), self.constant.specs()[index].amplitudes.len());
        (0..amplitudes).any(|amplitude| numbers.value(amplitude) != 0.0)
            || self.courses.iter().any(|course| course.effect == index)
    }
}

/// Declares an effect: its numbers, and its specification. The last block is other items of [`super::Effect`].
macro_rules! effect {
    ($(#[doc = $doc:literal])* pub struct $type:ident ($code:literal, $title:literal) { $($numbers:tt)* }
     amplitudes: [$({ $($amplitude:tt)* }),*],
     paper: $paper:literal,
     source: $source:literal,
     $({ $($item:tt)* })?
    ) => {
        $crate::parameter_spec::numbers! { $(#[doc = $doc])* pub struct $type { $($numbers)* } }

        impl $crate::effect::Effect for $type {
            const SPEC: $crate::effect::EffectSpec = $crate::effect::EffectSpec {
                code: $code,
                title: $title,
                amplitudes: &[$($crate::effect::Amplitude { $($amplitude)* }),*],
                paper: $paper,
                source: $source,
            };
            $($($item)*)?
        }
    };
}

macro_rules! effect_list {
    ($(#[$doc:meta])* $list:ident { $($field:ident: $type:ident),* $(,)? }) => {
        $(mod $field; pub use $field::$type;)*

        $(#[$doc])*
        #[derive(Debug, Clone, Copy, Default, PartialEq)]
        pub struct $list { $(#[allow(missing_docs)] pub $field: $type),* }

        impl $list {
            /// Specifications in physical order.
            pub const SPECS: &'static [EffectSpec] = &[$(<$type as Effect>::SPEC),*];
        }

        impl Effects for $list {
            fn specs(&self) -> &'static [EffectSpec] { Self::SPECS }
            fn numbers(&self, index: usize) -> &dyn ParameterSet {
                let Self { $($field),* } = self;
                [$($field as &dyn ParameterSet),*][index]
            }
            fn numbers_mut(&mut self, index: usize) -> &mut dyn ParameterSet {
                let mut place = 0..;
                $(
                    if place.next() == Some(index) {
                        return &mut self.$field;
                    }
                )*
                unreachable!("index of SPECS")
            }
            fn consistency_error(&self, index: usize) -> Option<(&'static str, String)> {
                let Self { $($field),* } = self;
                [$($field.consistency_error()),*].into_iter().nth(index).expect("index of SPECS")
            }
            fn is_noise(&self, index: usize) -> bool {
                [$(<$type as Effect>::IS_NOISE),*][index]
            }
            fn filters_motion(&self, index: usize) -> bool {
                [$(<$type as Effect>::FILTERS_MOTION),*][index]
            }
            fn needs_output_axis(&self, index: usize) -> bool {
                [$(<$type as Effect>::NEEDS_OUTPUT_AXIS),*][index]
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

        /// States of the unit's effects.
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

            /// The unit's time after all effects.
            #[inline]
            pub fn shared_timing(&self) -> SampleTiming {
                self.timing().last().copied().unwrap_or_default()
            }

            /// Lets every effect act on the heads, in order.
            #[inline]
            pub fn apply<T: Probe>(&self, states: &mut UnitStates, heads: &mut [GyroSubStep], gyros: &[ResolvedGyro], step: &MotionStep, taps: &mut [T]) {
                let Self { $($field),* } = self;
                let mut column = UNIT_COLUMNS;
                $(
                    $field.apply(&mut states.$field, heads, gyros, step);
                    list::record(taps, heads, column);
                    column += 1;
                )*
                let _ = column;
            }
        }
    };
}

#[inline]
pub(super) fn record<T: Probe>(taps: &mut [T], heads: &[GyroSubStep], column: usize) {
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

        /// States of one gyro's effects.
        #[derive(Debug, Clone)]
        pub struct HeadStates { $($field: <$type as GyroEffect>::State),* }

        impl HeadStates {
            /// The states at the start of a run.
            pub fn start(seed: u64, gyro: Gyro) -> HeadStates {
                HeadStates { $($field: EffectState::start(seed, gyro, <$type as Effect>::SPEC.code)),* }
            }
        }

        impl GyroEffects {
            /// Before the first sub-step of a sample of true length `length_s`.
            #[inline]
            pub fn begin(&self, states: &mut HeadStates, temperatures: &Temperatures, length_s: f64) {
                let Self { $($field),* } = self;
                $($field.begin(&mut states.$field, temperatures, length_s);)*
            }

            /// Lets every effect act on the head, in order.
            #[inline]
            pub fn apply<T: Probe>(
                &self,
                states: &mut HeadStates,
                head: &mut GyroSubStep,
                surroundings: &EffectInputs,
                tap: &mut T,
            ) {
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

            /// Lets the effects that have a bit in `active` act over the sub-steps of several samples, one effect after the other: they
            /// share the head of a sub-step alone.
            pub fn apply_over<'a, S: Iterator<Item = (Temperatures, Interval, SubSteps<'a>)>>(
                configuration: &EffectConfiguration<GyroEffects>,
                active: u32,
                states: &mut HeadStates,
                head: &Head,
                samples: impl Fn() -> S,
                heads: &mut [GyroSubStep],
            ) {
                const { assert!(GyroEffects::SPECS.len() <= u32::BITS as usize) };
                let mut index = 0;
                $(
                    if active & (1 << index) != 0 {
                        let has_course = configuration.courses.iter().any(|course| course.effect == index);
                        let mut heads = heads.iter_mut();
                        for (temperatures, interval, steps) in samples() {
                            let own = if has_course { configuration.at(&interval).$field } else { configuration.constant.$field };
                            own.begin(&mut states.$field, &temperatures, steps.length_s());
                            for (step, own_head) in steps.iter().zip(&mut heads) {
                                own.apply(&mut states.$field, own_head, &EffectInputs::new(&step, head, &temperatures));
                            }
                        }
                    }
                    index += 1;
                )*
                let _ = index;
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

        /// States of the wiring faults of the gyros.
        #[derive(Debug, Clone, Default)]
        pub struct WiringStates { $($field: [<$type as WiringEffect>::State; MAX_HEADS]),* }

        impl WiringEffects {
            /// Lets the faults of all gyros act on the counts, fault by fault.
            #[inline]
            pub fn apply<T: Probe>(gyros: &[WiringEffects], states: &mut WiringStates, counts: &mut [f64], taps: &mut [T]) {
                let mut column = WIRING_COLUMNS;
                $(
                    let mut before = [0.0; MAX_HEADS];
                    before[..counts.len()].copy_from_slice(counts);
                    for (index, gyro) in gyros.iter().enumerate() {
                        gyro.$field.apply(&mut states.$field[index], index, counts);
                    }
                    if T::LOOKS {
                        for (index, tap) in taps.iter_mut().enumerate() {
                            tap.changed(column, counts[index] - before[index]);
                        }
                    }
                    column += 1;
                )*
                let _ = column;
            }
        }
    };
}
