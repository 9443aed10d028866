//! A value that decays exponentially after an onset, such as a drift after switch-on. A sample interval counts with its mean.

use super::{Interval, TimeProfileSpec, onset};
use crate::parameter_spec::{DefaultValue, ParameterSpec, REAL, REQUIRED, Role, number};

const TIME_CONSTANT: ParameterSpec = ParameterSpec {
    role: Role::TimeConstant,
    ..number("time_constant_s", "s", REAL, REQUIRED, 1.0, 1e9, "time in which it decays to 1/e")
};

/// Mean over the interval of exp(−(t − onset)/time constant), 0 before the onset.
fn mean(onset_s: f64, time_constant_s: f64, interval: &Interval) -> f64 {
    let from_s = interval.start_s.max(onset_s);
    if interval.end_s <= from_s {
        return 0.0;
    }
    let share = (interval.end_s - from_s) / (interval.end_s - interval.start_s);
    let decayed = (interval.end_s - from_s) / time_constant_s;
    share * libm::exp(-(from_s - onset_s) / time_constant_s) * -libm::expm1(-decayed) / decayed
}

pub(super) const COURSE: TimeProfileSpec = TimeProfileSpec {
    name: "-settling",
    meaning: "times exp(-(t - time_s)/time_constant_s) from time_s on",
    shapes: &[onset(DefaultValue::Value(0.0), "from which it decays"), TIME_CONSTANT],
    value: |shapes, interval, _| mean(shapes[0], shapes[1], interval),
    largest: |size| size.max(0.0),
    ..TimeProfileSpec::CONSTANT
};

pub(super) const FAULT: TimeProfileSpec = TimeProfileSpec {
    name: "settling",
    meaning: "at once, then decays with time_constant_s",
    shapes: &[TIME_CONSTANT],
    value: |shapes, interval, _| mean(0.0, shapes[0], interval),
    ..TimeProfileSpec::CONSTANT
};
