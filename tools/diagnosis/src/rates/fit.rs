//! Errors fitted to windows by least squares of the whitened residual, iterated from where they are believed.

use nalgebra::{DMatrix, DVector};

use crate::rates::model::{Parameter, residual};
use crate::rates::noise::Noise;
use crate::rates::windows::Windows;

const STEPS: usize = 200;
/// Of a sigma: a step that is smaller ends the search.
const END: f64 = 1e-4;
/// Of the diagonal, damping at the start, and where it is given up.
const DAMPING: f64 = 1e-4;
const MOST_DAMPING: f64 = 1e10;

/// A set of errors at the values that fit best.
#[derive(Debug, Clone)]
pub(crate) struct Fit {
    pub(crate) set: Vec<Parameter>,
    pub(crate) values: Vec<f64>,
    /// χ² of the whitened residual.
    pub(crate) chi2: f64,
}

impl Fit {
    /// No errors at all.
    pub(crate) fn none() -> Fit {
        Fit { set: Vec::new(), values: Vec::new(), chi2: 0.0 }
    }

    /// The value of an error, 0 of one that is not in the set.
    pub(crate) fn value(&self, parameter: Parameter) -> f64 {
        self.set.iter().position(|other| *other == parameter).map_or(0.0, |place| self.values[place])
    }

    /// The residual and its derivative by each of these errors, without any other.
    pub(crate) fn linearised(&self, windows: &Windows, parameters: &[Parameter]) -> (DVector<f64>, DMatrix<f64>) {
        let values: Vec<f64> = parameters.iter().map(|parameter| self.value(*parameter)).collect();
        residual(windows, parameters, &values)
    }

    /// The residual that it leaves of these windows.
    pub(crate) fn residual(&self, windows: &Windows) -> DVector<f64> {
        residual(windows, &self.set, &self.values).0
    }

    /// The covariance of its values.
    pub(crate) fn covariance(&self, windows: &Windows, noise: &Noise) -> Option<DMatrix<f64>> {
        let (_, slope) = self.linearised(windows, &self.set);
        let white = noise.whiten(windows, &slope);
        inverse(&white.tr_mul(&white))
    }
}

/// The inverse of a matrix of products; nothing where it is singular.
pub(crate) fn inverse(products: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    if products.is_empty() {
        return Some(products.clone());
    }
    let scale = products.diagonal().map(|own| if own > 0.0 { own.sqrt().recip() } else { 0.0 });
    if scale.iter().any(|scale| *scale == 0.0 || !scale.is_finite()) {
        return None;
    }
    let scale = DMatrix::from_diagonal(&scale);
    let scaled = &scale * products * &scale;
    let eigen = scaled.clone().symmetric_eigen();
    // Beyond what rounding leaves of a column that is the sum of others.
    if eigen.eigenvalues.iter().any(|value| *value < 1e-12) {
        return None;
    }
    Some(&scale * scaled.cholesky()?.inverse() * &scale)
}

/// Fits a set, starting from the values of `start` (0 for others). Nothing where the data do not determine it within its
/// limits.
pub(crate) fn fit(windows: &Windows, noise: &Noise, set: &[Parameter], start: Option<&Fit>) -> Option<Fit> {
    let begin = |parameter: &Parameter| start.map_or(0.0, |start| start.value(*parameter));
    let mut values: Vec<f64> = set.iter().map(begin).collect();
    let limits: Vec<f64> = set.iter().map(|parameter| parameter.limit(windows)).collect();
    let white = |values: &[f64]| {
        let (residual, slope) = residual(windows, set, values);
        let white = noise.whiten(windows, &beside(slope, &residual));
        (white.column(set.len()).into_owned(), white.columns(0, set.len()).into_owned())
    };
    let (mut left, mut slope) = white(&values);
    let mut damping = DAMPING;
    for _ in 0..STEPS {
        if set.is_empty() {
            break;
        }
        let products = slope.tr_mul(&slope);
        inverse(&products)?;
        let downhill = -slope.tr_mul(&left);
        let damped = &products + DMatrix::from_diagonal(&(products.diagonal() * damping));
        let step = damped.cholesky()?.solve(&downhill);
        // In sigmas of each alone: what the others leave is larger.
        let is_small = step.iter().zip(products.diagonal().iter()).all(|(step, own)| step.abs() * own.sqrt() < END);
        let next: Vec<f64> = values.iter().zip(step.iter()).map(|(value, step)| value + step).collect();
        let is_within = next.iter().zip(&limits).all(|(value, limit)| value.abs() <= *limit);
        if is_within {
            let (next_left, next_slope) = white(&next);
            if next_left.norm_squared() <= left.norm_squared() {
                (values, left, slope) = (next, next_left, next_slope);
                damping *= 0.1;
                if is_small {
                    break;
                }
                continue;
            }
        }
        if is_small {
            break;
        }
        damping *= 10.0;
        if damping > MOST_DAMPING {
            break;
        }
    }
    // A value at its limit is none that the data chose.
    let is_free = values.iter().zip(&limits).all(|(value, limit)| value.abs() < 0.99 * limit);
    let chi2 = left.norm_squared();
    (is_free && chi2.is_finite()).then(|| Fit { set: set.to_vec(), values, chi2 })
}

/// The columns, and one more.
pub(crate) fn beside(columns: DMatrix<f64>, last: &DVector<f64>) -> DMatrix<f64> {
    joined(columns, &DMatrix::from_column_slice(last.len(), 1, last.as_slice()))
}

/// The columns of both.
pub(crate) fn joined(columns: DMatrix<f64>, others: &DMatrix<f64>) -> DMatrix<f64> {
    let count = columns.ncols();
    let mut columns = columns.insert_columns(count, others.ncols(), 0.0);
    columns.columns_mut(count, others.ncols()).copy_from(others);
    columns
}

/// All sets of `size` of the parameters.
pub(crate) fn sets(parameters: &[Parameter], size: usize) -> Vec<Vec<Parameter>> {
    match (size, parameters) {
        (0, _) => vec![Vec::new()],
        (_, []) => Vec::new(),
        (_, [first, others @ ..]) => {
            let with = sets(others, size - 1).into_iter().map(|rest| [vec![*first], rest].concat());
            with.chain(sets(others, size)).collect()
        }
    }
}

/// Cosine of two columns once others are projected out of both; 0 where nothing is left of one.
pub(crate) fn cosine(white: &DMatrix<f64>, one: usize, other: usize, beside: &[usize]) -> f64 {
    let others = DMatrix::from_fn(white.nrows(), beside.len(), |row, column| white[(row, beside[column])]);
    let none = DMatrix::zeros(white.nrows(), 0);
    let basis = if beside.is_empty() { none } else { others.svd(true, false).u.unwrap_or(none) };
    let left = |column: usize| {
        let column = white.column(column);
        column - &basis * basis.tr_mul(&column)
    };
    let (one, other) = (left(one), left(other));
    let norms = one.norm() * other.norm();
    if norms > 0.0 { (one.dot(&other) / norms).clamp(-1.0, 1.0) } else { 0.0 }
}
