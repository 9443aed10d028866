//! Searched values of shape parameters and of nonlinear amplitudes.

use std::ops::Range;
use std::sync::Arc;

use geu_model::Configuration;
use geu_model::parameter_spec::{DefaultValue, Role};
use geu_model::time_profile::Size;
use rayon::prelude::*;

use super::ConstantSignature;
use crate::courses::SHORTEST;
use crate::linear_algebra::increment_products;
use crate::measured::TIMING;
use geu_hypothesis::amplitude::AmplitudeRef;

/// Factor between neighbouring values of a nonlinear amplitude.
pub const SIZE_FACTOR: f64 = 1.5;
/// Maximum number of values of a nonlinear amplitude, down to a hundred thousandth of the largest accepted one; and how many of
/// them are run before the next are.
const MAX_SIZES: usize = 30;
const SIZES_AT_ONCE: usize = 5;
/// Values that are run on one core: half of them, so that two cores share them.
const SIZES_OF_A_RUN: usize = 3;
/// Values between two of the grid that differ steeply, and one.
pub const PARTS: i32 = 4;
/// Fitted values, over the value of the run, for which any nonlinear signature is valid: neighbouring values lie within.
pub const NEAR_SIZES: Range<f64> = 0.4..2.5;
/// Smallest departure of the accumulated counts that a signature is kept for: a part of the rounding.
const VISIBLE_COUNTS: f64 = 0.1;
/// Factor between neighbouring time constants, and between widths.
const SHAPE_FACTOR: f64 = 3.0;

/// Signatures of a nonlinear amplitude from its largest accepted values down to the smallest visible ones, which depend on the motion, and
/// between two where they differ by more than in proportion: near the amplitude of a limit cycle, a dead zone of 1.5 times the value adds
/// several times as much. Each is valid for what its neighbours add.
pub fn visible(limits: Size, signatures: impl Fn(&[f64]) -> Vec<ConstantSignature> + Sync) -> Vec<ConstantSignature> {
    let is_visible = |own: &ConstantSignature| {
        let values = own.series.iter().take(TIMING).flat_map(|series| series.iter());
        values.fold(0.0, |largest: f64, value| largest.max(value.abs())) * own.size.abs() > VISIBLE_COUNTS
    };
    let of_sign = |first: f64| {
        let all = std::iter::successors(Some(first), |size| Some(size / SIZE_FACTOR)).take(MAX_SIZES);
        let all: Vec<f64> = all.collect();
        let mut found = Vec::new();
        for some in all.chunks(SIZES_AT_ONCE) {
            let some: Vec<_> = some.par_chunks(SIZES_OF_A_RUN).flat_map_iter(&signatures).collect();
            let are_all = some.iter().all(is_visible);
            found.extend(some.into_iter().filter(is_visible));
            if !are_all {
                break;
            }
        }
        // Time courses at a third of the values.
        found.iter_mut().enumerate().for_each(|(place, own)| own.has_courses = place % 3 == 0);
        let between = |pair: &[ConstantSignature]| -> Vec<ConstantSignature> {
            let is_steep = reach(&pair[0], &pair[1]) != NEAR_SIZES || reach(&pair[1], &pair[0]) != NEAR_SIZES;
            let size = |part: i32| pair[0].size * SIZE_FACTOR.powf(-f64::from(part) / f64::from(PARTS));
            let sizes: Vec<f64> = (1..PARTS).filter(|_| is_steep).map(size).collect();
            signatures(&sizes)
        };
        let between: Vec<Vec<ConstantSignature>> = found.par_windows(2).map(between).collect();
        let between = between.into_iter().chain([Vec::new()]);
        let mut all: Vec<ConstantSignature> =
            found.into_iter().zip(between).flat_map(|(own, between)| std::iter::once(own).chain(between)).collect();
        let valid = |place: usize| {
            let neighbours = all[place.saturating_sub(1)..all.len().min(place + 2)].iter();
            let reached = neighbours.map(|other| reach(&all[place], other));
            reached.fold(NEAR_SIZES, |valid, reach| valid.start.min(reach.start)..valid.end.max(reach.end))
        };
        let valid: Vec<Range<f64>> = (0..all.len()).map(valid).collect();
        all.iter_mut().zip(valid).for_each(|(own, valid)| own.valid = valid);
        all
    };
    let signs = [Some(limits.max), (limits.min < 0.0).then_some(-limits.max)];
    signs.into_par_iter().flatten().flat_map_iter(of_sign).collect()
}

/// Ratios of what another value adds to what this one adds, of all gyros, and [`NEAR_SIZES`].
fn reach(own: &ConstantSignature, other: &ConstantSignature) -> Range<f64> {
    let ratio = |(of_own, of_other): (&Arc<[f64]>, &Arc<[f64]>)| {
        let [both, squares, _] = increment_products(of_own, of_other);
        both / squares * other.size / own.size
    };
    let ratios = own.series.iter().zip(&other.series).take(TIMING).map(ratio).filter(|ratio| *ratio > 0.0);
    ratios.fold(NEAR_SIZES, |reach, ratio| reach.start.min(ratio)..reach.end.max(ratio))
}

/// Searched values of an effect's shape parameters, defaults first: time constants and widths on a grid; others at their default until they are
/// fitted. An effect of the configuration keeps its own.
pub fn own_shapes(amplitude: &AmplitudeRef, configuration: &Configuration, block_s: f64) -> Vec<Vec<f64>> {
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
            Role::TimeConstant => SHORTEST * block_s,
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
