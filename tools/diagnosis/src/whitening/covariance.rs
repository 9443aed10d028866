//! Covariance of the whitening filter's state: angle, rates and rounding error of one channel.

use geu_model::noise::flicker::{CORRELATION_TIMES_S, SIGMA};
use geu_model::units::S_PER_H;

use super::NoiseModel;
use crate::measured::BLOCK;

/// Mean time of a block's average of a walk that starts at 0, as a share of the block.
const MEAN: f64 = (BLOCK as f64 + 1.0) / (2.0 * BLOCK as f64);
/// Variance of that average, as a share of the walk's variance at the end of the block.
const VARIANCE: f64 = (BLOCK as f64 + 1.0) * (2.0 * BLOCK as f64 + 1.0) / (6.0 * BLOCK as f64 * BLOCK as f64);
/// Processes of a flicker that change within a recording and last longer than a block.
pub const SLOW: usize = CORRELATION_TIMES_S.len() - 2;
/// Variance of a free drift's turn over a block, as a multiple of that of the block's noise: half of the digits of a number.
const FREE: f64 = 1e8;
/// Rates of the filter with flicker: a random walk, and those processes.
pub const RATES: usize = 1 + SLOW;

/// A rate over one block.
#[derive(Debug, Clone, Copy)]
struct Rate {
    /// Share that is left at the end.
    left: f64,
    /// Turn up to the mean time of the average, and up to the end, per unit at the start.
    turns_s: [f64; 2],
    /// Growth of the variances of the turn and of the rate, and of their covariance.
    growth: [f64; 3],
    /// Variance at the start of a recording.
    start: f64,
}

impl Rate {
    /// A random walk. Its first value is a calibration parameter, not noise.
    fn walk(growth: f64, block_s: f64) -> Rate {
        let t = block_s;
        let growth = [growth * t.powi(3) / 3.0, growth * t, growth * t * t / 2.0];
        Rate { left: 1.0, turns_s: [MEAN * t, t], growth, start: 0.0 }
    }

    /// A stationary process of this variance ([`geu_model::noise::GaussMarkov`]).
    fn process(variance: f64, time_s: f64, block_s: f64) -> Rate {
        let (x, left) = (block_s / time_s, decay(time_s, block_s));
        let turn_s = |share: f64| -time_s * (-share * x).exp_m1();
        let turn = variance * time_s * time_s * (2.0 * x - 3.0 + 4.0 * left - left * left);
        let growth = [turn, variance * (1.0 - left * left), variance * time_s * (1.0 - left).powi(2)];
        Rate { left, turns_s: [turn_s(MEAN), turn_s(1.0)], growth, start: variance }
    }
}

/// Share of a process that is left after a block.
fn decay(time_s: f64, block_s: f64) -> f64 {
    (-block_s / time_s).exp()
}

/// Shares of the slow processes that are left after a block.
pub fn slow_decays(block_s: f64) -> [f64; SLOW] {
    std::array::from_fn(|slow| decay(CORRELATION_TIMES_S[1 + slow], block_s))
}

/// A value for each part of the state at the end of a block.
#[derive(Debug, Clone, Copy)]
pub struct OfState<const RATES: usize> {
    pub angle: f64,
    rates: [f64; RATES],
    pub error: f64,
}

impl<const RATES: usize> Default for OfState<RATES> {
    fn default() -> Self {
        OfState { angle: 0.0, rates: [0.0; RATES], error: 0.0 }
    }
}

/// The average of a block.
pub struct Average<const RATES: usize> {
    /// Covariances with the state.
    with: OfState<RATES>,
    /// Variance.
    pub variance: f64,
}

/// The covariance of angle (a), rates (r) and rounding error (e). At the start the angle is free, since a common time shift changes the
/// angle before.
pub struct Covariance<const RATES: usize> {
    block_s: f64,
    rates: [Rate; RATES],
    /// Growth of the angle's variance over a block by angle random walk and flicker.
    pub angle_walk: f64,
    aa: f64,
    ar: [f64; RATES],
    rr: [[f64; RATES]; RATES],
    ae: f64,
    re: [f64; RATES],
    ee: f64,
}

impl<const RATES: usize> Covariance<RATES> {
    /// At the start of a recording of such blocks, with this variance of the rounding error; without flicker it has one rate.
    pub fn new(noise: &NoiseModel, rounding: f64, block_s: f64) -> Self {
        let process = (SIGMA * noise.flicker / S_PER_H).powi(2);
        let [fast_s, slow_s] = [CORRELATION_TIMES_S[0], CORRELATION_TIMES_S[CORRELATION_TIMES_S.len() - 1]];
        // The fastest process of the flicker is an angle random walk, the slowest a rate random walk.
        let angle_walk = block_s * (noise.angle_walk.powi(2) + 2.0 * process * fast_s);
        let walk = Rate::walk(noise.rate_walk.powi(2) + 2.0 * process / slow_s, block_s);
        let rates: [Rate; RATES] = std::array::from_fn(|rate| match rate {
            0 => walk,
            _ => Rate::process(process, CORRELATION_TIMES_S[rate], block_s),
        });
        let mut rr = [[0.0; RATES]; RATES];
        rates.iter().enumerate().for_each(|(rate, own)| rr[rate][rate] = own.start);
        Covariance {
            block_s,
            rates,
            angle_walk,
            aa: 0.0,
            ar: [0.0; RATES],
            rr,
            ae: 0.0,
            re: [0.0; RATES],
            ee: rounding,
        }
    }

