//! The noise of the channels: what is configured, what is white on top of it, and whether the data speak of more.

use geu_model::Configuration;
use nalgebra::{DMatrix, DVector};

use crate::measured::{BLOCK, Block, CHANNELS, MeasuredData, Series, TIMING};
use crate::normal::{Nuisance, RIDGE, dot, factored, lower};
use crate::state::DiagnosisCase;
use crate::whitening::{NoiseModel, ROUNDING, Whitening};

/// Median of the absolute value of a normal variable.
const MEDIAN_OF_NORMAL: f64 = 0.674_489_750_196_081_7;
/// Steps of a fit at most: walk and white noise in turn, or white noise alone as far as it moves.
const TURNS: usize = 12;
/// How far a logarithm of a white noise is looked for at once.
const NEAR_WHITE: f64 = 1.0;
/// A logarithm that moves by less stays.
const STAYS: f64 = 0.02;
/// Blocks in which the white noise is told on its own.
const STRETCH: usize = 120;
/// Least white noise of an average of ten roundings, as a share of that of ten independent ones.
const LEAST_WHITE: f64 = 0.5;
/// Least white noise of the times, 1 µs in units of the channel.
const LEAST_TIMING: f64 = 0.01;

/// A random walk that may be larger than configured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Walk {
    /// Of the angle.
    Angle,
    /// Of the rate.
    Rate,
}

impl NoiseModel {
    /// A walk's growth.
    pub fn walk(&self, walk: Walk) -> f64 {
        match walk {
            Walk::Angle => self.angle_walk,
            Walk::Rate => self.rate_walk,
        }
    }

    /// The same with another walk.
    #[must_use]
    pub fn with(mut self, walk: Walk, value: f64) -> NoiseModel {
        match walk {
            Walk::Angle => self.angle_walk = value,
            Walk::Rate => self.rate_walk = value,
        }
        self
    }
}

/// The configured walks with the white noise that the residual shows: rounding and the reference.
///
/// Its variance comes from second differences of neighbouring blocks, by their median, which no missing effect moves.
pub fn of(configuration: &Configuration, measured: &MeasuredData, residual: &Series) -> [NoiseModel; CHANNELS] {
    std::array::from_fn(|channel| {
        let seconds = second_differences(&residual[channel], &measured.blocks[channel]);
        if channel == TIMING {
            let white = (seconds.max(0.0) / 6.0).max(least_white(channel));
            return NoiseModel { white, angle_walk: 0.0, rate_walk: 0.0 };
        }
        let effects = &configuration.gyros[channel].effects.constant;
        let angle_walk = effects.angle_random_walk.arcsec_per_sqrt_s;
        let rate_walk = effects.drift_random_walk.arcsec_per_s_per_sqrt_s;
        // A walk's second difference has two steps of it, each the average over a ramp: 2/3 of a whole one together with its
        // neighbour's −1/6; 1 in all.
        let walk = angle_walk.powi(2) * crate::measured::BLOCK_S;
        let white = ((seconds - walk) / 6.0).max(least_white(channel));
        NoiseModel { white, angle_walk, rate_walk }
    })
}

/// White noise that every channel has.
fn least_white(channel: usize) -> f64 {
    if channel == TIMING { LEAST_TIMING.powi(2) } else { LEAST_WHITE * ROUNDING / BLOCK as f64 }
}

/// Variance of second differences: by the median of their absolute values in each stretch of ten minutes, the average of the middle
/// stretches; rounding while the unit rests is not that of a scan. 0 where there are none.
fn second_differences(series: &[f64], blocks: &[Block]) -> f64 {
    let good = |window: &[Block]| window.iter().all(|block| block.is_good && !block.restarts);
    let of_stretch = |(values, blocks): (&[f64], &[Block])| {
        let triples = values.windows(3).zip(blocks.windows(3)).filter(|(_, blocks)| good(blocks));
        let mut sizes: Vec<f64> = triples.map(|(values, _)| (values[0] - 2.0 * values[1] + values[2]).abs()).collect();
        let middle = sizes.len() / 2;
        (sizes.len() >= STRETCH / 2)
            .then(|| (*sizes.select_nth_unstable_by(middle, f64::total_cmp).1 / MEDIAN_OF_NORMAL).powi(2))
    };
    let mut variances: Vec<f64> = series.chunks(STRETCH).zip(blocks.chunks(STRETCH)).filter_map(of_stretch).collect();
    variances.sort_by(f64::total_cmp);
    let cut = variances.len() / 10;
    let middle = &variances[cut..variances.len() - cut];
    if middle.is_empty() { 0.0 } else { middle.iter().sum::<f64>() / middle.len() as f64 }
}

/// Factors at which a walk is tried before it is fitted.
const HOPES: [f64; 2] = [1.5, 3.0];

/// A walk fitted: its growth, one sigma of the growth's logarithm, and by how much −2 ln of the likelihood falls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedNoise {
    /// The noise with it.
    pub noise: NoiseModel,
    /// Of the natural logarithm of the growth.
    pub log_sigma: f64,
    /// Against the noise before.
    pub fall: f64,
}

