//! A constant from an onset on. A step inside a sample interval counts with the share of the interval after it.

use super::TimeProfileSpec;
use crate::parameter_spec::{ParameterSpec, REAL, REQUIRED, Role, number};

pub(super) const COURSE: TimeProfileSpec = TimeProfileSpec {
    name: "-step",
    meaning: "holds from time_s on",
    shapes: &[ParameterSpec {
        role: Role::Onset,
        ..number(
            "time_s",
            "s",
            REAL,
            REQUIRED,
            0.0,
            1e10,
            "from which it holds, since the start of the first sample interval",
        )
    }],
    value: |shapes, interval, _| ((interval.end_s - shapes[0]) / (interval.end_s - interval.start_s)).clamp(0.0, 1.0),
    largest: |size| size.max(0.0),
    ..TimeProfileSpec::CONSTANT
};

pub(super) const FAULT: TimeProfileSpec =
    TimeProfileSpec { name: "step", meaning: "at once, and held", ..TimeProfileSpec::CONSTANT };
