//! Fit of errors to windows: iterated minimisation of the whitened residual.

use nalgebra::{DMatrix, DVector};

use crate::model::{Parameter, residual};
use crate::noise::Noise;
use crate::windows::Windows;

const MAX_STEPS: usize = 200;
/// Step in sigmas below which the fit has converged.
const CONVERGED: f64 = 1e-4;
/// Initial and largest damping, as a share of the diagonal.
const DAMPING: f64 = 1e-4;
const MAX_DAMPING: f64 = 1e10;
/// Smallest eigenvalue of the scaled normal matrix: rounding of linearly dependent columns stays below.
const MIN_EIGENVALUE: f64 = 1e-12;
/// A value beyond this share of its limit is not determined by the data.
const LIMIT_SHARE: f64 = 0.99;

/// A set of errors with the best values.
#[derive(Debug, Clone)]
pub(crate) struct Fit {
    pub(crate) set: Vec<Parameter>,
    pub(crate) values: Vec<f64>,
    /// χ² of the whitened residual.
    pub(crate) chi2: f64,
}

impl Fit {
    /// Without any error.
    pub(crate) fn none() -> Fit {
        Fit { set: Vec::new(), values: Vec::new(), chi2: 0.0 }
    }

    /// Value of an error, 0 if it is not in the set.
    pub(crate) fn value(&self, parameter: Parameter) -> f64 {
        self.set.iter().position(|other| *other == parameter).map_or(0.0, |place| self.values[place])
    }

    /// The residual with `parameters` at their values in this fit, and its derivative by each of them.
    pub(crate) fn linearised(&self, windows: &Windows, parameters: &[Parameter]) -> (DVector<f64>, DMatrix<f64>) {
        let values: Vec<f64> = parameters.iter().map(|parameter| self.value(*parameter)).collect();
        residual(windows, parameters, &values)
    }

    /// The residual of these windows.
    pub(crate) fn residual(&self, windows: &Windows) -> DVector<f64> {
        residual(windows, &self.set, &self.values).0
    }

    /// χ² of these windows.
    pub(crate) fn chi2_of(&self, windows: &Windows, noise: &Noise) -> f64 {
        noise.whiten(windows, &DMatrix::from_columns(&[self.residual(windows)])).norm_squared()
    }

    /// Covariance of the values.
    pub(crate) fn covariance(&self, windows: &Windows, noise: &Noise) -> Option<DMatrix<f64>> {
        let (_, slope) = self.linearised(windows, &self.set);
        let white = noise.whiten(windows, &slope);
        inverse(&white.tr_mul(&white))
    }
}

/// Inverse of a normal matrix; `None` if it is singular.
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
    if scaled.clone().symmetric_eigen().eigenvalues.iter().any(|value| *value < MIN_EIGENVALUE) {
        return None;
    }
    Some(&scale * scaled.cholesky()?.inverse() * &scale)
}

/// Fits a set of errors, starting from their values in `start` (0 for the others). `None` if the data do not determine it within its
/// limits.
pub(crate) fn fit(windows: &Windows, noise: &Noise, set: &[Parameter], start: &Fit) -> Option<Fit> {
    let mut values: Vec<f64> = set.iter().map(|parameter| start.value(*parameter)).collect();
    let limits: Vec<f64> = set.iter().map(|parameter| parameter.limit(windows)).collect();
    let white = |values: &[f64]| {
        let (residual, slope) = residual(windows, set, values);
        let white = noise.whiten(windows, &joined(slope, &DMatrix::from_columns(&[residual])));
        (white.column(set.len()).into_owned(), white.columns(0, set.len()).into_owned())
    };
    let (mut left, mut slope) = white(&values);
    let mut damping = DAMPING;
    for _ in 0..MAX_STEPS {
        if set.is_empty() {
            break;
        }
        let products = slope.tr_mul(&slope);
        inverse(&products)?;
        let downhill = -slope.tr_mul(&left);
        let damped = &products + DMatrix::from_diagonal(&(products.diagonal() * damping));
        let step = damped.cholesky()?.solve(&downhill);
        // Sigma of each error alone: smaller than with the others free.
        let is_small =
            step.iter().zip(products.diagonal().iter()).all(|(step, own)| step.abs() * own.sqrt() < CONVERGED);
        let next: Vec<f64> = values.iter().zip(step.iter()).map(|(value, step)| value + step).collect();
        let is_within = next.iter().zip(&limits).all(|(value, limit)| value.abs() <= *limit);
        let better = is_within.then(|| white(&next)).filter(|(next, _)| next.norm_squared() <= left.norm_squared());
        match better {
            Some(better) => {
                (left, slope) = better;
                values = next;
                damping *= 0.1;
            }
            None => damping *= 10.0,
        }
        if is_small || damping > MAX_DAMPING {
            break;
        }
    }
    let is_free = values.iter().zip(&limits).all(|(value, limit)| value.abs() < LIMIT_SHARE * limit);
    let chi2 = left.norm_squared();
    (is_free && chi2.is_finite()).then(|| Fit { set: set.to_vec(), values, chi2 })
}

/// The columns of both matrices.
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

/// Cosine of two columns after projecting out the columns `nuisances`; 0 if a projection vanishes.
pub(crate) fn cosine(white: &DMatrix<f64>, one: usize, other: usize, nuisances: &[usize]) -> f64 {
    let empty = DMatrix::zeros(white.nrows(), 0);
    let basis = match nuisances {
        [] => empty,
        _ => white.select_columns(nuisances).svd(true, false).u.unwrap_or(empty),
    };
    let left = |column: usize| {
        let column = white.column(column);
        column - &basis * basis.tr_mul(&column)
    };
    let (one, other) = (left(one), left(other));
    let norms = one.norm() * other.norm();
    if norms > 0.0 { (one.dot(&other) / norms).clamp(-1.0, 1.0) } else { 0.0 }
}
