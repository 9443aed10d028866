//! Whitening filter of an accumulated angle: noise becomes white, of variance 1.
//!
//! A Kalman filter of angle, drift rate, flicker and rounding error predicts each block from those before it; the innovation over its own
//! deviation is white. The filter is linear and the same for a residual and for every signature (Willsky and Jones). After a restart of the
//! sum the first block only initialises the angle.

mod covariance;
mod tails;
#[cfg(test)]
mod tests;

use std::hash::Hasher;
use std::ops::Range;
use std::sync::OnceLock;

use crate::measured::Block;
use crate::rounding::BlockRounding;

use covariance::{Covariance, OfState, RATES, SLOW, slow_decays};
pub use tails::{CoursePart, FilterState, Forms, Tail, TailProducts};

/// Noise of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseModel {
    /// Variance of a block's average in addition to rounding, such as that of the reference; times [`BlockRounding::white_scale`].
    pub white: f64,
    /// Growth of the angle's deviation with the root of time, per √s.
    pub angle_walk: f64,
    /// Growth of the rate's deviation with the root of time, per s and √s.
    pub rate_walk: f64,
    /// White noise of the scale factor, ppm·√s.
    pub scale_walk: f64,
    /// Flicker of the rate, per hour.
    pub flicker: f64,
}

/// Share of the correlation of the rounding errors of two blocks that is lost per count of the walk between them, 1 sigma: the error after a
/// turn by a part δ of a count has the correlation 1 − 6 |δ| (1 − |δ|), and the mean of |δ| is √(2/π) sigma.
const LOST_PER_COUNT: f64 = 4.8;

/// The filter at one block, written for the increments of a series, where an innovation depends on the one before by one product.
#[derive(Debug, Clone, Copy)]
struct Step {
    /// Share of the innovation that remains in the next block's.
    remainder: f64,
    /// Gains on the turn by the rate over a block, and on the rounding error of the next block.
    gains: [f64; 2],
    /// Rounding error of the next block per that of this one.
    persistence: f64,
    /// Inverse sigma of the innovation; 0 for a block without data.
    weight: f64,
}

/// The filter for one channel.
#[derive(Debug, Clone)]
pub struct Whitening {
    /// For each block.
    steps: Vec<Step>,
    /// Shares of the slow processes of the flicker that are left after a block.
    decays: [f64; SLOW],
    /// Gains of each block on the turns by the slow processes of the flicker over a block; empty without flicker.
    slow_gains: Vec<[f64; SLOW]>,
    /// Σ ln of the innovations' variances.
    pub log_determinant: f64,
    /// For courses to the end of the recording.
    forms: OnceLock<Option<Forms>>,
}

impl Whitening {
    /// The filter of this noise over these blocks of equal length with this rounding.
    pub fn new(noise: &NoiseModel, blocks: &[Block], rounding: &[BlockRounding], block_s: f64) -> Whitening {
        match noise.flicker > 0.0 {
            true => Whitening::with_rates::<RATES>(noise, blocks, rounding, block_s),
            false => Whitening::with_rates::<1>(noise, blocks, rounding, block_s),
        }
    }

