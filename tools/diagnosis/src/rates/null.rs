//! What noise alone would do: the greatest gain that a search among so many sets finds where there is nothing to find.

use geu_model::noise::NoiseStream;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::rates::estimator::Estimator;
use crate::rates::fit::{Fit, beside, joined, sets};
use crate::rates::model::Parameter;
use crate::rates::noise::Noise;
use crate::rates::windows::Windows;

const RUNS: usize = 1000;
/// Chance that noise alone is given a name, or called unexplained, over everything that a step of the search tries.
const FAMILY_WISE: f64 = 0.01;
/// Share of a column's square that must be left beside those before it.
const SINGULAR: f64 = 1e-11;

/// What gains must exceed.
#[derive(Debug, Clone)]
pub(crate) struct Thresholds {
    /// Fall of χ² by the best set that has one error more, two errors more.
    pub(crate) more: Vec<f64>,
    /// How many sets were tried for each.
    pub(crate) tried: Vec<usize>,
    /// Fall of χ² by an offset of every group.
    pub(crate) offsets: f64,
}

/// Draws noise about a solution and searches it as the data are searched, the errors linear about the solution. The sets
/// searched have up to `more` errors more than the solution. The noise drawn is as slow as noise may be: few windows leave its
/// correlation open, and where that is believed too low, noise alone goes beyond the threshold too often.
pub(crate) fn thresholds(windows: &Windows, base: &Fit, noise: &Noise, more: usize, seed: u64) -> Thresholds {
    let parameters = windows.parameters();
    let (_, slope) = base.linearised(windows, &parameters);
    let columns = joined(slope, &Noise::offsets(windows));
    let place = |set: &[Parameter]| -> Vec<usize> {
        (0..parameters.len()).filter(|index| set.contains(&parameters[*index])).collect()
    };
    let searched: Vec<Vec<Vec<usize>>> = (1..=more)
        .map(|more| sets(&parameters, base.set.len() + more).iter().map(|set| place(set)).collect())
        .collect();
    let base_places = place(&base.set);
    let with_offsets: Vec<usize> = base_places.iter().copied().chain(parameters.len()..columns.ncols()).collect();
    let estimator = Estimator::new(windows, base);
    let noise = noise.slowest(windows);
    let gains: Vec<Vec<f64>> = (0..RUNS)
        .into_par_iter()
        .map(|run| {
            let mut stream = NoiseStream::of_sensor(seed.wrapping_add(run as u64), "null rates");
            let drawn = noise.draw(windows, || stream.standard_normal());
            let products = Products::new(windows, &estimator.estimate(&drawn), &columns, &drawn);
            let base = products.gain(&base_places);
            let best = |sets: &Vec<Vec<usize>>| sets.iter().map(|set| products.gain(set) - base).fold(0.0, f64::max);
            let mut gains: Vec<f64> = searched.iter().map(best).collect();
            gains.push(products.gain(&with_offsets) - base);
            gains
        })
        .collect();
    let exceeded = |index: usize, share: f64| {
        let mut gains: Vec<f64> = gains.iter().map(|gains| gains[index]).collect();
        gains.sort_unstable_by(f64::total_cmp);
        gains[RUNS - 1 - (RUNS as f64 * share) as usize]
    };
    let share = FAMILY_WISE / (more + 1) as f64;
    Thresholds {
        more: (0..more).map(|index| exceeded(index, share)).collect(),
        tried: searched.iter().map(Vec::len).collect(),
        offsets: exceeded(more, share),
    }
}

/// Products of whitened columns with themselves and with a residual.
pub(crate) struct Products {
    own: DMatrix<f64>,
    right: DVector<f64>,
}

impl Products {
    pub(crate) fn new(windows: &Windows, noise: &Noise, columns: &DMatrix<f64>, residual: &DVector<f64>) -> Products {
        let white = noise.whiten(windows, &beside(columns.clone(), residual));
        let columns = white.columns(0, columns.ncols());
        Products { own: columns.tr_mul(&columns), right: columns.tr_mul(&white.column(white.ncols() - 1)) }
    }

    /// Fall of χ² by these columns: elimination, in which what is a sum of those before it is left out.
    pub(crate) fn gain(&self, places: &[usize]) -> f64 {
        let count = places.len();
        let mut own: Vec<f64> =
            places.iter().flat_map(|row| places.iter().map(|column| self.own[(*row, *column)])).collect();
        let mut right: Vec<f64> = places.iter().map(|place| self.right[*place]).collect();
        let mut gain = 0.0;
        for pivot in 0..count {
            let left = own[pivot * count + pivot];
            if left <= SINGULAR * self.own[(places[pivot], places[pivot])] {
                continue;
            }
            gain += right[pivot] * right[pivot] / left;
            for row in pivot + 1..count {
                let factor = own[row * count + pivot] / left;
                for column in pivot + 1..count {
                    own[row * count + column] -= factor * own[pivot * count + column];
                }
                right[row] -= factor * right[pivot];
            }
        }
        gain
    }
}
