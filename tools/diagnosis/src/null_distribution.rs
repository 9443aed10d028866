//! Detection thresholds from the null distribution: the gains of the search on effect-free recordings of this motion and noise.
//!
//! A null recording consists of the model's counts along the reference with new random walks and rounding, and a drift rate slightly off
//! its nominal value. The largest gain in each family of hypotheses follows a Gumbel distribution. Its upper percentile is the
//! threshold; the families share the false alarm rate equally.
//!
//! A null recording is searched on the grid only, and a measured one also between: the best courses of its grid are optimised. If the noise
//! separates n courses between two of the grid, the largest χ² is at most 2 ln n above that of the grid, as if all n were tried everywhere.

use std::cmp::Reverse;

use geu_model::device::Head;
use geu_model::noise::{Flicker, NoiseStream};
use geu_model::time_profile::COURSES;
use geu_model::units::{PPM, S_PER_H};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::diagnosis_case::DiagnosisCase;
use crate::measured::{BLOCK, CHANNELS, ModelRun, Series, TIMING, nodes};
use crate::model_state::ModelState;
use crate::noise::Walk;
use crate::normal_equations::NormalEquations;
use crate::null_products::{NullChannel, NullProducts, OfRuns, RUNS, null_channels};
use crate::residual_stats::squares_of_blocks;
use crate::search::{set_penalty, sets};
use crate::signature::reaches;
use crate::signature_bank::{Column, HypothesisFamily, SignatureBank, Variation};
use crate::significance::{FOUR_SIGMA_CHI2, FOUR_SIGMAS, THREE_SIGMAS};
use crate::sweep::{Swept, sweep};
use crate::whiteness::{kurtosis, whiteness_statistic};
use crate::whitening::NoiseModel;
use geu_hypothesis::Hypothesis;

/// Probability of a detection in a recording without effect: below one percent together with the other tests.
pub const FALSE_ALARM_RATE: f64 = 1.0 / 400.0;
/// Probability that the residual of a recording without effect, or with the right effects, is not accepted as noise. The residual of a
/// fit is not quite noise, and that of a missing effect far beyond it.
const FALSE_REJECTION_RATE: f64 = 0.001;
/// 1 sigma of the error of a drift rate, arcsec/s: it determines the beat of the rounding.
const DRIFT_ARCSEC_S: f64 = 3e-4;
/// Euler's constant: the mean of the Gumbel distribution.
const EULER: f64 = 0.577_215_664_901_532_9;
/// Number of null recordings in which walks are fitted.
const NOISE_RUNS: usize = 32;
/// Minimum threshold of a larger walk, four sigma: eight hypotheses at one percent would be 10.3, but rounding that beats with a slow rate
/// sometimes imitates a walk.
const MIN_NOISE_CHI2: f64 = FOUR_SIGMA_CHI2;
/// Threshold of a family or channel without data.
const NEVER: f64 = 1e9;

/// Detection thresholds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Thresholds {
    /// χ² reduction for each family on the grid of the search.
    pub on_grid_chi2: [f64; HypothesisFamily::COUNT],
    /// Largest addition by the optimisation between the courses of the grid.
    pub between_chi2: [f64; HypothesisFamily::COUNT],
    /// Whiteness statistic that noise exceeds once in a thousand recordings.
    pub whiteness_statistic: f64,
}

impl Thresholds {
    /// Largest threshold of the time courses on the grid, without immediate effects: the penalty of a walk, which has no onset.
    pub fn largest(&self) -> f64 {
        let families = (0..HypothesisFamily::COUNT)
            .map(HypothesisFamily)
            .filter(|family| ![HypothesisFamily::SUDDEN, HypothesisFamily::NOISE].contains(family));
        families.map(|family| self.on_grid_chi2[family.0]).filter(|chi2| *chi2 < NEVER).fold(0.0, f64::max)
    }

    /// Penalty of a hypothesis: the threshold of its family, and the penalty of its set of gyros.
    pub fn penalty(&self, family: HypothesisFamily, change: &Hypothesis) -> f64 {
        self.required(family) + set_penalty(&change.gyros, &change.amplitude)
    }

