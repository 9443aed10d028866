//! Normally distributed values, each held for a time; faults only. The size is the standard deviation.

use super::TimeProfileSpec;
use crate::parameter_spec::{DefaultValue, REAL, number};
use crate::units::SAMPLE_INTERVAL_S;

pub(super) const FAULT: TimeProfileSpec = TimeProfileSpec {
    name: "random",
    meaning: "deviation of normally distributed values, drawn anew each every_s",
    shapes: &[number("every_s", "s", REAL, DefaultValue::Value(0.5), 0.5, 1e9, "from one draw to the next")],
    value: |shapes, interval, normal| {
        // A draw belongs to the sample in which it is made.
        let drawn_s = (interval.middle_s() / shapes[0]).floor() * shapes[0];
        normal((drawn_s / SAMPLE_INTERVAL_S) as u64)
    },
    ..TimeProfileSpec::CONSTANT
};
