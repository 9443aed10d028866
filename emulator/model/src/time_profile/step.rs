//! A constant from an onset on. A step inside a sample interval counts with the share of the interval after it.

use super::{TimeProfileSpec, onset, share_after};
use crate::parameter_spec::REQUIRED;

pub(super) const COURSE: TimeProfileSpec = TimeProfileSpec {
    name: "-step",
    meaning: "holds from time_s on",
    shapes: &[onset(REQUIRED, "from which it holds, since the start of the first sample interval")],
    value: |shapes, interval, _| share_after(shapes[0], interval),
    largest: |size| size.max(0.0),
    ..TimeProfileSpec::CONSTANT
};

pub(super) const FAULT: TimeProfileSpec =
    TimeProfileSpec { name: "step", meaning: "at once, and held", ..TimeProfileSpec::CONSTANT };