    /// Required χ² reduction in a family.
    pub fn required(&self, family: HypothesisFamily) -> f64 {
        self.on_grid_chi2[family.0] + self.between_chi2[family.0]
    }
}

/// Thresholds from null recordings.
pub fn thresholds(
    case: &DiagnosisCase,
    bank: &SignatureBank,
    path: &ModelRun,
    normal: &NormalEquations,
    noise: &[NoiseModel; CHANNELS],
    seed: u64,
) -> Thresholds {
    let drawn = |run: usize| {
        let raw = draw(case, path, noise, seed.wrapping_add(run as u64));
        (normal.projected_residual_of(&raw), (run < NOISE_RUNS).then_some(raw))
    };
    let (drawn, raw): (Vec<Series>, Vec<Option<Series>>) = (0..RUNS).into_par_iter().map(drawn).unzip();
    let raw: Vec<Series> = raw.into_iter().flatten().collect();
    let whiteness: Vec<f64> = drawn.iter().map(|left| whiteness_statistic(left).0).collect();
    let channels = null_channels(normal, drawn);
    // Signatures with many time courses come first, so that the threads end at the same time.
    let mut bases: Vec<usize> = (0..bank.bases.len()).collect();
    bases.sort_by_key(|&base| Reverse(bank.variations(&bank.bases[base]).len()));
    let bases = bases.into_par_iter().with_max_len(1);
    let largest = bases.map(|base| of_base(bank, base, normal, &channels)).reduce(
        || vec![[0.0; RUNS]; HypothesisFamily::COUNT],
        |mut one, other| {
            for (one, other) in one.iter_mut().flatten().zip(other.iter().flatten()) {
                *one = one.max(*other);
            }
            one
        },
    );
    let mut on_grid_chi2 = limits(&largest);
    let mut between_chi2 = [0.0; HypothesisFamily::COUNT];
    for kind in 0..COURSES.len() {
        between_chi2[HypothesisFamily::of_kind(kind).0] = 2.0 * bank.independent_courses(kind).ln();
    }
    let falls = largest_walks(case, noise, &raw);
    on_grid_chi2[HypothesisFamily::NOISE.0] = quantile(&falls, FALSE_ALARM_RATE).unwrap_or(0.0).max(MIN_NOISE_CHI2);
    Thresholds {
        on_grid_chi2,
        between_chi2,
        whiteness_statistic: quantile(&whiteness, FALSE_REJECTION_RATE).unwrap_or(1.0),
    }
}

/// Kurtosis of each channel that the noise of a state exceeds once in a thousand recordings. Rounding of a slow rate is not normal, and a
/// larger walk changes the rate.
pub fn kurtosis_limits(
    case: &DiagnosisCase,
    state: &ModelState,
    normal: &NormalEquations,
    seed: u64,
) -> [f64; CHANNELS] {
    let path = case.run(state);
    let run = |run: usize| {
        let left = normal.projected_residual_of(&draw(case, &path, &state.noise, seed.wrapping_add(run as u64)));
        left.each_ref().map(|left| kurtosis(left))
    };
    let drawn: Vec<[f64; CHANNELS]> = (0..NOISE_RUNS).into_par_iter().map(run).collect();
    std::array::from_fn(|channel| {
        let values: Vec<f64> = drawn.iter().map(|of_run| of_run[channel]).collect();
        let blocks = case.measured.blocks[channel].iter().filter(|block| block.is_compared).count().max(1) as f64;
        let normal = 3.0 + FOUR_SIGMAS * (24.0 / blocks).sqrt();
        quantile(&values, FALSE_REJECTION_RATE).map_or(NEVER, |limit| limit.max(normal))
    })
}

