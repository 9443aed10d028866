//! A constant for a limited time, once or periodically; faults only.

use super::TimeProfileSpec;
use crate::parameter_spec::{ABSENT, REAL, REQUIRED, number};

pub(super) const FAULT: TimeProfileSpec = TimeProfileSpec {
    name: "pulse",
    meaning: "there for width_s, once or each period_s",
    shapes: &[
        number("width_s", "s", REAL, REQUIRED, 0.5, 1e9, "how long it is there"),
        number("period_s", "s", REAL, ABSENT, 1.0, 1e9, "from one to the next; once where it is not named"),
    ],
    value: |shapes, interval, _| {
        let elapsed_s = interval.middle_s();
        let in_period_s = if shapes[1].is_finite() { elapsed_s % shapes[1] } else { elapsed_s };
        f64::from(in_period_s < shapes[0])
    },
    ..TimeProfileSpec::CONSTANT
};
