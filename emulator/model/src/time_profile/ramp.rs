//! Linear growth: of an effect without end, per day; of a fault up to its size.

use super::TimeProfileSpec;
use crate::parameter_spec::{REAL, REQUIRED, number};
use crate::units::S_PER_DAY;

pub(super) const COURSE: TimeProfileSpec = TimeProfileSpec {
    name: "-ramp",
    meaning: "per day, from the start",
    value: |_, interval, _| interval.middle_s() / S_PER_DAY,
    key: |name| format!("{name}_per_day"),
    limits: |_, amplitude| (-amplitude.per_day, amplitude.per_day),
    largest: |size| if size <= 0.0 { 0.0 } else { f64::INFINITY },
    grown: |size, by_s| size * by_s / S_PER_DAY,
    ..TimeProfileSpec::CONSTANT
};

pub(super) const FAULT: TimeProfileSpec = TimeProfileSpec {
    name: "ramp",
    meaning: "grows evenly for over_s, then holds",
    shapes: &[number("over_s", "s", REAL, REQUIRED, 0.5, 1e9, "how long it grows")],
    value: |shapes, interval, _| (interval.middle_s() / shapes[0]).min(1.0),
    ..TimeProfileSpec::CONSTANT
};
