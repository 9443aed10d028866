//! The noise of the channels: configured random walks, estimated white noise, and fits of walks above the configured ones.

mod differences;
mod minimum;
mod uneven;
mod walk_fits;

use geu_checks::median;
use std::borrow::Cow;

use geu_model::Configuration;
use geu_model::effect::GyroEffects;
use geu_model::units::S_PER_H;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::diagnosis_case::DiagnosisCase;
use crate::linear_algebra::{dot, factored, inverse_roots, lower};
use crate::measured::{BLOCK, Block, CHANNELS, MeasuredData, Series};
use crate::normal_equations::{Nuisance, RIDGE, THIRDS};
use crate::rounding::{BlockRounding, Rounding};
use crate::significance::MEDIAN_OF_NORMAL;
use crate::whitening::{NoiseModel, Whitening};
use minimum::{lowest, minimise};
pub use uneven::scales;
pub use walk_fits::{FittedNoise, WalkFits};

/// Maximum number of iterations of a fit of walk and white noise.
const ITERATIONS: usize = 12;
/// Search range of the logarithm of a white noise in one iteration.
const WHITE_RANGE: f64 = 1.0;
/// Blocks in which the white noise is estimated separately, ten minutes.
const WINDOW: usize = 120;
/// Minimum white noise in addition to rounding, counts²: a tenth of ten independent roundings, since the model's rate is not exact.
const MIN_WHITE: f64 = 0.1 / 12.0 / BLOCK as f64;
/// Minimum white noise of angles that are not rounded, arcsec².
const MIN_EXACT: f64 = 1e-8;
/// Minimum white noise of the times, 1 µs in units of the channel.
const MIN_TIMING: f64 = 0.01;
/// Search range of the logarithm of a third's own walk.
const OWN_RANGE: f64 = 3.0;
/// Growths on the grid of null recordings, and the difference of their logarithms: about 1 sigma of a walk at its threshold.
const GROWTHS: i32 = 14;
const GROWTH_STEP: f64 = 0.5;
/// Difference of the logarithms of white noises on that grid.
const WHITE_STEP: f64 = 0.1;

/// A random walk or flicker that may be larger than configured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Walk {
    /// Angle random walk.
    Angle,
    /// Rate random walk.
    Rate,
    /// Angle random walk in proportion to the rate: white noise of the scale factor.
    Scale,
    /// Flicker of the rate.
    Flicker,
}

impl Walk {
    /// Each.
    pub const ALL: [Walk; 4] = [Walk::Angle, Walk::Rate, Walk::Scale, Walk::Flicker];

    /// Growth among the effects of a gyro.
    pub fn growth(self, effects: &GyroEffects) -> f64 {
        match self {
            Walk::Angle => effects.angle_random_walk.arcsec_per_sqrt_s,
            Walk::Rate => effects.drift_random_walk.arcsec_per_s_per_sqrt_s,
            Walk::Scale => effects.scale_factor_noise.ppm_sqrt_s,
            Walk::Flicker => effects.bias_instability.arcsec_per_h,
        }
    }
}

impl NoiseModel {
    /// Growth of a walk.
    pub fn walk(&self, walk: Walk) -> f64 {
        match walk {
            Walk::Angle => self.angle_walk,
            Walk::Rate => self.rate_walk,
            Walk::Scale => self.scale_walk,
            Walk::Flicker => self.flicker,
        }
    }

    /// Returns the noise with another growth of a walk.
    #[must_use]
    pub fn with(mut self, walk: Walk, value: f64) -> NoiseModel {
        match walk {
            Walk::Angle => self.angle_walk = value,
            Walk::Rate => self.rate_walk = value,
            Walk::Scale => self.scale_walk = value,
            Walk::Flicker => self.flicker = value,
        }
        self
    }
}

