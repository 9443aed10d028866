//! What else would do: for each thing found, every other hypothesis in its place, beside the nuisances and all else that was found.
//!
//! A rival that explains the data nearly as well cannot be told apart by them, whatever the search took: what was found is then one
//! of a group. How alike the two are on this motion is the whitened cosine of their signatures.

use rayon::prelude::*;

use crate::bank::{Bank, Base, Column, Variation};
use crate::change::{ALL_GYROS, Amplitude, Change, Gyros, Place};
use crate::climb::climb;
use crate::measured::{BLOCK_S, CHANNELS, Series, TIMING};
use crate::normal::{Beside, Gain, Normal, Nuisance, Products, dot};
use crate::state::{Case, State};

/// Those that explain a smaller share of what was found explains are none: the square of a cosine of 0.3.
const LEAST_SHARE: f64 = 0.09;
/// Rivals whose shapes are fitted.
const CLIMBED: usize = 24;
/// Rivals at most.
const MOST: usize = 64;
/// A group whose members cannot be told apart: what χ² falls by differs by less than this, three sigma.
pub const APART_CHI2: f64 = 9.0;

/// A hypothesis in the place of one that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Rival {
    /// What it is.
    pub change: Change,
    /// Cosine of the two signatures, whitened and beside the nuisances; without sign.
    pub cosine: f64,
    /// By how much more χ² falls with the one that was found; 0 where it falls no more.
    pub behind_chi2: f64,
}

/// A rival on the grid.
struct Spot {
    base: usize,
    variation: Variation,
    gyros: Gyros,
    gain: Gain,
}

/// The rivals of the change at `index` of a state on the data, the best first.
pub fn rivals(case: &Case, bank: &Bank, state: &State, index: usize) -> Vec<Rival> {
    let mut others = state.clone();
    others.held.remove(index);
    let (residual, columns) = case.linearised(&mut others);
    let normal = Normal::new(case.whitenings(&state.noise), &residual, &columns);
    // As the model runs it: of what is not linear the signature tells only the last step.
    let fall = normal.chi2() - case.normal(&mut state.clone()).chi2();
    in_place_of(case, bank, &normal, state, index, fall)
}

/// The same where the data are nothing but what the change adds: what looks most like it.
pub fn look_alikes(case: &Case, bank: &Bank, state: &State, index: usize) -> Vec<Rival> {
    let mut others = state.clone();
    let held = others.held.remove(index);
    let (_, columns) = case.linearised(&mut others);
    let whole: Series = case.signature(state, index).map(|own| match own {
        Some(values) => values.iter().map(|value| value * held.change.size).collect(),
        None => vec![0.0; case.measured.block_count()],
    });
    let normal = Normal::new(case.whitenings(&state.noise), &whole, &columns);
    // Nothing but nuisances is left of it.
    let fall = normal.chi2();
    in_place_of(case, bank, &normal, state, index, fall)
}

/// The rivals on what `normal` has to explain, of which the change makes χ² fall by `fall`.
fn in_place_of(case: &Case, bank: &Bank, normal: &Normal, state: &State, index: usize, fall: f64) -> Vec<Rival> {
    let own = Signature::new(normal, &case.signature(state, index));
    let held = &state.held[index].change;
    let mut spots: Vec<Spot> =
        (0..bank.bases.len()).into_par_iter().flat_map_iter(|base| spots(bank, normal, base, held)).collect();
    spots.retain(|spot| spot.gain.chi2 >= LEAST_SHARE * fall);
    spots.sort_by(|one, other| other.gain.chi2.total_cmp(&one.gain.chi2));
    let in_group = spots.iter().take_while(|spot| fall - spot.gain.chi2 < APART_CHI2).count();
    spots.truncate(in_group.clamp(CLIMBED, MOST));
    let duration_s = case.measured.block_count() as f64 * BLOCK_S;
    let told = |(place, spot): (usize, &Spot)| -> Option<Rival> {
        let base = &bank.bases[spot.base];
        let gain = |variation: &Variation| {
            let products = Signature::of(bank, normal, base, variation, &spot.gyros).products;
            normal.gain(&products).filter(|gain| base.stands_for(gain.size))
        };
        let mut variation = spot.variation.clone();
        if place < CLIMBED {
            (variation, _) = climb(variation, duration_s, &|at| gain(at).map_or(0.0, |gain| gain.chi2));
        }
        let gain = gain(&variation)?;
        let signature = Signature::of(bank, normal, base, &variation, &spot.gyros);
        let cosine = normal.cosine(&own.products, &signature.products, own.dot(&signature)).abs().min(1.0);
        let size = if base.is_linear { gain.size } else { base.size };
        let change = bank.change(base, &variation, size, spot.gyros);
        let behind_chi2 = (fall - gain.chi2).max(0.0);
        change.is_within_limits().then_some(Rival { change, cosine, behind_chi2 })
    };
    let all: Vec<Rival> = spots.par_iter().enumerate().filter_map(told).collect();
    let mut rivals: Vec<Rival> = Vec::new();
    for rival in all {
        let is_same = |other: &Rival| {
            other.change.amplitude == rival.change.amplitude && other.change.gyros == rival.change.gyros
        };
        match rivals.iter().position(is_same) {
            Some(place) if rivals[place].behind_chi2 > rival.behind_chi2 => rivals[place] = rival,
            Some(_) => {}
            None => rivals.push(rival),
        }
    }
    let first = |rival: &Rival| (rival.behind_chi2, -rival.cosine);
    rivals.sort_by(|one, other| first(one).partial_cmp(&first(other)).unwrap_or(std::cmp::Ordering::Equal));
    rivals
}

