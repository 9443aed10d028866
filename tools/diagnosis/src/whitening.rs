//! Whitening filter of an accumulated angle: noise becomes white, of variance 1.
//!
//! A Kalman filter of angle, drift rate, flicker and rounding error predicts each block from those before it; the innovation over its own
//! deviation is white. The filter is linear and the same for a residual and for every signature (Willsky and Jones). After a restart of the
//! sum the first block only initialises the angle.

mod covariance;
mod tails;

use std::hash::Hasher;
use std::ops::Range;
use std::sync::OnceLock;

use crate::measured::Block;
use crate::rounding::BlockRounding;

use covariance::{Covariance, OfState, SLOW, slow_decays};
pub use tails::{Forms, Tail, TailProducts};

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
        let mut covariance = Covariance::new(noise, rounding.first().map_or(0.0, |first| first.variance), block_s);
        let (mut anew, mut log_determinant) = (true, 0.0);
        let mut slow_gains = Vec::with_capacity(if covariance.has_flicker() { blocks.len() } else { 0 });
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
            slow_gains.extend(covariance.has_flicker().then_some(slow));
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
            let (step, increments) = (&self.steps[block], increments(block));
            let mut white = [0.0; LANES];
            for lane in 0..LANES {
                let innovation = increments[lane] + left[lane];
                left[lane] = step.remainder * innovation - (turn[lane] + (step.persistence - 1.0) * error[lane]);
                turn[lane] += step.gains[0] * innovation;
                error[lane] = step.persistence * error[lane] + step.gains[1] * innovation;
                for slow in 0..FLICKER {
                    let turn = &mut slow_turns[slow][lane];
                    left[lane] -= *turn;
                    *turn = decays[slow] * *turn + self.slow_gains[block][slow] * innovation;
                }
                white[lane] = innovation * step.weight;
            }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measured::BLOCK;
    use geu_model::noise::{Flicker, NoiseStream};
    use geu_model::units::S_PER_H;

    const BLOCK_S: f64 = 5.0;

    /// Draws that need no generator: a quadratic residue sequence, of variance 1/12 about 0.
    fn draw(state: &mut u64) -> f64 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    }

    #[test]
    fn transposed_filter_gives_the_product_with_a_whitened_series() {
        let noise = NoiseModel { white: 1.0 / 120.0, angle_walk: 0.01, rate_walk: 8e-6, scale_walk: 0.0, flicker: 5.0 };
        let mut blocks = vec![Block { is_good: true, is_compared: true, restarts: false, begins_trial: false }; 300];
        blocks[90] = Block { is_good: false, is_compared: false, restarts: true, begins_trial: false };
        let rounding =
            BlockRounding { variance: 0.05, correlation: 0.7, second_difference: 0.1, ..BlockRounding::NONE };
        let whitening = Whitening::new(&noise, &blocks, &vec![rounding; blocks.len()], BLOCK_S);
        let mut state = 3;
        let [series, other]: [Vec<f64>; 2] = std::array::from_fn(|_| (0..300).map(|_| draw(&mut state)).collect());
        for from in [0, 40] {
            let white = whitening.apply_from(from, &series[from..]);
            let product: f64 = white.iter().zip(&other[from..]).map(|(one, other)| one * other).sum();
            let derivatives = whitening.transposed(&other);
            let increments = series[from..].windows(2).map(|pair| pair[1] - pair[0]);
            let increments = std::iter::once(series[from]).chain(increments);
            let transposed: f64 = increments.zip(&derivatives[from..]).map(|(one, other)| one * other).sum();
            assert!((product - transposed).abs() < 1e-9 * product.abs().max(1.0), "{product} {transposed}");
        }
    }

    #[test]
    fn several_series_are_whitened_as_one() {
        for flicker in [0.0, 5.0] {
            let noise = NoiseModel { white: 1.0 / 120.0, angle_walk: 0.01, rate_walk: 8e-6, scale_walk: 0.0, flicker };
            let blocks = vec![Block { is_good: true, is_compared: true, restarts: false, begins_trial: false }; 300];
            let rounding =
                BlockRounding { variance: 0.05, correlation: 0.7, second_difference: 0.1, ..BlockRounding::NONE };
            let whitening = Whitening::new(&noise, &blocks, &vec![rounding; blocks.len()], BLOCK_S);
            let mut state = 3;
            let series: [Vec<f64>; 3] = std::array::from_fn(|_| (0..300).map(|_| draw(&mut state)).collect());
            let expected = series.each_ref().map(|own| whitening.apply_from(40, &own[40..]));
            let increments =
                |block: usize| series.each_ref().map(|own| own[block] - if block == 40 { 0.0 } else { own[block - 1] });
            whitening.pass(40..300, increments, |block, white| {
                for (white, expected) in white.iter().zip(&expected) {
                    let expected = expected[block - 40];
                    assert!((white - expected).abs() < 1e-9, "{flicker} {block}: {white} {expected}");
                }
            });
        }
    }

    #[test]
    fn tails_equal_whitened_courses() {
        let noise = NoiseModel { white: 1.0 / 120.0, angle_walk: 0.01, rate_walk: 8e-6, scale_walk: 0.0, flicker: 0.0 };
        let mut blocks = vec![Block { is_good: true, is_compared: true, restarts: false, begins_trial: false }; 200];
        blocks[90] = Block { is_good: false, is_compared: false, restarts: true, begins_trial: false };
        let rounding =
            BlockRounding { variance: 0.05, correlation: 0.7, second_difference: 0.1, ..BlockRounding::NONE };
        let whitening = Whitening::new(&noise, &blocks, &vec![rounding; blocks.len()], BLOCK_S);
        let mut state = 3;
        let [sizes, other]: [Vec<f64>; 2] = std::array::from_fn(|_| (0..200).map(|_| draw(&mut state)).collect());
        let derivatives = whitening.transposed(&other);
        for falls in [0.0, 1.0] {
            let decays = [1.0, 0.97];
            let mut compared = 0;
            whitening.tails(
                whitening.forms().unwrap(),
                &|block| (sizes[block], falls),
                decays,
                &[&derivatives],
                |block, tail| {
                    for (lane, decay) in decays.into_iter().enumerate() {
                        for lead in [&[1.0][..], &[0.2, 0.7, 1.1]] {
                            let Some(first) = (block + 1).checked_sub(lead.len()) else { continue };
                            let mut values: Vec<f64> = lead.to_vec();
                            values.extend((0..199 - block).scan(lead[lead.len() - 1], |value, _| {
                                *value *= decay;
                                Some(*value)
                            }));
                            let (mut sum, mut before) = (0.0, 0.0);
                            let of_block = |(block, value): (usize, &f64)| {
                                let own = sizes[block] * value;
                                sum += own - falls * std::mem::replace(&mut before, own);
                                sum
                            };
                            let series: Vec<f64> = (first..).zip(&values).map(of_block).collect();
                            let white = whitening.apply_from(first, &series);
                            let square: f64 = white.iter().map(|white| white * white).sum();
                            let product: f64 = white.iter().zip(&other[first..]).map(|(one, other)| one * other).sum();
                            let found = tail.course(lane, block, lead);
                            let off = (found.square - square).abs();
                            assert!(off < 1e-9 * square.max(1.0), "{block} {lane}: {found:?} {square}");
                            let off = (found.products[0] - product).abs();
                            assert!(off < 1e-9 * square.max(1.0), "{found:?} {product}");
                            compared += 1;
                        }
                    }
                },
            );
            assert_eq!(compared, 4 * 200 - 4);
        }
    }

    #[test]
    fn a_count_that_flips_at_rest_is_no_evidence() {
        let noise = NoiseModel { white: 1e-6, angle_walk: 0.005, rate_walk: 0.0, scale_walk: 0.0, flicker: 0.0 };
        let blocks = vec![Block { is_good: true, is_compared: true, restarts: false, begins_trial: false }; 20_000];
        let rest = BlockRounding { variance: 1.0 / 12.0, correlation: 1.0, ..BlockRounding::NONE };
        let (mut state, mut angle) = (1u64, 0.4);
        let counts = |_: &Block| {
            angle += noise.angle_walk * BLOCK_S.sqrt() * (0..12).map(|_| draw(&mut state)).sum::<f64>();
            f64::round(angle)
        };
        let series: Vec<f64> = blocks.iter().map(counts).collect();
        assert!(series.windows(2).filter(|pair| pair[0] != pair[1]).count() > 50);
        let white = Whitening::new(&noise, &blocks, &vec![rest; blocks.len()], BLOCK_S).apply(&series);
        let variance = white.iter().map(|value| value * value).sum::<f64>() / 19_999.0;
        // Less than 1: while a count stays, the walk and the rounding error are opposite.
        assert!((0.6..1.1).contains(&variance), "{variance}");
    }

    #[test]
    fn whitened_walks_are_white_across_a_break() {
        for (angle_walk, flicker) in [(0.01, 0.0), (0.3, 0.0), (0.01, 20.0)] {
            let noise = NoiseModel { white: 1.0 / 120.0, angle_walk, rate_walk: 8e-6, scale_walk: 0.0, flicker };
            let mut stream = NoiseStream::of_sensor(1, "flicker");
            let mut processes = Flicker::stationary(&mut stream);
            let mut blocks =
                vec![Block { is_good: true, is_compared: true, restarts: false, begins_trial: false }; 20_000];
            blocks[9_000] = Block { is_good: false, is_compared: false, restarts: true, begins_trial: false };
            let (mut state, mut angle, mut rate) = (1u64, 0.0, 0.0);
            let mut normal = || (0..12).map(|_| draw(&mut state)).sum::<f64>();
            let step_s = BLOCK_S / BLOCK as f64;
            let series: Vec<f64> = (0..blocks.len())
                .map(|block| {
                    let of_node = |_| {
                        rate += noise.rate_walk * step_s.sqrt() * normal();
                        let drift = rate + flicker / S_PER_H * processes.advance(step_s, &mut stream);
                        angle += drift * step_s + noise.angle_walk * step_s.sqrt() * normal();
                        angle
                    };
                    let average = (0..BLOCK).map(of_node).sum::<f64>() / BLOCK as f64;
                    let jump = if block > 9_000 { 1e6 } else { 0.0 };
                    average + jump + noise.white.sqrt() * normal()
                })
                .collect();
            let white =
                Whitening::new(&noise, &blocks, &vec![BlockRounding::NONE; blocks.len()], BLOCK_S).apply(&series);
            let variance = white.iter().map(|value| value * value).sum::<f64>() / 19_997.0;
            let neighbours = white.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>() / 19_997.0;
            // Four deviations: √(2/20 000) and √(1/20 000).
            assert!((variance - 1.0).abs() < 0.04 && neighbours.abs() < 0.029, "{variance} {neighbours}");
            // 200 sums; four deviations of their variance, √(2/200).
            let slow = white.chunks(100).map(|some| some.iter().sum::<f64>().powi(2) / 100.0).sum::<f64>() / 200.0;
            assert!((slow - 1.0).abs() < 0.4, "{slow}");
            assert_eq!(white[9_001], 0.0);
        }
    }
}