/// The configured walks, and the white noise of the residual in addition to rounding: that of the reference.
///
/// The variance is that of second differences of neighbouring blocks, estimated by their median, which no missing effect changes.
pub fn configured(
    configuration: &Configuration,
    measured: &MeasuredData,
    rounding: &Rounding,
    residual: &Series,
) -> [NoiseModel; CHANNELS] {
    let block_s = measured.block_s();
    let mut noise = std::array::from_fn(|channel| {
        let effects = configuration.gyros.get(channel).map(|gyro| &gyro.effects.constant);
        let growths = Walk::ALL.map(|walk| effects.map_or(0.0, |own| walk.growth(own)));
        if effects.is_some() && !is_declared(configuration, channel) {
            let blocks = &measured.blocks[channel];
            let (white, angle_walk) = differences::noise(&residual[channel], blocks, &rounding[channel], block_s);
            let angle_walk = angle_walk.hypot(measured.counts.rounding_walk[channel]);
            let white = white.max(min_white(measured, channel));
            return NoiseModel { white, angle_walk, rate_walk: 0.0, scale_walk: 0.0, flicker: 0.0 };
        }
        let [angle_walk, rate_walk, scale_walk, flicker] = growths;
        let variance =
            second_differences(&residual[channel], &measured.blocks[channel], &rounding[channel], scale_walk);
        // The second difference of a walk contains two of its steps, each averaged over a ramp: 2/3 of a whole step, and −1/6 with its
        // neighbour; 1 in all.
        let white = (variance - angle_walk.powi(2) * block_s) / 6.0;
        let is_dequantised = measured.weights.get(channel).is_some_and(Option::is_some);
        let min = if is_dequantised { 0.0 } else { min_white(measured, channel) };
        NoiseModel { white: white.max(min), angle_walk, rate_walk, scale_walk, flicker }
    });
    let estimated = measured.gyros().filter(|gyro| measured.is_usable(gyro) && !is_declared(configuration, gyro));
    let whites = estimated.gyros().map(|gyro| (gyro.index(), min_white(measured, gyro.index())));
    differences::share_white(&mut noise, &whites.collect::<Vec<_>>());
    noise
}

/// True if the noise of a gyro is that of its configuration; else that of the residual.
pub fn is_declared(configuration: &Configuration, gyro: usize) -> bool {
    let Some(own) = configuration.gyros.get(gyro) else { return true };
    configuration.device.is_iras() || Walk::ALL.iter().any(|walk| walk.growth(&own.effects.constant) > 0.0)
}

/// Minimum white noise of a channel.
fn min_white(measured: &MeasuredData, channel: usize) -> f64 {
    let count = measured.counts.rounded_to.get(channel);
    count.map_or(MIN_TIMING.powi(2), |count| (MIN_WHITE * count * count).max(MIN_EXACT))
}

/// Variance of second differences without that of rounding and of a noisy scale factor, of blocks with a white noise of scale 1: from the
/// median of their absolute values in each window, averaged over the windows except the extreme tenths. 0 without data.
fn second_differences(series: &[f64], blocks: &[Block], rounding: &[BlockRounding], scale_walk: f64) -> f64 {
    let of_window = |((values, blocks), rounding): ((&[f64], &[Block]), &[BlockRounding])| {
        let compared: Vec<usize> = (0..blocks.len()).filter(|&block| blocks[block].is_compared).collect();
        // A slow reference has no rows in some blocks: evenly spaced neighbours without a break between them.
        let is_even =
            |at: &&[usize]| at[1] - at[0] == at[2] - at[1] && !blocks[at[0]..=at[2]].iter().any(|block| block.restarts);
        let (mut sizes, mut roundings): (Vec<f64>, Vec<f64>) = compared
            .windows(3)
            .filter(is_even)
            .map(|at| {
                let [first, middle, last] = [at[0], at[1], at[2]];
                let rounded = match last - first {
                    2 => rounding[last].second_difference,
                    _ => rounding[first].variance + 4.0 * rounding[middle].variance + rounding[last].variance,
                };
                let scale = scale_walk.powi(2) * rounding[middle].scale_walk;
                let white = [first, middle, last].map(|block| rounding[block].white_scale);
                let white = (white[0] + 4.0 * white[1] + white[2]) / 6.0;
                ((values[first] - 2.0 * values[middle] + values[last]).abs() / white.sqrt(), (rounded + scale) / white)
            })
            .unzip();
        let rounded = median(&mut roundings);
        let is_enough = 2 * sizes.len() >= compared.len() && compared.len() >= WINDOW / 8;
        is_enough.then(|| (median(&mut sizes) / MEDIAN_OF_NORMAL).powi(2) - rounded)
    };
    let windows = series.chunks(WINDOW).zip(blocks.chunks(WINDOW)).zip(rounding.chunks(WINDOW));
    let mut variances: Vec<f64> = windows.filter_map(of_window).collect();
    variances.sort_by(f64::total_cmp);
    let cut = variances.len() / 10;
    let middle = &variances[cut..variances.len() - cut];
    if middle.is_empty() { 0.0 } else { middle.iter().sum::<f64>() / middle.len() as f64 }
}