/// The best course of each kind of one base on each set of gyros.
fn spots(bank: &Bank, normal: &Normal, index: usize, held: &Change) -> Vec<Spot> {
    let base = &bank.bases[index];
    let mut best: Vec<Spot> = Vec::new();
    let sets = sets(base, &held.gyros);
    for variation in bank.variations(base) {
        let own = Amplitude { kind: variation.kind(), ..base.amplitude };
        let columns = bank.columns(base, &variation);
        let parts: [Option<Beside>; CHANNELS] = std::array::from_fn(|channel| {
            columns[channel].as_ref().map(|column| normal.beside(&normal.products_of(channel, column)))
        });
        for gyros in sets.iter().copied().filter(|gyros| own != held.amplitude || *gyros != held.gyros) {
            let reached = parts.iter().enumerate().filter(|(channel, _)| reaches(&base.amplitude, &gyros, *channel));
            let gain = Beside::gain(&reached.filter_map(|(_, part)| part.as_ref()).collect::<Vec<_>>());
            let Some(gain) = gain.filter(|gain| base.stands_for(gain.size)) else { continue };
            let same = best.iter_mut().find(|other| other.variation.kind() == variation.kind() && other.gyros == gyros);
            let spot = Spot { base: index, variation: variation.clone(), gyros, gain };
            match same {
                Some(other) if other.gain.chi2 >= gain.chi2 => {}
                Some(other) => *other = spot,
                None => best.push(spot),
            }
        }
    }
    best
}

/// Sets of gyros on which a rival is looked for: each alone, all, and those of what was found.
fn sets(base: &Base, found: &Gyros) -> Vec<Gyros> {
    if base.amplitude.place == Place::Unit {
        return vec![ALL_GYROS];
    }
    let singles = (0..4).map(|gyro| std::array::from_fn(|other| other == gyro));
    let mut sets: Vec<Gyros> = singles.chain([ALL_GYROS, *found]).collect();
    sets.retain(|set| set.iter().zip(base.amplitude.gyros()).all(|(own, can)| !own || can));
    sets.sort_unstable();
    sets.dedup();
    sets
}

fn reaches(amplitude: &Amplitude, gyros: &Gyros, channel: usize) -> bool {
    amplitude.place == Place::Unit || channel != TIMING && gyros[channel]
}

/// The whitened values of a channel that is reached, and the first block of them.
type White = Option<(usize, Vec<f64>)>;

/// A signature, whitened.
struct Signature {
    white: [White; CHANNELS],
    products: Products,
}

impl Signature {
    fn new(normal: &Normal, nuisance: &Nuisance) -> Signature {
        let column = |values: &Option<Vec<f64>>| Some(Column { from: 0, values: values.clone()? });
        Signature::whitened(normal, nuisance.each_ref().map(column))
    }

    fn of(bank: &Bank, normal: &Normal, base: &Base, variation: &Variation, gyros: &Gyros) -> Signature {
        let mut columns = bank.columns(base, variation);
        for (channel, column) in columns.iter_mut().enumerate() {
            if !reaches(&base.amplitude, gyros, channel) {
                *column = None;
            }
        }
        Signature::whitened(normal, columns)
    }

    fn whitened(normal: &Normal, columns: [Option<Column>; CHANNELS]) -> Signature {
        let white: [White; CHANNELS] =
            std::array::from_fn(|channel| columns[channel].as_ref().map(|column| normal.white(channel, column)));
        let parts = white.iter().enumerate().filter_map(|(channel, own)| Some(normal.products(channel, own.as_ref()?)));
        let products = parts.fold(Products::none(normal.nuisances()), |sum, part| sum.plus(&part));
        Signature { white, products }
    }

    /// The product with another.
    fn dot(&self, other: &Signature) -> f64 {
        let of_channel = |(one, other): (&White, &White)| {
            let ((one_from, one), (other_from, other)) = (one.as_ref()?, other.as_ref()?);
            let from = *one_from.max(other_from);
            let to = (one_from + one.len()).min(other_from + other.len());
            (from < to).then(|| dot(&one[from - one_from..to - one_from], &other[from - other_from..to - other_from]))
        };
        self.white.iter().zip(&other.white).filter_map(of_channel).sum()
    }
}
