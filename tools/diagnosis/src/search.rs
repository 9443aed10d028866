//! The search: every hypothesis of the bank, on every set of gyros, against what the state leaves.

use rayon::prelude::*;

use crate::amplitude::AmplitudeRef;
use crate::bank::{Bank, Base, Family, Variation};
use crate::climb::climb;
use crate::gyros::{ALL_GYROS, Gyros};
use crate::hypothesis::Hypothesis;
use crate::measured::{BLOCK_S, CHANNELS, TIMING};
use crate::normal::{Beside, Gain, Normal, Products, THIRDS};
use crate::state::State;
use crate::sweep::{Part, sweep};

/// What noise alone may take away from the thirds that have little of it: three sigma, however much the gain is.
const HARM_CHI2: f64 = 9.0;
/// Candidates whose shapes are fitted.
const CLIMBED: usize = 16;

/// A hypothesis with what it explains.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// What it is, at the size that fits.
    pub hypothesis: Hypothesis,
    /// Its family.
    pub family: Family,
    /// What it explains.
    pub gain: Gain,
    /// By how much better each third is foretold by the others ([`Normal::held_out`]).
    pub held_out: [Option<f64>; THIRDS],
    /// Index of its base, and its course.
    pub base: usize,
    /// Its course.
    pub variation: Variation,
}

impl Candidate {
    /// Whether it pays on what was not fitted.
    pub fn pays_held_out(&self) -> bool {
        pays(&self.held_out)
    }
}

/// Whether a hypothesis by which each third is so much better foretold pays on what was not fitted. Where a third has nearly all that
/// tells of it, and cannot be foretold, it is enough that it does no harm to the others.
pub fn pays(held_out: &[Option<f64>; THIRDS]) -> bool {
    let all = held_out.iter().all(Option::is_some);
    let sum: f64 = held_out.iter().flatten().sum();
    sum > if all { 0.0 } else { -HARM_CHI2 }
}

/// Sets of gyros that an amplitude may act on together with one value, of the channels that it reaches.
pub fn sets(amplitude: &AmplitudeRef, reached: [bool; CHANNELS]) -> Vec<Gyros> {
    if amplitude.is_of_unit() {
        return vec![ALL_GYROS];
    }
    let all = (1u8..16).map(|mask| std::array::from_fn(|gyro| mask & (1 << gyro) != 0));
    all.filter(|set: &Gyros| (0..TIMING).all(|gyro| reached[gyro] || !set[gyro])).collect()
}

/// What a set of gyros costs beside one gyro or all of them: there are ten ways to choose two or three of four.
pub fn set_penalty(gyros: &Gyros, amplitude: &AmplitudeRef) -> f64 {
    let count = gyros.iter().filter(|has| **has).count();
    if !amplitude.is_of_unit() && (count == 2 || count == 3) { 2.0 * 10f64.ln() } else { 0.0 }
}

/// Whether what an amplitude adds on these gyros is on a channel.
pub fn reaches(amplitude: &AmplitudeRef, gyros: &Gyros, channel: usize) -> bool {
    amplitude.is_of_unit() || channel != TIMING && gyros[channel]
}

/// Products of a hypothesis, over its gyros.
pub fn products(bank: &Bank, normal: &Normal, base: &Base, variation: &Variation, gyros: &Gyros) -> Products {
    let columns = bank.columns(base, variation);
    let parts = columns.iter().enumerate().filter(|(channel, _)| reaches(&base.amplitude, gyros, *channel));
    parts.fold(Products::none(normal.nuisances()), |sum, (channel, column)| match column {
        Some(column) => sum.plus(&normal.products_of(channel, column)),
        None => sum,
    })
}

