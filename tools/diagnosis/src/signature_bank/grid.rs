//! Searched values of shape parameters and of nonlinear amplitudes.

use geu_model::Configuration;
use geu_model::parameter_spec::{DefaultValue, Role};
use geu_model::time_profile::Size;
use rayon::prelude::*;

use super::ConstantSignature;
use crate::courses::SHORTEST_S;
use crate::measured::TIMING;
use geu_hypothesis::amplitude::AmplitudeRef;

/// Factor between neighbouring values of a nonlinear amplitude.
pub const SIZE_FACTOR: f64 = 1.5;
/// Maximum number of values of a nonlinear amplitude, down to a hundred thousandth of the largest accepted one; run at once.
const MAX_SIZES: usize = 30;
const SIZES_AT_ONCE: usize = 5;
/// Smallest departure of the accumulated counts that a signature is kept for: a part of the rounding.
const VISIBLE_COUNTS: f64 = 0.1;
/// Factor between neighbouring time constants, and between widths.
const SHAPE_FACTOR: f64 = 3.0;

/// Signatures of a nonlinear amplitude from its largest accepted values down to the smallest visible ones, which depend on the motion.
pub fn visible(limits: Size, signature: impl Fn(f64) -> ConstantSignature + Sync) -> Vec<ConstantSignature> {
    let is_visible = |own: &ConstantSignature| {
        let values = own.series.iter().take(TIMING).flat_map(|series| series.iter());
        values.fold(0.0, |largest: f64, value| largest.max(value.abs())) * own.size.abs() > VISIBLE_COUNTS
    };
    let of_sign = |first: f64| {
        let all = std::iter::successors(Some(first), |size| Some(size / SIZE_FACTOR)).take(MAX_SIZES);
        let all: Vec<f64> = all.collect();
        let mut found = Vec::new();
        for some in all.chunks(SIZES_AT_ONCE) {
            let signatures: Vec<_> = some.par_iter().map(|&size| signature(size)).collect();
            let are_all = signatures.iter().all(is_visible);
            found.extend(signatures.into_iter().filter(is_visible));
            if !are_all {
                break;
            }
        }
        found
    };
    let signs = [Some(limits.max), (limits.min < 0.0).then_some(-limits.max)];
    signs.into_par_iter().flatten().flat_map_iter(of_sign).collect()
}

/// Searched values of an effect's shape parameters, defaults first: time constants and widths on a grid; others at their default until they are
/// fitted. An effect of the configuration keeps its own.
pub fn own_shapes(amplitude: &AmplitudeRef, configuration: &Configuration) -> Vec<Vec<f64>> {
    if let Some(configured) = amplitude.configured_shapes(configuration) {
        return vec![configured];
    }
    let defaults: Vec<f64> = amplitude
        .own_shapes()
        .iter()
        .map(|number| match number.default {
            DefaultValue::Value(value) => value,
            DefaultValue::Required | DefaultValue::Absent => number.min.max(0.0),
        })
        .collect();
    let mut all = vec![defaults.clone()];
    for (index, number) in amplitude.own_shapes().iter().enumerate() {
        let shortest = match number.role {
            Role::TimeConstant => SHORTEST_S,
            Role::Width => 0.0,
            _ => continue,
        };
        if !defaults[index].is_finite() {
            continue;
        }
        for factor in [SHAPE_FACTOR.powi(-2), 1.0 / SHAPE_FACTOR, SHAPE_FACTOR, SHAPE_FACTOR.powi(2)] {
            let value = defaults[index] * factor;
            if (number.min.max(shortest)..=number.max).contains(&value) {
                let mut shapes = defaults.clone();
                shapes[index] = value;
                all.push(shapes);
            }
        }
    }
    all
}
