//! Proportional to the electronics temperature above its reference; effects only.

use super::TimeProfileSpec;

pub(super) const COURSE: TimeProfileSpec = TimeProfileSpec {
    name: "-temperature",
    meaning: "per K of electronics temperature above its reference",
    value: |_, interval, _| interval.electronics_excess_k,
    key: |name| format!("{name}_per_k"),
    limits: |_, amplitude| (-amplitude.per_k, amplitude.per_k),
    largest: |_| f64::INFINITY,
    follows_temperature: true,
    ..TimeProfileSpec::CONSTANT
};