/// Nuisances of one channel, whitened by one noise.
struct WhiteNuisances {
    whitening: Whitening,
    columns: Vec<Vec<f64>>,
    factor: Cholesky<f64, Dyn>,
    scale: DVector<f64>,
    /// Sum for the noise and for the determined nuisances.
    log_determinant: f64,
}

impl WhiteNuisances {
    fn new(case: &DiagnosisCase, channel: usize, blocks: &[Block], nuisances: &[Nuisance], noise: &NoiseModel) -> Self {
        let whitening = Whitening::new(noise, blocks, &case.rounding[channel], case.measured.block_s());
        let places = || (0..nuisances.len()).filter(|&place| nuisances[place][channel].is_some());
        let own: Vec<&[f64]> = nuisances.iter().filter_map(|column| column[channel].as_deref()).collect();
        let columns = whitening.apply_all(&own);
        let mut gram = DMatrix::zeros(columns.len(), columns.len());
        for (i, one) in columns.iter().enumerate() {
            columns[..=i].iter().enumerate().for_each(|(j, other)| gram[(i, j)] = dot(one, other));
        }
        gram.fill_upper_triangle_with_lower_triangle();
        let scale = inverse_roots(&gram.diagonal());
        // Centred on the state's own values. Without it, parameters that the motion does not determine would explain a walk.
        let a_priori = case.a_priori(&[]);
        for (own, place) in places().enumerate() {
            gram[(own, own)] += a_priori.get(place).map_or(0.0, |(_, sigma)| sigma.powi(-2));
        }
        let factor = factored(&gram, &scale, RIDGE);
        let determined = (0..columns.len()).filter(|&index| scale[index] > 0.0);
        let logs = determined.map(|index| 2.0 * (factor.l_dirty()[(index, index)] / scale[index]).ln());
        let log_determinant = whitening.log_determinant + logs.sum::<f64>();
        WhiteNuisances { whitening, columns, factor, scale, log_determinant }
    }

    /// −2 ln of the likelihood of the channel's residual with the nuisances integrated out; the part of one channel in
    /// [`crate::normal_equations::NormalEquations::deviance`].
    fn deviance(&self, residual: &[f64]) -> f64 {
        self.deviance_of_white(&self.whitening.apply(residual))
    }

    fn deviance_of_white(&self, white: &[f64]) -> f64 {
        let right = DVector::from_iterator(self.columns.len(), self.columns.iter().map(|column| dot(column, white)));
        let solved = lower(&self.factor, &self.scale.component_mul(&right));
        dot(white, white) - solved.norm_squared() + self.log_determinant
    }
}

/// −2 ln of the likelihood of one channel as a function of its noise.
pub fn deviance<'a>(
    case: &'a DiagnosisCase,
    channel: usize,
    blocks: Cow<'a, [Block]>,
    residual: &'a Series,
    nuisances: &'a [Nuisance],
) -> impl Fn(&NoiseModel) -> f64 + use<'a> {
    move |noise: &NoiseModel| WhiteNuisances::new(case, channel, &blocks, nuisances, noise).deviance(&residual[channel])
}

/// By how much −2 ln of the likelihood falls with a larger walk in each of several residuals of one channel: on a grid of growths, each with
/// its own white noise.
pub fn falls(
    case: &DiagnosisCase,
    channel: usize,
    noise: &NoiseModel,
    walk: Walk,
    residuals: &[Series],
    nuisances: &[Nuisance],
) -> Vec<f64> {
    let Some(start) = start(case, channel, noise, walk) else { return vec![0.0; residuals.len()] };
    let blocks = &case.measured.blocks[channel];
    let min = min_white(case.measured, channel);
    let own_residuals: Vec<&[f64]> = residuals.iter().map(|residual| &residual[channel][..]).collect();
    let at = |noise: &NoiseModel| -> Vec<f64> {
        let of_white = |factor: i32| {
            let white = (noise.white * (WHITE_STEP * f64::from(factor)).exp()).max(min);
            let own = WhiteNuisances::new(case, channel, blocks, nuisances, &NoiseModel { white, ..*noise });
            let white = own.whitening.apply_all(&own_residuals);
            white.iter().map(|white| own.deviance_of_white(white)).collect::<Vec<f64>>()
        };
        let [below, middle, above] = [-1, 0, 1].map(of_white);
        (0..residuals.len()).map(|run| lowest(below[run], middle[run], above[run])).collect()
    };
    let before = at(noise);
    let mut largest = vec![0.0; residuals.len()];
    for step in 1..=GROWTHS {
        let with = at(&noise.with(walk, (start + GROWTH_STEP * f64::from(step)).exp()));
        for ((largest, before), with) in largest.iter_mut().zip(&before).zip(with) {
            *largest = f64::max(*largest, before - with);
        }
    }
    largest
}