    /// Turn with these rates up to the mean time of the average, 0, or up to the end, 1.
    fn turn(&self, values: &[f64; RATES], end: usize) -> f64 {
        self.rates.iter().zip(values).map(|(rate, value)| rate.turns_s[end] * value).sum()
    }

    /// Covariance of that turn with each rate at the start.
    fn turned(&self, end: usize) -> [f64; RATES] {
        let mut turned = [0.0; RATES];
        for (own, turned) in turned.iter_mut().enumerate() {
            *turned = self.rates.iter().zip(&self.rr).map(|(rate, with)| rate.turns_s[end] * with[own]).sum();
        }
        turned
    }

    /// The average of a block in which the angle's variance grows by `angle`, with additional white noise. Moves the state to the end of the block.
    pub fn advance(&mut self, angle: f64, white: f64) -> Average<RATES> {
        let [at_mean, at_end] = [0, 1].map(|end| self.turned(end));
        let mut rates = [0.0; RATES];
        for (rate, own) in self.rates.iter().enumerate() {
            rates[rate] = own.left * (self.ar[rate] + at_mean[rate] + self.re[rate]);
        }
        let [ar_mean, ar_end] = [0, 1].map(|end| self.turn(&self.ar, end));
        let [re_mean, re_end] = [0, 1].map(|end| self.turn(&self.re, end));
        let with = OfState {
            angle: self.aa + ar_mean + ar_end + self.turn(&at_mean, 1) + MEAN * angle + self.ae + re_end,
            rates,
            error: self.ae + re_mean + self.ee,
        };
        let turns = self.turn(&at_mean, 0) + 2.0 * (ar_mean + re_mean);
        let variance = self.aa + turns + VARIANCE * angle + white + 2.0 * self.ae + self.ee;
        self.aa += 2.0 * ar_end + self.turn(&at_end, 1) + angle;
        self.ae += re_end;
        for (rate, own) in self.rates.iter().enumerate() {
            let [turn, grown, both] = own.growth;
            self.aa += turn;
            self.ar[rate] = own.left * (self.ar[rate] + at_end[rate]) + both;
            self.re[rate] *= own.left;
            self.rr[rate].iter_mut().zip(&self.rates).for_each(|(with, other)| *with *= own.left * other.left);
            self.rr[rate][rate] += grown;
        }
        Average { with, variance }
    }

    /// Another drift, of which nothing is known beside a block with noise of this variance.
    pub fn free_drift(&mut self, noise: f64) {
        self.rr[0][0] += FREE * noise / self.block_s.powi(2);
    }

    /// Takes the average of the block as the angle: that at the end is the average and what came after its mean time.
    pub fn restart(&mut self, angle: f64, white: f64) -> OfState<RATES> {
        let left_s = self.block_s - MEAN * self.block_s;
        let rest = (1.0 - 2.0 * MEAN + VARIANCE) * angle;
        let summed: [f64; RATES] = std::array::from_fn(|rate| self.rr.iter().map(|with| with[rate]).sum());
        let errors: f64 = self.re.iter().sum();
        self.aa = white + rest + left_s * left_s * summed.iter().sum::<f64>() + self.ee - 2.0 * left_s * errors;
        self.ar = std::array::from_fn(|rate| left_s * summed[rate] - self.re[rate]);
        self.ae = left_s * errors - self.ee;
        OfState { angle: 1.0, ..OfState::default() }
    }

    /// Takes the average into account.
    pub fn correct(&mut self, average: &Average<RATES>) -> OfState<RATES> {
        let Average { with, variance } = average;
        let gains = OfState {
            angle: with.angle / variance,
            rates: with.rates.map(|covariance| covariance / variance),
            error: with.error / variance,
        };
        self.aa -= gains.angle * with.angle;
        self.ae -= gains.angle * with.error;
        self.ee -= gains.error * with.error;
        for rate in 0..RATES {
            self.ar[rate] -= gains.angle * with.rates[rate];
            self.re[rate] -= gains.rates[rate] * with.error;
            for other in 0..RATES {
                self.rr[rate][other] -= gains.rates[rate] * with.rates[other];
            }
        }
        gains
    }

    /// Moves the rounding error to the next block, of which this share persists; its variance grows.
    pub fn next_error(&mut self, persistence: f64, growth: f64) {
        self.ae *= persistence;
        self.re.iter_mut().for_each(|covariance| *covariance *= persistence);
        self.ee = persistence * persistence * self.ee + growth;
    }

    /// Turn by an innovation with these gains, up to the mean time of the next block.
    pub fn turn_to_mean(&self, gains: &OfState<RATES>) -> f64 {
        self.turn(&gains.rates, 0)
    }

    /// Turns by an innovation with these gains, from that average to the one after: by the random walk and by each slow process.
    pub fn turns(&self, gains: &OfState<RATES>) -> (f64, [f64; SLOW]) {
        let of_rate = |rate: usize| {
            let own = self.rates.get(rate)?;
            Some((own.turns_s[1] + own.turns_s[0] * (own.left - 1.0)) * gains.rates[rate])
        };
        (of_rate(0).unwrap_or(0.0), std::array::from_fn(|slow| of_rate(1 + slow).unwrap_or(0.0)))
    }
}