    fn with_rates<const RATES: usize>(
        noise: &NoiseModel,
        blocks: &[Block],
        rounding: &[BlockRounding],
        block_s: f64,
    ) -> Whitening {
        let has_flicker = RATES > 1;
        let variance = rounding.first().map_or(0.0, |first| first.variance);
        let mut covariance = Covariance::<RATES>::new(noise, variance, block_s);
        let (mut anew, mut log_determinant) = (true, 0.0);
        let mut slow_gains = Vec::with_capacity(if has_flicker { blocks.len() } else { 0 });
        let step = |(number, block): (usize, &Block)| {
            let (own, white) = (rounding[number], noise.white * rounding[number].white_scale);
            let walk = covariance.angle_walk * own.walk_scale;
            let angle = walk + noise.scale_walk.powi(2) * own.scale_walk + own.reference_walk;
            anew |= block.restarts;
            if block.begins_trial {
                covariance.free_drift(angle + white);
            }
            let average = covariance.advance(angle, white);
            let (mut gains, mut weight) = (OfState::default(), 0.0);
            if block.is_compared && std::mem::take(&mut anew) {
                gains = covariance.restart(angle, white);
            } else if block.is_compared {
                gains = covariance.correct(&average);
                log_determinant += average.variance.ln();
                weight = 1.0 / average.variance.sqrt();
            }
            // The phase of the accumulated angle after a break is another one.
            let next = match (rounding.get(number + 1), blocks.get(number + 1)) {
                (Some(next), Some(block)) if block.restarts => BlockRounding { correlation: 0.0, ..*next },
                (Some(next), _) => *next,
                (None, _) => BlockRounding::NONE,
            };
            let correlation = next.correlation * (1.0 - LOST_PER_COUNT * angle.sqrt()).max(0.0);
            let persistence =
                if own.variance > 0.0 { correlation * (next.variance / own.variance).sqrt() } else { 0.0 };
            covariance.next_error(persistence, next.variance * (1.0 - correlation * correlation));
            gains.error *= persistence;
            let remainder = 1.0 - gains.angle - covariance.turn_to_mean(&gains) - gains.error;
            let (turn, slow) = covariance.turns(&gains);
            slow_gains.extend(has_flicker.then_some(slow));
            Step { remainder, gains: [turn, gains.error], persistence, weight }
        };
        let steps = blocks.iter().enumerate().map(step).collect();
        Whitening { steps, decays: slow_decays(block_s), slow_gains, log_determinant, forms: OnceLock::new() }
    }

    /// Innovations of a series, each over its deviation.
    pub fn apply(&self, series: &[f64]) -> Vec<f64> {
        self.apply_from(0, series)
    }

    /// Whitens a series that is 0 before the block `from`; `series` contains the blocks from there on.
    pub fn apply_from(&self, from: usize, series: &[f64]) -> Vec<f64> {
        let [white] = Whitening::apply_each([self], from, [series]);
        white
    }

    /// Whitens several series of equal length.
    pub fn apply_all(&self, series: &[&[f64]]) -> Vec<Vec<f64>> {
        const AT_ONCE: usize = 4;
        let some = |own: &[&[f64]]| {
            let all: [_; AT_ONCE] = std::array::from_fn(|place| own[place.min(own.len() - 1)]);
            Whitening::apply_each([self; AT_ONCE], 0, all).into_iter().take(own.len())
        };
        series.chunks(AT_ONCE).flat_map(some).collect()
    }

    /// Whitens each series by its own filter. An innovation waits for the one before, so that several take as long as one.
    pub fn apply_each<const COUNT: usize>(
        filters: [&Whitening; COUNT],
        from: usize,
        series: [&[f64]; COUNT],
    ) -> [Vec<f64>; COUNT] {
        let steps = filters.map(|own| own.steps.get(from..).unwrap_or_default());
        let blocks = std::iter::zip(steps, series).map(|(own, series)| series.len().min(own.len())).min().unwrap_or(0);
        let slow_gains = filters.map(|own| own.slow_gains.get(from..).unwrap_or_default());
        let decays = filters.map(|own| own.decays);
        // What the innovation before leaves in this one, the turn by the rate, and the rounding error.
        let [mut left, mut turn, mut error, mut before, mut predicted] = [[0.0; COUNT]; 5];
        let mut slow_turns = [[0.0; SLOW]; COUNT];
        let mut white = series.map(|_| vec![0.0; blocks]);
        for block in 0..blocks {
            for (own, white) in white.iter_mut().enumerate() {
                let (step, measured) = (&steps[own][block], series[own][block]);
                let innovation = (measured - before[own] - predicted[own]) + left[own];
                before[own] = measured;
                left[own] = step.remainder * innovation;
                predicted[own] = turn[own] + (step.persistence - 1.0) * error[own];
                turn[own] += step.gains[0] * innovation;
                error[own] = step.persistence * error[own] + step.gains[1] * innovation;
                if let Some(gains) = slow_gains[own].get(block) {
                    for ((turn, decay), gain) in slow_turns[own].iter_mut().zip(decays[own]).zip(gains) {
                        predicted[own] += *turn;
                        *turn = decay * *turn + gain * innovation;
                    }
                }
                white[block] = innovation * step.weight;
            }
        }
        white
    }