/// Fits the white noise of one channel.
pub fn fit_white(
    case: &DiagnosisCase,
    channel: usize,
    noise: &NoiseModel,
    residual: &Series,
    nuisances: &[Nuisance],
) -> NoiseModel {
    if !case.measured.is_usable(channel) {
        return *noise;
    }
    let deviance = deviance(case, channel, Cow::Borrowed(&case.measured.blocks[channel]), residual, nuisances);
    let with = |log_white: f64| NoiseModel { white: log_white.exp(), ..*noise };
    let mut log_white = noise.white.ln();
    for _ in 0..ITERATIONS {
        let before = log_white;
        log_white = likeliest_white(case, channel, log_white, |log_white| deviance(&with(log_white)));
        if (log_white - before).abs() < WHITE_RANGE / 2.0 {
            break;
        }
    }
    with(log_white)
}

/// Logarithm of the likeliest white noise of a channel within [`WHITE_RANGE`].
fn likeliest_white(case: &DiagnosisCase, channel: usize, log_white: f64, deviance: impl Fn(f64) -> f64) -> f64 {
    minimise(log_white - WHITE_RANGE, log_white + WHITE_RANGE, deviance).max(min_white(case.measured, channel).ln())
}

/// Logarithm of the growth from which a walk is fitted; `None` for noise of the scale factor of a gyro that does not turn.
fn start(case: &DiagnosisCase, channel: usize, noise: &NoiseModel, walk: Walk) -> Option<f64> {
    let white = noise.white.sqrt();
    let growth = match (noise.walk(walk), walk) {
        (configured, _) if configured > 0.0 => configured,
        (_, Walk::Angle) => white * 1e-2,
        (_, Walk::Rate) => white * 1e-5,
        // As large a rate as that of the rate random walk after a thousand seconds.
        (_, Walk::Flicker) => white * 1e-5 * 1000f64.sqrt() * S_PER_H,
        (_, Walk::Scale) => {
            // As large an angle as that of the angle random walk over the whole recording.
            let blocks = &case.rounding[channel];
            let of_unit: f64 = blocks.iter().map(|block| block.scale_walk).sum();
            white * 1e-2 * (blocks.len() as f64 * case.measured.block_s() / of_unit).sqrt()
        }
    };
    growth.is_finite().then(|| growth.ln())
}

/// By how much −2 ln of the likelihood falls if each third of the recording has a walk of its own; χ² of two degrees of freedom for a walk
/// of constant growth.
pub fn change_chi2(
    case: &DiagnosisCase,
    channel: usize,
    noise: &NoiseModel,
    walk: Walk,
    residual: &Series,
    nuisances: &[Nuisance],
) -> f64 {
    let all = &case.measured.blocks[channel];
    let of_third = |third: usize| {
        let own = all.len() * third / THIRDS..all.len() * (third + 1) / THIRDS;
        let block = |(number, block): (usize, &Block)| Block {
            is_compared: block.is_compared && own.contains(&number),
            restarts: block.restarts || number == own.start,
            ..*block
        };
        let blocks: Vec<Block> = all.iter().enumerate().map(block).collect();
        let deviance = deviance(case, channel, Cow::Owned(blocks), residual, nuisances);
        let with = |log_walk: f64| deviance(&noise.with(walk, log_walk.exp()));
        let common = noise.walk(walk).ln();
        with(common) - with(minimise(common - OWN_RANGE, common + OWN_RANGE, with))
    };
    (0..THIRDS).map(of_third).sum()
}
