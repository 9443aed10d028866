//! What else would look alike: for each thing found, the whitened cosine of its signature with that of every other hypothesis, beside
//! the nuisances and all else that was found.

use rayon::prelude::*;

use crate::bank::{Bank, Column};
use crate::change::{Amplitude, Change, Gyros, Place};
use crate::measured::{Series, TIMING};
use crate::normal::{Beside, Normal, Nuisance, Products};
use crate::search::columns;
use crate::state::{Case, State};

/// Those that are less alike are none.
const LEAST_COSINE: f64 = 0.3;
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
    let of_base = |index: usize| -> Vec<Rival> {
        let base = &bank.bases[index];
        let mut best: Vec<Rival> = Vec::new();
        for variation in bank.variations(base) {
            let own = Amplitude { kind: variation.kind(), ..base.amplitude };
            if own == amplitude {
                continue;
            }
            let columns = columns(bank, base, &variation);
            let parts: Vec<Beside> = columns
                .iter()
                .enumerate()
                .filter(|(channel, _)| reaches(&base.amplitude, &held.change.gyros, *channel))
                .filter_map(|(channel, column)| Some(normal.beside(&normal.products_of(channel, column.as_ref()?))))
                .collect();
            // What it explains of the signature found, beside the nuisances: its square is that of the cosine.
            let Some(gain) = Beside::gain(&parts.iter().collect::<Vec<_>>()) else { continue };
            let cosine = (gain.chi2 / found.chi2).clamp(0.0, 1.0).sqrt();
            let change = bank.change(base, &variation, gain.size, held.change.gyros);
            if !change.is_within_limits() {
                continue;
            }
            let rival = Rival { change, cosine, behind_chi2: found.chi2 - gain.chi2 };
            match best.iter_mut().find(|other| other.change.amplitude == own) {
                Some(other) if other.cosine < cosine => *other = rival,
                Some(_) => {}
                None => best.push(rival),
            }
        }
        best
    };
    let all: Vec<Rival> = (0..bank.bases.len()).into_par_iter().flat_map_iter(of_base).collect();
    let mut told: Vec<Rival> = Vec::new();
    for rival in all.into_iter().filter(|rival| rival.cosine >= LEAST_COSINE) {
        match told.iter_mut().find(|other| other.change.amplitude == rival.change.amplitude) {
            Some(other) if other.cosine < rival.cosine => *other = rival,
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
