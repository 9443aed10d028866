//! Thresholds: what the search finds where nothing is hidden, on this motion and with this noise.
//!
//! The model's own counts along the reference, with its walks and its rounding drawn anew and the unit a little off what is
//! believed, go through the whole search; the largest gain in each family of hypotheses is kept. Extreme values follow Gumbel's
//! law, of which the upper percent is the threshold; the families share it alike.

use geu_model::noise::NoiseStream;
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::Gyro;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::bank::{Column, HypothesisFamily, SignatureBank, Variation};
use crate::hypothesis::Hypothesis;
use crate::measured::{BLOCK, CHANNELS, Series, Shifts, TIMING, nodes};
use crate::noise::Walk;
use crate::normal::{NormalEquations, ProjectedSignature};
use crate::search::{set_penalty, sets};
use crate::signature::reaches;
use crate::state::DiagnosisCase;
use crate::sweep::{Part, sweep};
use crate::whiteness::{kurtosis, unlikeness};
use crate::whitening::{NoiseModel, ROUNDING};

/// Recordings drawn.
pub const RUNS: usize = 128;
/// Chance of a false name in a recording with nothing hidden.
pub const FALSE_ALARM_RATE: f64 = 0.01;
/// Chance that a recording with nothing hidden, or one explained, is called unexplained: what a fit leaves is not quite noise, and
/// what nobody explains is far beyond it.
const FALSE_ALARMS: f64 = 0.001;
/// How much a believed drift may be off, arcsec/s: what decides how the rounding beats.
const DRIFT_OFF_ARCSEC_S: f64 = 3e-4;
/// Euler's constant: the mean of Gumbel's law.
const EULER: f64 = 0.577_215_664_901_532_9;
/// Recordings in which walks are fitted.
const NOISE_RUNS: usize = 32;
/// Least fall of χ² for a larger walk, four sigma: eight questions at one percent would be 10.3, but rounding that beats with a slow
/// rate is no walk, and looks like one now and then.
const LEAST_NOISE_CHI2: f64 = 16.0;
/// A threshold that nothing reaches, for a family or a channel that tells nothing.
const NEVER: f64 = 1e9;

/// By how much χ² must fall in each family.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Thresholds {
    /// For each family.
    pub chi2: [f64; HypothesisFamily::COUNT],
    /// What the unlikeness of noise exceeds once in a thousand recordings.
    pub unlikeness: f64,
    /// What the kurtosis of each channel exceeds as seldom: rounding while a gyro hardly turns is not normal.
    pub kurtosis: [f64; CHANNELS],
}

impl Thresholds {
    /// The largest of the courses, apart from what happens once.
    pub fn largest(&self) -> f64 {
        let families = (0..HypothesisFamily::COUNT)
            .map(HypothesisFamily)
            .filter(|family| ![HypothesisFamily::SUDDEN, HypothesisFamily::NOISE].contains(family));
        families.map(|family| self.of(family)).filter(|chi2| *chi2 < NEVER).fold(0.0, f64::max)
    }

    /// What is paid for a change: what chance does in its family, and for the choice of its gyros.
    pub fn price(&self, family: HypothesisFamily, change: &Hypothesis) -> f64 {
        self.of(family) + set_penalty(&change.gyros, &change.amplitude)
    }

    /// Of a family.
    pub fn of(&self, family: HypothesisFamily) -> f64 {
        self.chi2[family.0]
    }
}

/// Draws recordings with nothing hidden and searches them.
pub fn thresholds(
    case: &DiagnosisCase,
    bank: &SignatureBank,
    normal: &NormalEquations,
    noise: &[NoiseModel; CHANNELS],
    seed: u64,
) -> Thresholds {
    let model = case.measured.run(case.believed, Shifts::default());
    let raw = |run: usize| draw(case, &model, noise, seed.wrapping_add(run as u64));
    let drawn: Vec<Series> = (0..RUNS).into_par_iter().map(|run| normal.left_of(&raw(run))).collect();
    // Block by block, the runs side by side.
    let blocks = drawn[0][0].len();
    let beside: [Vec<f32>; CHANNELS] = std::array::from_fn(|channel| {
        (0..blocks).flat_map(|block| drawn.iter().map(move |series| series[channel][block] as f32)).collect()
    });
    let largest = (0..bank.bases.len()).into_par_iter().map(|base| of_base(bank, base, normal, &beside)).reduce(
        || vec![[0.0; RUNS]; HypothesisFamily::COUNT],
        |mut one, other| {
            for (one, other) in one.iter_mut().flatten().zip(other.iter().flatten()) {
                *one = one.max(*other);
            }
            one
        },
    );
    let seldom = |values: &[f64], chance: f64| {
        let (at, scale) = gumbel(values)?;
        Some(at - scale * (-(1.0 - chance).ln()).ln())
    };
    let unlike: Vec<f64> = drawn.iter().map(|left| unlikeness(left).0).collect();
    let of_channel = |channel: usize| {
        let values: Vec<f64> = drawn.iter().map(|left| kurtosis(&left[channel])).collect();
        seldom(&values, FALSE_ALARMS).unwrap_or(NEVER)
    };
    let mut chi2 = limits(&largest);
    let falls: Vec<f64> = (0..NOISE_RUNS).into_par_iter().map(|run| largest_walk(case, noise, &raw(run))).collect();
    chi2[HypothesisFamily::NOISE.0] = seldom(&falls, FALSE_ALARM_RATE).unwrap_or(0.0).max(LEAST_NOISE_CHI2);
    Thresholds {
        chi2,
        unlikeness: seldom(&unlike, FALSE_ALARMS).unwrap_or(1.0),
        kurtosis: std::array::from_fn(of_channel),
    }
}

