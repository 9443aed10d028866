//! Products of the time courses of one signature with the null recordings.
//!
//! Steps and courses that decay are sums from their onset to the end, each block with a constant factor to the one before: one pass from the
//! end gives the sums of all onsets.

use std::cmp::Reverse;
use std::collections::HashMap;

use crate::courses::{Mode, Variation};
use crate::measured::{CHANNELS, Series};
use crate::normal_equations::NormalEquations;
use crate::signature_bank::{Column, ConstantSignature, SignatureBank};

/// Number of null recordings.
pub const RUNS: usize = 128;

/// A value for each null recording.
pub type OfRuns = [f32; RUNS];

/// Null recordings on one channel, by block.
pub struct NullChannel {
    /// Whitened, without their projections on the nuisances.
    white: Vec<OfRuns>,
    /// Derivatives of the products by the increments of a signature: zeros after the last block, that block, and those before.
    derivatives: Vec<OfRuns>,
}

/// These recordings on each channel.
pub fn null_channels(normal: &NormalEquations, drawn: Vec<Series>) -> [NullChannel; CHANNELS] {
    let blocks = drawn[0][0].len();
    let by_block = |series: &dyn Fn(usize) -> Vec<f64>| {
        let mut all = vec![[0.0; RUNS]; blocks + 1];
        for run in 0..RUNS {
            all.iter_mut().zip(series(run)).for_each(|(runs, value)| runs[run] = value as f32);
        }
        all
    };
    std::array::from_fn(|channel| {
        let white = by_block(&|run| drawn[run][channel].clone());
        let mut derivatives = by_block(&|run| normal.derivatives(channel, &drawn[run][channel]));
        derivatives.reverse();
        NullChannel { white, derivatives }
    })
}

/// Products of the courses of one signature.
pub struct NullProducts<'a> {
    bank: &'a SignatureBank,
    base: &'a ConstantSignature,
    channels: &'a [NullChannel; CHANNELS],
    /// For each channel, of courses that decay: the sums from a block on, by the bits of the decay and the block.
    tails: [HashMap<(u64, usize), OfRuns>; CHANNELS],
}

impl<'a> NullProducts<'a> {
    /// For the searched courses of a signature.
    pub fn new(
        bank: &'a SignatureBank,
        base: &'a ConstantSignature,
        channels: &'a [NullChannel; CHANNELS],
    ) -> NullProducts<'a> {
        let mut products = NullProducts { bank, base, channels, tails: Default::default() };
        let variations = bank.variations(base);
        let mut tails: Vec<(u64, usize)> = variations.iter().filter_map(tail).collect();
        tails.sort_by_key(|(decay, from)| (*decay, Reverse(*from)));
        let is_reached = |channel: &usize| base.series[*channel].iter().any(|&value| value != 0.0);
        for channel in (0..CHANNELS).filter(is_reached) {
            for same in tails.chunk_by(|one, other| one.0 == other.0) {
                let (mut done, mut sums) = (bank.block_count(), [0.0; RUNS]);
                for &(decay, from) in same {
                    for block in (from..done).rev() {
                        products.add(channel, block, 1.0, f64::from_bits(decay), &mut sums);
                    }
                    done = done.min(from);
                    products.tails[channel].insert((decay, from), sums);
                }
            }
        }
        products
    }

    /// Products of a time course, whitened on a channel.
    pub fn products(&self, channel: usize, variation: &Variation, white: &Column) -> OfRuns {
        let from = white.from;
        if let (Some(key), Some(values)) = (tail(variation), self.bank.values(self.base, variation)) {
            let (first, last) = values.split_at(values.len().min(key.1 - from));
            let size = last.first().map_or(0.0, |size| *size as f32);
            let mut sums = self.tails[channel][&key];
            sums.iter_mut().for_each(|sum| *sum *= size);
            first.iter().zip(from..).for_each(|(value, block)| self.add(channel, block, *value, 1.0, &mut sums));
            return sums;
        }
        product(&white.values, &self.channels[channel].white[from..])
    }

    /// Adds the products of a course with this value in one block, to sums of later blocks times `decay`.
    fn add(&self, channel: usize, block: usize, value: f64, decay: f64, sums: &mut OfRuns) {
        let series = &self.base.series[channel];
        let derivatives = &self.channels[channel].derivatives;
        let [next, own] = [series.len() - block - 1, series.len() - block].map(|place| &derivatives[place]);
        // A level falls again in the next block.
        let (size, falls) = match self.base.mode {
            Mode::Rate => (series[block] - if block == 0 { 0.0 } else { series[block - 1] }, 0.0),
            Mode::Level => (series[block], 1.0),
        };
        let (size, decay) = ((value * size) as f32, decay as f32);
        for (sum, (own, next)) in sums.iter_mut().zip(own.iter().zip(next)) {
            *sum = decay * *sum + size * (own - falls * next);
        }
    }
}

/// Bits of the decay of a course and the block from which it decays: the mean over the two before may include its onset.
fn tail(variation: &Variation) -> Option<(u64, usize)> {
    Some((variation.decay()?.to_bits(), variation.first_block() + 2))
}

/// Sums of the values times the values of each recording.
fn product(values: &[f64], recordings: &[OfRuns]) -> OfRuns {
    let mut sums = [0.0; RUNS];
    for (value, runs) in values.iter().zip(recordings) {
        let value = *value as f32;
        sums.iter_mut().zip(runs).for_each(|(sum, run)| *sum += value * run);
    }
    sums
}