/// Growth of the squared gap, counts² times samples, by a right entry: three sigma above its mean. `added` are block averages of what the entry
/// adds to the model, counts.
pub fn largest_growth(case: &DiagnosisCase, state: &ModelState, added: &Series, seed: u64) -> f64 {
    let path = case.run(state);
    let growth = |run: usize| {
        let with = draw(case, &path, &state.noise, seed.wrapping_add(run as u64));
        let without = std::array::from_fn(|channel| {
            with[channel].iter().zip(&added[channel]).map(|(with, added)| with + added).collect()
        });
        squares_of_blocks(case.measured, &with) - squares_of_blocks(case.measured, &without)
    };
    let growths: Vec<f64> = (0..NOISE_RUNS).into_par_iter().map(growth).collect();
    let mean = growths.iter().sum::<f64>() / NOISE_RUNS as f64;
    let variance = growths.iter().map(|growth| (growth - mean).powi(2)).sum::<f64>() / (NOISE_RUNS - 1) as f64;
    mean + THREE_SIGMAS * variance.sqrt()
}

/// The value that a Gumbel distribution with the moments of these exceeds at this rate; `None` if all are equal.
fn quantile(values: &[f64], rate: f64) -> Option<f64> {
    let (at, scale) = gumbel(values)?;
    Some(at - scale * (-(1.0 - rate).ln()).ln())
}

/// Largest gain of a larger walk on each of these null recordings.
fn largest_walks(case: &DiagnosisCase, noise: &[NoiseModel; CHANNELS], residuals: &[Series]) -> Vec<f64> {
    let walks: Vec<(usize, Walk)> = (0..TIMING).flat_map(|channel| Walk::ALL.map(|walk| (channel, walk))).collect();
    let falls = |(channel, walk): (usize, Walk)| {
        crate::noise::falls(case, channel, &noise[channel], walk, residuals, &case.nuisances)
    };
    let larger = |mut one: Vec<f64>, other: Vec<f64>| {
        one.iter_mut().zip(other).for_each(|(one, other)| *one = one.max(other));
        one
    };
    walks.into_par_iter().map(falls).reduce(|| vec![0.0; residuals.len()], larger)
}

/// Largest gain of one signature for each family and null recording.
fn of_base(
    bank: &SignatureBank,
    base: usize,
    normal: &NormalEquations,
    channels: &[NullChannel; CHANNELS],
) -> Vec<[f64; RUNS]> {
    let base = &bank.bases[base];
    let mut largest = vec![[0.0f64; RUNS]; HypothesisFamily::COUNT];
    let recordings = NullProducts::new(bank, base, channels);
    let push = |variation: &Variation, swept: &Swept<OfRuns>| {
        let family = &mut largest[base.family(variation).0];
        for gyros in sets(bank.gyros(), &base.amplitude, swept.reached()) {
            let Some(gain) = swept.gain(|channel| reaches(&base.amplitude, &gyros, channel)) else { continue };
            let mut sums: OfRuns = [0.0; RUNS];
            for own in (0..CHANNELS).filter(|&channel| reaches(&base.amplitude, &gyros, channel)) {
                let own = swept.linear[own].iter().flatten();
                sums.iter_mut().zip(own).for_each(|(sum, own)| *sum += own);
            }
            // The inverse of the projected signature's square.
            let scale = gain.sigma * gain.sigma;
            let penalty = set_penalty(&gyros, &base.amplitude);
            for (largest, sum) in family.iter_mut().zip(sums) {
                *largest = largest.max(f64::from(sum).powi(2) * scale - penalty);
            }
        }
    };
    let products = |channel: usize, place: usize, white: Option<&Column>| recordings.products(channel, place, white);
    sweep(bank, normal, base, [true; CHANNELS], products, push);
    largest
}

