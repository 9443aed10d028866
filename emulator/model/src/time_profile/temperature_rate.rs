//! Proportional to the rate of change of the electronics temperature; effects only.

use super::TimeProfileSpec;

pub(super) const COURSE: TimeProfileSpec = TimeProfileSpec {
    name: "-temperature-rate",
    meaning: "per K/h of change of the electronics temperature",
    value: |_, interval, _| interval.electronics_rate_k_per_h,
    key: |name| format!("{name}_per_k_per_h"),
    limits: |_, amplitude| (-amplitude.per_k, amplitude.per_k),
    largest: |_| f64::INFINITY,
    follows_temperature: true,
    ..TimeProfileSpec::CONSTANT
};