    /// Whitens several series at once, given by their increments in each of these blocks, and passes the innovations of each block to `push`.
    pub fn pass<const LANES: usize>(
        &self,
        blocks: Range<usize>,
        increments: impl FnMut(usize) -> [f64; LANES],
        push: impl FnMut(usize, [f64; LANES]),
    ) {
        match self.slow_gains.is_empty() {
            true => self.pass_with::<LANES, 0>(blocks, increments, push),
            false => self.pass_with::<LANES, SLOW>(blocks, increments, push),
        }
    }

    fn pass_with<const LANES: usize, const FLICKER: usize>(
        &self,
        blocks: Range<usize>,
        mut increments: impl FnMut(usize) -> [f64; LANES],
        mut push: impl FnMut(usize, [f64; LANES]),
    ) {
        // What the innovation before leaves in this one, less what is predicted; the turn by the rate, and the rounding error.
        let [mut left, mut turn, mut error] = [[0.0; LANES]; 3];
        let (mut slow_turns, decays) = ([[0.0; LANES]; FLICKER], self.decays);
        for block in blocks {
            // One operation on all lanes after the other: the compiler makes vectors of them.
            let (step, increments) = (&self.steps[block], increments(block));
            let innovation: [f64; LANES] = std::array::from_fn(|lane| increments[lane] + left[lane]);
            left = std::array::from_fn(|lane| {
                step.remainder * innovation[lane] - (turn[lane] + (step.persistence - 1.0) * error[lane])
            });
            turn = std::array::from_fn(|lane| turn[lane] + step.gains[0] * innovation[lane]);
            error = std::array::from_fn(|lane| step.persistence * error[lane] + step.gains[1] * innovation[lane]);
            for slow in 0..FLICKER {
                let (decay, gain) = (decays[slow], self.slow_gains[block][slow]);
                left = std::array::from_fn(|lane| left[lane] - slow_turns[slow][lane]);
                slow_turns[slow] = std::array::from_fn(|lane| decay * slow_turns[slow][lane] + gain * innovation[lane]);
            }
            let white = innovation.map(|innovation| innovation * step.weight);
            push(block, white);
        }
    }

    /// Derivatives of the product of `white` with a whitened series by the increments of that series.
    pub fn transposed(&self, white: &[f64]) -> Vec<f64> {
        let mut derivatives = vec![0.0; white.len()];
        let (mut innovation, mut turn, mut error) = (0.0, 0.0, 0.0);
        let (mut slow_turns, decays) = ([0.0; SLOW], self.decays);
        for (block, (white, derivative)) in white.iter().zip(&mut derivatives).enumerate().rev() {
            let (step, later) = (&self.steps[block], innovation);
            innovation = step.weight * white + step.remainder * later + step.gains[0] * turn + step.gains[1] * error;
            if let Some(gains) = self.slow_gains.get(block) {
                for ((turn, decay), gain) in slow_turns.iter_mut().zip(decays).zip(gains) {
                    innovation += gain * *turn;
                    *turn = decay * *turn - later;
                }
            }
            turn -= later;
            error = step.persistence * error - (step.persistence - 1.0) * later;
            *derivative = innovation;
        }
        derivatives
    }

    /// Adds its numbers to a hash.
    pub fn add_to_hash(&self, hasher: &mut impl Hasher) {
        for Step { remainder, gains, persistence, weight } in &self.steps {
            for number in [remainder, &gains[0], &gains[1], persistence, weight] {
                hasher.write_u64(number.to_bits());
            }
        }
        self.slow_gains.iter().flatten().for_each(|number| hasher.write_u64(number.to_bits()));
    }
}
