//! A sine.

use super::{Interval, TimeProfileSpec};
use crate::parameter_spec::{DefaultValue, ParameterSpec, REAL, REQUIRED, Role, number};

const fn shapes(periods_s: [f64; 2], phase: &'static str) -> [ParameterSpec; 2] {
    let [min, max] = periods_s;
    [
        ParameterSpec { role: Role::Period, ..number("period_s", "s", REAL, REQUIRED, min, max, "period") },
        ParameterSpec {
            role: Role::Phase,
            ..number("phase_rad", "rad", REAL, DefaultValue::Value(0.0), -100.0, 100.0, phase)
        },
    ]
}

fn sine(shapes: &[f64], interval: &Interval, _: &dyn Fn(u64) -> f64) -> f64 {
    libm::sin(std::f64::consts::TAU * interval.middle_s() / shapes[0] + shapes[1])
}

pub(super) const COURSE: TimeProfileSpec = TimeProfileSpec {
    name: "-periodic",
    meaning: "amplitude times sin(2 pi t / period + phase)",
    shapes: &const { shapes([0.1, 1e10], "phase at the start of the first sample interval") },
    value: sine,
    key: |name| format!("amplitude_{name}"),
    ..TimeProfileSpec::CONSTANT
};

pub(super) const FAULT: TimeProfileSpec = TimeProfileSpec {
    name: "sine",
    meaning: "amplitude of a sine from the start on",
    shapes: &const { shapes([1.0, 1e9], "phase at the start") },
    value: sine,
    ..TimeProfileSpec::CONSTANT
};
