//! Products of series and scaled Cholesky factors.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// The scale that makes a diagonal one; 0 where the diagonal is 0.
pub(crate) fn inverse_roots(diagonal: &DVector<f64>) -> DVector<f64> {
    diagonal.map(|own| if own > 0.0 { 1.0 / own.sqrt() } else { 0.0 })
}

/// Cholesky factor of a matrix scaled to a diagonal of ones, plus `ridge`.
pub(crate) fn factored(gram: &DMatrix<f64>, scale: &DVector<f64>, ridge: f64) -> Cholesky<f64, Dyn> {
    let scaled = DMatrix::from_fn(gram.nrows(), gram.ncols(), |i, j| {
        gram[(i, j)] * scale[i] * scale[j] + if i == j { ridge + f64::from(u8::from(scale[i] == 0.0)) } else { 0.0 }
    });
    // Rounding may make a singular matrix slightly indefinite.
    Cholesky::new(scaled.clone())
        .or_else(|| Cholesky::new(&scaled + DMatrix::identity(gram.nrows(), gram.ncols()) * 1e-6))
        .unwrap_or_else(|| Cholesky::new(DMatrix::identity(gram.nrows(), gram.ncols())).expect("positive"))
}

pub(crate) fn lower(factor: &Cholesky<f64, Dyn>, right: &DVector<f64>) -> DVector<f64> {
    factor.l_dirty().solve_lower_triangular(right).expect("a diagonal without zeros")
}

/// Products of the increments of two series: of both, of the first, and of the second with itself. Increments remove constant and slow
/// parts, which would outweigh the others.
pub(crate) fn increment_products(one: &[f64], other: &[f64]) -> [f64; 3] {
    let increments = |values: &[f64]| -> Vec<f64> { values.windows(2).map(|pair| pair[1] - pair[0]).collect() };
    let (one, other) = (increments(one), increments(other));
    [dot(&one, &other), dot(&one, &one), dot(&other, &other)]
}

pub(crate) fn dot(one: &[f64], other: &[f64]) -> f64 {
    let [product] = dots(one, [other]);
    product
}

/// Products of one series with several.
pub(crate) fn dots<const COUNT: usize>(one: &[f64], others: [&[f64]; COUNT]) -> [f64; COUNT] {
    // Four sums for each, so that the processor need not wait for one.
    let mut sums = [[0.0; 4]; COUNT];
    let length = others.iter().fold(one.len(), |length, other| length.min(other.len()));
    let (ones, ones_rest) = one[..length].as_chunks::<4>();
    let others = others.map(|other| other[..length].as_chunks::<4>());
    for (place, a) in ones.iter().enumerate() {
        for (sums, (others, _)) in sums.iter_mut().zip(&others) {
            let b = &others[place];
            for lane in 0..4 {
                sums[lane] += a[lane] * b[lane];
            }
        }
    }
    std::array::from_fn(|place| {
        let rest: f64 = ones_rest.iter().zip(others[place].1).map(|(a, b)| a * b).sum();
        sums[place].iter().sum::<f64>() + rest
    })
}