/// The best candidate of each code and set of gyros, the best first; those of `held` codes on their own gyros left out where a
/// configuration holds only one.
pub fn search(bank: &Bank, normal: &Normal, state: &State, penalty: &(dyn Fn(Family) -> f64 + Sync)) -> Vec<Candidate> {
    let of_base = |index: usize| -> Vec<Candidate> {
        let base = &bank.bases[index];
        let mut best: Vec<Candidate> = Vec::new();
        let take = |variation: &Variation, parts: &[Part<()>; CHANNELS]| {
            let kind = variation.kind();
            let mut try_set = |gyros: Gyros, parts: &[&Beside]| {
                let Some(gain) = Beside::gain(parts) else { return };
                let held = state.held.iter().any(|held| {
                    let own = &held.hypothesis.amplitude;
                    *own == AmplitudeRef { kind, ..base.amplitude }
                        && held.hypothesis.gyros.iter().zip(gyros).any(|(one, other)| *one && other)
                });
                if held {
                    return;
                }
                let place = best
                    .iter()
                    .position(|other| other.hypothesis.gyros == gyros && other.hypothesis.amplitude.kind == kind);
                if place.is_some_and(|place| best[place].gain.chi2 >= gain.chi2) {
                    return;
                }
                let size = if base.is_linear { gain.size } else { base.size };
                let hypothesis = bank.hypothesis(base, variation, size, gyros);
                if !hypothesis.is_within_limits() || !base.stands_for(gain.size) {
                    return;
                }
                let candidate = Candidate {
                    hypothesis,
                    family: base.family(variation),
                    gain,
                    held_out: [None; THIRDS],
                    base: index,
                    variation: variation.clone(),
                };
                match place {
                    Some(place) => best[place] = candidate,
                    None => best.push(candidate),
                }
            };
            for gyros in sets(&base.amplitude, parts.each_ref().map(Option::is_some)) {
                let chosen = (0..CHANNELS).filter(|&channel| reaches(&base.amplitude, &gyros, channel));
                let parts = chosen.filter_map(|channel| parts[channel].as_ref().map(|(part, ())| part));
                try_set(gyros, &parts.collect::<Vec<_>>());
            }
        };
        sweep(bank, normal, base, |_, _| (), take);
        best
    };
    let found: Vec<Vec<Candidate>> = (0..bank.bases.len()).into_par_iter().map(of_base).collect();
    let mut best: Vec<Candidate> = Vec::new();
    let score = |candidate: &Candidate| {
        candidate.gain.chi2
            - penalty(candidate.family)
            - set_penalty(&candidate.hypothesis.gyros, &candidate.hypothesis.amplitude)
    };
    for candidate in found.into_iter().flatten() {
        // One for each code and set of gyros, whatever its shapes.
        let same = best.iter().position(|other| {
            other.hypothesis.amplitude == candidate.hypothesis.amplitude
                && other.hypothesis.gyros == candidate.hypothesis.gyros
        });
        match same {
            Some(place) if score(&best[place]) < score(&candidate) => best[place] = candidate,
            Some(_) => {}
            None => best.push(candidate),
        }
    }
    best.sort_by(|a, b| score(b).total_cmp(&score(a)));
    // Between the points of the grid.
    let climbed = |candidate: &mut Candidate| {
        let base = &bank.bases[candidate.base];
        let duration_s = normal.residual()[0].len() as f64 * BLOCK_S;
        let gain =
            |variation: &Variation| normal.gain(&products(bank, normal, base, variation, &candidate.hypothesis.gyros));
        let of = |variation: &Variation| gain(variation).map_or(0.0, |gain| gain.chi2);
        let (variation, _) = climb(candidate.variation.clone(), duration_s, &of);
        if let Some(found) = gain(&variation) {
            let size = if base.is_linear { found.size } else { base.size };
            let hypothesis = bank.hypothesis(base, &variation, size, candidate.hypothesis.gyros);
            if hypothesis.is_within_limits() {
                *candidate = Candidate { hypothesis, gain: found, variation, ..candidate.clone() };
            }
        }
    };
    best.truncate(CLIMBED);
    best.par_iter_mut().for_each(climbed);
    best.sort_by(|a, b| score(b).total_cmp(&score(a)));
    for candidate in &mut best {
        let own =
            products(bank, normal, &bank.bases[candidate.base], &candidate.variation, &candidate.hypothesis.gyros);
        candidate.held_out = normal.held_out(&own);
    }
    best
}
