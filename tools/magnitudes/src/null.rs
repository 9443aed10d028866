//! Null distribution: the largest gain that the search finds in noise alone.

use geu_model::noise::NoiseStream;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::estimator::Estimator;
use crate::fit::{Fit, joined, sets};
use crate::model::Parameter;
use crate::noise::Noise;
use crate::windows::Windows;

const RUNS: usize = 1000;
/// Probability, over all trials of a search step, that noise alone yields an error or an unexplained residual.
const FALSE_ALARM_RATE: f64 = 0.01;
/// Share of a column's square that must remain after projecting out the columns before it.
const SINGULAR: f64 = 1e-11;

/// Thresholds of the chi2 reduction.
#[derive(Debug, Clone)]
pub(crate) struct Thresholds {
    /// Number of sets tried and threshold of the best of them: with one error more, with two errors more.
    pub(crate) more: Vec<(usize, f64)>,
    /// With an offset of every group.
    pub(crate) offsets: f64,
}

/// Draws noise about a solution and searches it as the data are searched, with errors linearised about the solution. The sets
/// searched have up to `more` errors more than the solution. The noise has the largest correlation allowed: few windows hardly
/// determine the correlation, and an underestimate raises the false alarm rate.
pub(crate) fn thresholds(windows: &Windows, base: &Fit, noise: &Noise, more: usize, seed: u64) -> Thresholds {
    let parameters = windows.parameters();
    let (_, slope) = base.linearised(windows, &parameters);
    let columns = joined(slope, &Noise::offsets(windows));
    let places = |set: &Vec<Parameter>| -> Vec<usize> {
        (0..parameters.len()).filter(|index| set.contains(&parameters[*index])).collect()
    };
    let searched: Vec<Vec<Vec<usize>>> =
        (1..=more).map(|more| sets(&parameters, base.set.len() + more).iter().map(places).collect()).collect();
    let base_places = places(&base.set);
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
    let share = FALSE_ALARM_RATE / (more + 1) as f64;
    let threshold = |index: usize| {
        let mut gains: Vec<f64> = gains.iter().map(|gains| gains[index]).collect();
        gains.sort_unstable_by(f64::total_cmp);
        gains[RUNS - 1 - (RUNS as f64 * share) as usize]
    };
    Thresholds {
        more: searched.iter().enumerate().map(|(index, sets)| (sets.len(), threshold(index))).collect(),
        offsets: threshold(more),
    }
}

/// Products of whitened columns with themselves and with a residual.
pub(crate) struct Products {
    own: DMatrix<f64>,
    right: DVector<f64>,
}

impl Products {
    pub(crate) fn new(windows: &Windows, noise: &Noise, columns: &DMatrix<f64>, residual: &DVector<f64>) -> Products {
        let white =
            noise.whiten(windows, &joined(columns.clone(), &DMatrix::from_columns(std::slice::from_ref(residual))));
        let columns = white.columns(0, columns.ncols());
        Products { own: columns.tr_mul(&columns), right: columns.tr_mul(&white.column(white.ncols() - 1)) }
    }

    /// Chi2 reduction by these columns: Gaussian elimination that skips linearly dependent columns.
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