/// −2 ln of the likelihood of one channel for any noise of it, beside the nuisances, as [`crate::normal::Normal::deviance`] tells that of all.
fn deviance<'a>(
    case: &'a DiagnosisCase,
    channel: usize,
    residual: &'a Series,
    nuisances: &'a [Nuisance],
) -> impl Fn(&NoiseModel) -> f64 + use<'a> {
    let own: Vec<&[f64]> = nuisances.iter().filter_map(|column| column[channel].as_deref()).collect();
    move |noise: &NoiseModel| {
        let whitening = Whitening::new(noise, &case.measured.blocks[channel]);
        let white = whitening.apply(&residual[channel]);
        let columns: Vec<Vec<f64>> = own.iter().map(|column| whitening.apply(column)).collect();
        let gram =
            DMatrix::from_fn(
                columns.len(),
                columns.len(),
                |i, j| {
                    if j <= i { dot(&columns[i], &columns[j]) } else { 0.0 }
                },
            );
        let gram = DMatrix::from_fn(columns.len(), columns.len(), |i, j| gram[(i.max(j), i.min(j))]);
        let scale = gram.diagonal().map(|own| if own > 0.0 { own.sqrt().recip() } else { 0.0 });
        let factor = factored(&gram, &scale, RIDGE);
        let right = DVector::from_iterator(columns.len(), columns.iter().map(|column| dot(column, &white)));
        let solved = lower(&factor, &scale.component_mul(&right));
        let told = (0..columns.len()).filter(|&index| scale[index] > 0.0);
        let logs = told.map(|index| 2.0 * (factor.l_dirty()[(index, index)] / scale[index]).ln());
        dot(&white, &white) - solved.norm_squared() + whitening.log_determinant + logs.sum::<f64>()
    }
}

/// Fits the white noise of one channel.
pub fn fit_white(
    case: &DiagnosisCase,
    channel: usize,
    noise: &NoiseModel,
    residual: &Series,
    nuisances: &[Nuisance],
) -> NoiseModel {
    if !case.measured.blocks[channel].iter().any(|block| block.is_good) {
        return *noise;
    }
    let deviance = deviance(case, channel, residual, nuisances);
    let with = |log_white: f64| NoiseModel { white: log_white.exp(), ..*noise };
    let mut log_white = noise.white.ln();
    for _ in 0..TURNS {
        let before = log_white;
        log_white = likeliest_white(channel, log_white, |log_white| deviance(&with(log_white)));
        if (log_white - before).abs() < NEAR_WHITE / 2.0 {
            break;
        }
    }
    with(log_white)
}

/// The logarithm of the white noise near by with which a channel is likeliest.
fn likeliest_white(channel: usize, log_white: f64, deviance: impl Fn(f64) -> f64) -> f64 {
    least(log_white - NEAR_WHITE, log_white + NEAR_WHITE, deviance).max(least_white(channel).ln())
}

/// Fits one walk of one channel, and the white noise with it; one that is no larger than it was taken stays as it is.
pub fn fit(
    case: &DiagnosisCase,
    channel: usize,
    noise: &NoiseModel,
    walk: Walk,
    residual: &Series,
    nuisances: &[Nuisance],
) -> FittedNoise {
    let deviance = deviance(case, channel, residual, nuisances);
    let start = match (noise.walk(walk), walk) {
        (configured, _) if configured > 0.0 => configured.ln(),
        (_, Walk::Angle) => (noise.white.sqrt() * 1e-2).ln(),
        (_, Walk::Rate) => (noise.white.sqrt() * 1e-5).ln(),
    };
    let with =
        |log_walk: f64, log_white: f64| NoiseModel { white: log_white.exp(), ..noise.with(walk, log_walk.exp()) };
    // What is no more likely half as large again, nor three times as large, is not larger.
    let now = deviance(noise);
    if HOPES.iter().all(|factor| deviance(&with(start + factor.ln(), noise.white.ln())) >= now) {
        return FittedNoise { noise: *noise, log_sigma: f64::NAN, fall: 0.0 };
    }
    // Each in turn, until they stay: over all there is at first, then near by.
    let (mut log_walk, mut log_white) = (start, noise.white.ln());
    let (mut below, mut above) = (4.0, 7.0);
    for _ in 0..TURNS {
        let before = log_walk;
        log_walk = least(log_walk - below, log_walk + above, |log_walk| deviance(&with(log_walk, log_white)));
        log_white = likeliest_white(channel, log_white, |log_white| deviance(&with(log_walk, log_white)));
        (below, above) = (0.5, 0.5);
        if (log_walk - before).abs() < STAYS {
            break;
        }
    }
    // Both sides with the white noise that suits them.
    let before = deviance(&fit_white(case, channel, noise, residual, nuisances));
    let best = deviance(&with(log_walk, log_white));
    let aside = 0.1;
    let bend = deviance(&with(log_walk + aside, log_white)) + deviance(&with(log_walk - aside, log_white)) - 2.0 * best;
    let log_sigma = (2.0 * aside * aside / bend.max(1e-9)).sqrt();
    FittedNoise { noise: with(log_walk, log_white), log_sigma, fall: before - best }
}

/// Where a function of one number is least, by a grid and the golden section.
fn least(from: f64, to: f64, of: impl Fn(f64) -> f64) -> f64 {
    const GRID: usize = 8;
    let at = |index: usize| from + (to - from) * index as f64 / GRID as f64;
    let values: Vec<f64> = (0..=GRID).map(|index| of(at(index))).collect();
    let best = (0..=GRID).min_by(|a, b| values[*a].total_cmp(&values[*b])).unwrap_or(0);
    let (mut low, mut high) = (at(best.saturating_sub(1)), at((best + 1).min(GRID)));
    let ratio = 0.618_033_988_749_894_9;
    let (mut left, mut right) = (high - ratio * (high - low), low + ratio * (high - low));
    let (mut at_left, mut at_right) = (of(left), of(right));
    while high - low > 0.01 {
        if at_left < at_right {
            (high, right, at_right) = (right, left, at_left);
            left = high - ratio * (high - low);
            at_left = of(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = low + ratio * (high - low);
            at_right = of(right);
        }
    }
    0.5 * (low + high)
}
