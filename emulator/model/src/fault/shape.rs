//! How a fault moves a parameter while it acts: what is added to the configured value.

use super::FaultRng;
use crate::number::{DefaultValue, ParameterSpec, ValueFormat, number};
use crate::units::SAMPLE_INTERVAL_S;

/// The course of what is added.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FaultProfile {
    Step,
    /// Grows evenly, and holds when it is there.
    Ramp {
        over_s: f64,
    },
    /// There for a while, again and again.
    Pulse {
        width_s: f64,
        /// From one to the next; infinite for a single one.
        period_s: f64,
    },
    /// A sine, from 0 at the start.
    Sine {
        period_s: f64,
        phase_rad: f64,
    },
    /// Normally distributed, drawn anew now and then; the size is the deviation.
    Random {
        /// From one draw to the next.
        every_s: f64,
    },
}

pub struct FaultProfileSpec {
    pub name: &'static str,
    pub meaning: &'static str,
    pub numbers: &'static [ParameterSpec],
    law: fn(&[f64]) -> FaultProfile,
}

pub const KINDS: &[FaultProfileSpec] = &[
    FaultProfileSpec { name: "step", meaning: "at once, and held", numbers: &[], law: |_| FaultProfile::Step },
    FaultProfileSpec {
        name: "ramp",
        meaning: "grows evenly for over_s, then holds",
        numbers: &[number("over_s", ValueFormat::Real, DefaultValue::Required, 0.5, 1e9, "how long it grows")],
        law: |numbers| FaultProfile::Ramp { over_s: numbers[0] },
    },
    FaultProfileSpec {
        name: "pulse",
        meaning: "there for width_s, once or each period_s",
        numbers: &[
            number("width_s", ValueFormat::Real, DefaultValue::Required, 0.5, 1e9, "how long it is there"),
            number(
                "period_s",
                ValueFormat::Real,
                DefaultValue::Absent,
                1.0,
                1e9,
                "from one to the next; once where it is not named",
            ),
        ],
        law: |numbers| FaultProfile::Pulse {
            width_s: numbers[0],
            period_s: if numbers[1].is_nan() { f64::INFINITY } else { numbers[1] },
        },
    },
    FaultProfileSpec {
        name: "sine",
        meaning: "amplitude of a sine from the start on",
        numbers: &[
            number("period_s", ValueFormat::Real, DefaultValue::Required, 1.0, 1e9, "period"),
            number("phase_rad", ValueFormat::Real, DefaultValue::Value(0.0), -100.0, 100.0, "phase at the start"),
        ],
        law: |numbers| FaultProfile::Sine { period_s: numbers[0], phase_rad: numbers[1] },
    },
    FaultProfileSpec {
        name: "random",
        meaning: "deviation of normally distributed values, drawn anew each every_s",
        numbers: &[number(
            "every_s",
            ValueFormat::Real,
            DefaultValue::Value(0.5),
            0.5,
            1e9,
            "from one draw to the next",
        )],
        law: |numbers| FaultProfile::Random { every_s: numbers[0] },
    },
];

impl FaultProfileSpec {
    /// The law with these values of [`FaultProfileSpec::numbers`].
    pub fn law(&self, numbers: &[f64]) -> FaultProfile {
        (self.law)(numbers)
    }

    /// The kind of a law, and its values of [`FaultProfileSpec::numbers`].
    pub fn of(law: &FaultProfile) -> (&'static FaultProfileSpec, Vec<f64>) {
        let (index, numbers) = match *law {
            FaultProfile::Step => (0, vec![]),
            FaultProfile::Ramp { over_s } => (1, vec![over_s]),
            FaultProfile::Pulse { width_s, period_s } => {
                (2, vec![width_s, if period_s.is_finite() { period_s } else { f64::NAN }])
            }
            FaultProfile::Sine { period_s, phase_rad } => (3, vec![period_s, phase_rad]),
            FaultProfile::Random { every_s } => (4, vec![every_s]),
        };
        (&KINDS[index], numbers)
    }
}

impl FaultProfile {
    /// What stands before the size `elapsed_s` after the start with sample interval `start`, at the middle of a sample interval.
    pub fn factor(&self, start: u64, elapsed_s: f64, draw: &FaultRng) -> f64 {
        match *self {
            FaultProfile::Step => 1.0,
            FaultProfile::Ramp { over_s } => (elapsed_s / over_s).min(1.0),
            FaultProfile::Pulse { width_s, period_s } => {
                f64::from(u8::from(if period_s.is_finite() { elapsed_s % period_s } else { elapsed_s } < width_s))
            }
            FaultProfile::Sine { period_s, phase_rad } => {
                libm::sin(std::f64::consts::TAU * elapsed_s / period_s + phase_rad)
            }
            FaultProfile::Random { every_s } => {
                // Known by the sample with which it is drawn.
                let drawn_s = (elapsed_s / every_s).floor() * every_s;
                draw.at("course", start + (drawn_s / SAMPLE_INTERVAL_S) as u64).standard_normal()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn courses_go_as_they_are_named() {
        let draw = FaultRng::new(1, "test");
        let factors =
            |law: FaultProfile| [0.25, 4.75, 5.25, 10.25, 12.25].map(|elapsed_s| law.factor(0, elapsed_s, &draw));
        assert_eq!(factors(FaultProfile::Step), [1.0; 5]);
        assert_eq!(factors(FaultProfile::Ramp { over_s: 10.0 }), [0.025, 0.475, 0.525, 1.0, 1.0]);
        assert_eq!(factors(FaultProfile::Pulse { width_s: 5.0, period_s: 10.0 }), [1.0, 1.0, 0.0, 1.0, 1.0]);
        assert_eq!(factors(FaultProfile::Pulse { width_s: 5.0, period_s: f64::INFINITY }), [1.0, 1.0, 0.0, 0.0, 0.0]);
        assert_eq!(FaultProfile::Sine { period_s: 4.0, phase_rad: 0.0 }.factor(0, 1.0, &draw), 1.0);
        let random = factors(FaultProfile::Random { every_s: 5.0 });
        assert_eq!(random[0], random[1]);
        assert_ne!(random[1], random[2]);
        let later = |start: u64, elapsed_s: f64| FaultProfile::Random { every_s: 5.0 }.factor(start, elapsed_s, &draw);
        assert_ne!(later(0, 0.25), later(7, 0.25), "another start, other values");
        assert_eq!(later(0, 5.25), later(10, 0.25), "the same sample, the same value");
    }

    #[test]
    fn kinds_and_laws_name_each_other() {
        for kind in KINDS {
            let numbers: Vec<f64> = (1..=kind.numbers.len()).map(|number| number as f64).collect();
            let (back, values) = FaultProfileSpec::of(&kind.law(&numbers));
            assert_eq!((back.name, values), (kind.name, numbers));
        }
    }
}
