//! A constant for a limited time: of an effect once, of a fault once or periodically.

use super::{TimeProfileSpec, onset, share_after};
use crate::parameter_spec::{ABSENT, ParameterSpec, REAL, REQUIRED, Role, number};

pub(super) const COURSE: TimeProfileSpec = TimeProfileSpec {
    name: "-pulse",
    meaning: "holds from time_s on for duration_s",
    shapes: &[
        onset(REQUIRED, "from which it holds"),
        ParameterSpec {
            role: Role::Duration,
            ..number("duration_s", "s", REAL, REQUIRED, 0.5, 1e9, "how long it holds")
        },
    ],
    value: |shapes, interval, _| share_after(shapes[0], interval) - share_after(shapes[0] + shapes[1], interval),
    largest: |size| size.max(0.0),
    ..TimeProfileSpec::CONSTANT
};

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
