//! What else would look alike: for each thing found, the whitened cosine of its signature with that of every other hypothesis, beside
//! the nuisances and all else that was found.

use rayon::prelude::*;

use crate::bank::{Bank, Base, Column, Variation};
use crate::change::{ALL_GYROS, Amplitude, Change, Gyros, Place};
use crate::climb::climb;
use crate::measured::{BLOCK_S, CHANNELS, Series, TIMING};
use crate::normal::{Beside, Normal, Nuisance, Products};
use crate::search::columns;
use crate::state::{Case, State};

/// Those that are less alike are none.
const LEAST_COSINE: f64 = 0.3;
/// Rivals whose shapes are fitted.
const CLIMBED: usize = 24;
/// A group whose members cannot be told apart: what they differ by explains less than this, three sigma.
pub const APART_CHI2: f64 = 9.0;

/// A hypothesis that looks like one that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Rival {
    /// What it is.
    pub change: Change,
    /// Cosine of the two signatures, whitened and beside the nuisances; without sign.
    pub cosine: f64,
    /// What χ² falls by more with the one that was found.
    pub behind_chi2: f64,
}

/// Where a rival was found on the grid.
struct Spot {
    base: usize,
    variation: Variation,
    gyros: Gyros,
    cosine: f64,
}

/// The rivals of the change at `index` of a state, the most alike first.
pub fn rivals(case: &Case, bank: &Bank, state: &State, index: usize) -> Vec<Rival> {
    let mut others = state.clone();
    let held = others.held.remove(index);
    let own = case.signature(state, index);
    let (_, columns_of_others) = case.linearised(&mut others);
    // All of the signature is there to be explained, and nothing else.
    let whole: Series = std::array::from_fn(|channel| match &own[channel] {
        Some(values) => values.iter().map(|value| value * held.change.size).collect(),
        None => vec![0.0; case.measured.block_count()],
    });
    let normal = Normal::new(case.whitenings(&state.noise), &whole, &columns_of_others);
    let products = products_of(&normal, &own);
    let Some(found) = normal.gain(&products) else { return Vec::new() };
    let amplitude = held.change.amplitude;
    let parts_of = |base: &Base, variation: &Variation| -> [Option<Beside>; CHANNELS] {
        let columns = columns(bank, base, variation);
        std::array::from_fn(|channel| {
            columns[channel].as_ref().map(|column| normal.beside(&normal.products_of(channel, column)))
        })
    };
    // What it explains of the signature found, beside the nuisances: its square is that of the cosine.
    let cosine_of = |base: &Base, parts: &[Option<Beside>; CHANNELS], gyros: &Gyros| -> Option<(f64, f64)> {
        let own = parts.iter().enumerate().filter(|(channel, _)| reaches(&base.amplitude, gyros, *channel));
        let gain = Beside::gain(&own.filter_map(|(_, part)| part.as_ref()).collect::<Vec<_>>())?;
        Some(((gain.chi2 / found.chi2).clamp(0.0, 1.0).sqrt(), gain.size))
    };
    let sets = |base: &Base| -> Vec<Gyros> {
        if base.amplitude.place == Place::Unit {
            return vec![ALL_GYROS];
        }
        let singles = (0..4).map(|gyro| std::array::from_fn(|other| other == gyro));
        let mut sets: Vec<Gyros> = singles.chain([ALL_GYROS, held.change.gyros]).collect();
        sets.retain(|set| set.iter().zip(base.amplitude.gyros()).all(|(own, can)| !own || can));
        sets.sort_unstable();
        sets.dedup();
        sets
    };
    let of_base = |index: usize| -> Vec<Spot> {
        let base = &bank.bases[index];
        let mut best: Vec<Spot> = Vec::new();
        for variation in bank.variations(base) {
            let own = Amplitude { kind: variation.kind(), ..base.amplitude };
            let parts = parts_of(base, &variation);
            for gyros in sets(base) {
                if own == amplitude && gyros == held.change.gyros {
                    continue;
                }
                let Some((cosine, _)) = cosine_of(base, &parts, &gyros) else { continue };
                let same =
                    best.iter_mut().find(|other| other.variation.kind() == variation.kind() && other.gyros == gyros);
                match same {
                    Some(other) if other.cosine >= cosine => {}
                    Some(other) => *other = Spot { base: index, variation: variation.clone(), gyros, cosine },
                    None => best.push(Spot { base: index, variation: variation.clone(), gyros, cosine }),
                }
            }
        }
        best
    };
    let mut places: Vec<Spot> = (0..bank.bases.len()).into_par_iter().flat_map_iter(of_base).collect();
    places.retain(|place| place.cosine >= LEAST_COSINE);
    places.sort_by(|one, other| other.cosine.total_cmp(&one.cosine));
    places.truncate(CLIMBED);
    let duration_s = case.measured.block_count() as f64 * BLOCK_S;
    let climbed = |spot: Spot| -> Option<Rival> {
        let base = &bank.bases[spot.base];
        let at = |variation: &Variation| {
            let columns = columns(bank, base, variation);
            let parts = columns.iter().enumerate().map(|(channel, column)| {
                let column = column.as_ref().filter(|_| reaches(&base.amplitude, &spot.gyros, channel))?;
                Some(normal.beside(&normal.products_of(channel, column)))
            });
            let parts: Vec<Option<Beside>> = parts.collect();
            cosine_of(base, &parts.try_into().ok()?, &spot.gyros)
        };
        let of = |variation: &Variation| at(variation).map_or(0.0, |(cosine, _)| cosine);
        let (variation, cosine) = climb(spot.variation.clone(), duration_s, &of);
        let (_, size) = at(&variation)?;
        let change = bank.change(base, &variation, size, spot.gyros);
        let behind_chi2 = found.chi2 * (1.0 - cosine * cosine);
        change.is_within_limits().then_some(Rival { change, cosine, behind_chi2 })
    };
    let all: Vec<Rival> = places.into_par_iter().filter_map(climbed).collect();
    let mut told: Vec<Rival> = Vec::new();
    for rival in all {
        let is_same = |other: &Rival| {
            other.change.amplitude == rival.change.amplitude && other.change.gyros == rival.change.gyros
        };
        match told.iter().position(is_same) {
            Some(place) if told[place].cosine < rival.cosine => told[place] = rival,
            Some(_) => {}
            None => told.push(rival),
        }
    }
    told.sort_by(|one, other| other.cosine.total_cmp(&one.cosine));
    told
}

fn reaches(amplitude: &Amplitude, gyros: &Gyros, channel: usize) -> bool {
    amplitude.place == Place::Unit || channel != TIMING && gyros[channel]
}

fn products_of(normal: &Normal, own: &Nuisance) -> Products {
    let parts = own.iter().enumerate().filter_map(|(channel, values)| {
        Some(normal.products_of(channel, &Column { from: 0, values: values.clone()? }))
    });
    parts.fold(Products::none(normal.nuisances()), |sum, part| sum.plus(&part))
}