/// Block averages of a null recording minus the model.
fn draw(case: &DiagnosisCase, model: &ModelRun, noise: &[NoiseModel; CHANNELS], seed: u64) -> Series {
    let measured = case.measured;
    std::array::from_fn(|channel| {
        let (own, blocks) = (&noise[channel], &measured.blocks[channel]);
        if channel == TIMING {
            let mut stream = NoiseStream::of_sensor(seed, "null");
            return blocks.iter().map(|_| own.white.sqrt() * stream.standard_normal()).collect();
        }
        let Some(Head { gyro, axes, .. }) = case.nominal.device.heads.get(channel) else { return Vec::new() };
        let (count, interval_s) = (measured.counts.rounded_to[channel], measured.interval_s());
        let mut stream = NoiseStream::new(seed, *gyro, "null");
        let (root_s, mut rate) = (interval_s.sqrt(), DRIFT_ARCSEC_S * stream.standard_normal());
        let mut walk = 100.0 * stream.standard_normal();
        let mut flicker = (own.flicker > 0.0).then(|| Flicker::stationary(&mut stream));
        // The noise of the reference is common to the gyros of an axis.
        let additional = own.white.sqrt();
        let share = |axis: &usize| axes.input_control[*axis].abs();
        let axis = (0..3).max_by(|one, other| share(one).total_cmp(&share(other))).unwrap_or(0);
        let mut of_reference = NoiseStream::of_sensor(seed, ["null X", "null Y", "null Z"][axis]);
        // So is that of its walk.
        let mut of_turns = NoiseStream::of_sensor(seed, "null turns");
        let turns = measured.smoothed.as_ref().map(|smoothed| &smoothed.walk[channel]);
        let weights = measured.weights[channel].as_ref();
        let mut of_block = |block: usize| {
            let mut sum = 0.0;
            // All noise of a block but that of the rate and the rounding.
            let root_scale = case.rounding[channel][block].walk_scale.sqrt();
            if let Some(turns) = turns {
                walk += root_scale * turns[block].map(|sigma| sigma * of_turns.standard_normal()).sum();
            }
            for node in nodes(block) {
                rate += own.rate_walk * root_s * stream.standard_normal();
                walk += rate * interval_s + root_scale * own.angle_walk * root_s * stream.standard_normal();
                if let Some(flicker) = &mut flicker {
                    walk += own.flicker / S_PER_H * flicker.advance(interval_s, &mut stream) * interval_s;
                }
                let angle = model[channel][node];
                if own.scale_walk > 0.0 {
                    let turned = angle - model[channel][node.saturating_sub(1)];
                    walk += root_scale * own.scale_walk * PPM * turned * stream.standard_normal() / root_s;
                }
                sum += match weights {
                    Some(weights) => weights[node] * walk,
                    None if count == 0.0 => walk,
                    None => ((angle + walk) / count).round() * count - angle,
                };
            }
            let scale = case.rounding[channel][block].white_scale.sqrt();
            let additional = additional * scale * of_reference.standard_normal();
            match weights {
                Some(weights) => {
                    let weight: f64 = nodes(block).map(|node| weights[node]).sum();
                    sum / weight + stream.standard_normal() / weight.sqrt() + additional
                }
                None => sum / BLOCK as f64 + additional,
            }
        };
        (0..blocks.len()).map(&mut of_block).collect()
    })
}

/// Thresholds of the families from their largest gains.
fn limits(largest: &[[f64; RUNS]]) -> [f64; HypothesisFamily::COUNT] {
    let laws: Vec<Option<(f64, f64)>> = largest.iter().map(|runs| gumbel(runs)).collect();
    let worst: Vec<f64> = (0..RUNS)
        .map(|run| {
            let reduced =
                laws.iter().zip(largest).filter_map(|(law, runs)| law.map(|(at, scale)| (runs[run] - at) / scale));
            reduced.fold(f64::NEG_INFINITY, f64::max)
        })
        .collect();
    let (at, scale) = gumbel(&worst).unwrap_or((0.0, 1.0));
    let reduced = at - scale * (-(1.0 - FALSE_ALARM_RATE).ln()).ln();
    let threshold = |family: usize| match laws[family] {
        Some((at, scale)) => at + scale * reduced,
        // A family without members or without any gain.
        None => NEVER,
    };
    std::array::from_fn(threshold)
}

/// Location and scale of a Gumbel distribution by its moments; `None` if all values are equal.
fn gumbel(values: &[f64]) -> Option<(f64, f64)> {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let scale = (6.0 * variance).sqrt() / std::f64::consts::PI;
    (scale > 0.0).then_some((mean - EULER * scale, scale))
}

#[cfg(test)]
mod tests;