/// By how much a walk that is larger than configured betters a recording that has none.
fn largest_walk(case: &DiagnosisCase, noise: &[NoiseModel; CHANNELS], residual: &Series) -> f64 {
    let walks = (0..TIMING).flat_map(|channel| [(channel, Walk::Angle), (channel, Walk::Rate)]);
    let fall = |(channel, walk): (usize, Walk)| {
        let fitted = crate::noise::fit(case, channel, &noise[channel], walk, residual, &case.nuisances);
        let is_larger = fitted.noise.walk(walk) > noise[channel].walk(walk);
        if is_larger { fitted.fall } else { 0.0 }
    };
    walks.map(fall).fold(0.0, f64::max)
}

/// For each family and run, the largest gain of one base.
fn of_base(
    bank: &SignatureBank,
    base: usize,
    normal: &NormalEquations,
    beside: &[Vec<f32>; CHANNELS],
) -> Vec<[f64; RUNS]> {
    let base = &bank.bases[base];
    let mut largest = vec![[0.0f64; RUNS]; HypothesisFamily::COUNT];
    let tell = |channel: usize, white: &Column| {
        let mut sums = [0.0f32; RUNS];
        for (value, runs) in white.values.iter().zip(beside[channel].chunks_exact(RUNS).skip(white.from)) {
            let value = *value as f32;
            for (sum, run) in sums.iter_mut().zip(runs) {
                *sum += value * run;
            }
        }
        sums
    };
    let take = |variation: &Variation, parts: &[Part<[f32; RUNS]>; CHANNELS]| {
        let family = &mut largest[base.family(variation).0];
        let mut take = |chosen: &[bool; CHANNELS], penalty: f64| {
            let chosen =
                || parts.iter().zip(chosen).filter(|(_, chosen)| **chosen).filter_map(|(part, _)| part.as_ref());
            let mut sums = [0.0f32; RUNS];
            for (_, own) in chosen() {
                sums.iter_mut().zip(own).for_each(|(sum, own)| *sum += own);
            }
            let Some(gain) = ProjectedSignature::gain(&chosen().map(|(part, _)| part).collect::<Vec<_>>()) else {
                return;
            };
            // The sigma is one over the root of what is left of the signature.
            let scale = gain.sigma * gain.sigma;
            for (largest, sum) in family.iter_mut().zip(sums) {
                *largest = largest.max(f64::from(sum).powi(2) * scale - penalty);
            }
        };
        for gyros in sets(&base.amplitude, parts.each_ref().map(Option::is_some)) {
            let chosen = std::array::from_fn(|channel| reaches(&base.amplitude, &gyros, channel));
            take(&chosen, set_penalty(&gyros, &base.amplitude));
        }
    };
    sweep(bank, normal, base, tell, take);
    largest
}

/// One recording with nothing hidden: what the counts differ from the model.
fn draw(case: &DiagnosisCase, model: &Series, noise: &[NoiseModel; CHANNELS], seed: u64) -> Series {
    let measured = case.measured;
    std::array::from_fn(|channel| {
        let gyro = Gyro::ALL[channel.min(3)];
        let mut stream =
            if channel == TIMING { NoiseStream::of_sensor(seed, "null") } else { NoiseStream::new(seed, gyro, "null") };
        let own = &noise[channel];
        let blocks = &measured.blocks[channel];
        if channel == TIMING {
            return blocks.iter().map(|_| own.white.sqrt() * stream.standard_normal()).collect();
        }
        let (root_s, mut rate) = (SAMPLE_INTERVAL_S.sqrt(), DRIFT_OFF_ARCSEC_S * stream.standard_normal());
        let mut walked = 100.0 * stream.standard_normal();
        // What is white beyond rounding.
        let beyond = (own.white - ROUNDING / BLOCK as f64).max(0.0).sqrt();
        let mut of_block = |block: usize| {
            let mut sum = 0.0;
            for node in nodes(block) {
                rate += own.rate_walk * root_s * stream.standard_normal();
                walked += rate * SAMPLE_INTERVAL_S + own.angle_walk * root_s * stream.standard_normal();
                let angle = model[channel][node];
                sum += (angle + walked).round() - angle;
            }
            sum / BLOCK as f64 + beyond * stream.standard_normal()
        };
        (0..blocks.len()).map(&mut of_block).collect()
    })
}

/// The thresholds of the families, from the largest gains.
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
    let of = |family: usize| match laws[family] {
        Some((at, scale)) => at + scale * reduced,
        // A family that these lists do not have, or that never gained anything.
        None => NEVER,
    };
    std::array::from_fn(of)
}

/// Location and scale of Gumbel's law, by its moments; nothing where all are alike.
fn gumbel(values: &[f64]) -> Option<(f64, f64)> {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let scale = (6.0 * variance).sqrt() / std::f64::consts::PI;
    (scale > 0.0).then_some((mean - EULER * scale, scale))
}
