//! The gap between model and measurement as it is told to others (cli.md): the accumulated-angle residual inside consecutive windows
//! of half an hour, each window's first value set to zero, pooled over the gyros.

use serde::Serialize;

use crate::measured::{BLOCK, MeasuredData, Series, TIMING, nodes};

/// Samples of a window, 30 min.
pub const WINDOW: usize = 3600;

/// The gap in numbers.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct ResidualStats {
    /// Root of the mean square.
    pub rms_arcsec: f64,
    /// The largest.
    pub max_arcsec: f64,
    /// Root of the mean square at the windows' ends.
    pub after_30min_arcsec: f64,
    /// χ² of the whitened residual over its degrees of freedom.
    pub reduced_chi2: f64,
    /// Sum of the squares, arcsec².
    #[serde(skip)]
    pub squares: f64,
}

/// The residual of a model at each node, gyro by gyro; NaN where the sum cannot be trusted. Each window starts at zero, and so does
/// what follows a break.
pub fn windowed(measured: &MeasuredData, residual: &dyn Fn(usize, usize) -> f64) -> [Vec<f64>; TIMING] {
    std::array::from_fn(|gyro| {
        let (mut start, mut values) = (f64::NAN, vec![f64::NAN; measured.samples + 1]);
        for (number, block) in measured.blocks[gyro].iter().enumerate() {
            if block.restarts || !block.is_good {
                start = f64::NAN;
            }
            if !block.is_good {
                continue;
            }
            for node in nodes(number) {
                let value = residual(gyro, node);
                if (node - 1) % WINDOW == 0 || start.is_nan() {
                    start = value;
                }
                values[node] = value - start;
            }
        }
        values
    })
}

/// The gap of a windowed residual; `reduced_chi2` is left at 0.
pub fn of(windowed: &[Vec<f64>; TIMING]) -> ResidualStats {
    let (mut squares, mut count, mut max) = (0.0, 0usize, 0.0f64);
    let (mut end_squares, mut ends) = (0.0, 0usize);
    for gyro in windowed {
        for (node, value) in gyro.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
            squares += value * value;
            count += 1;
            max = max.max(value.abs());
            if node % WINDOW == 0 {
                end_squares += value * value;
                ends += 1;
            }
        }
    }
    let mean = |squares: f64, count: usize| (squares / count.max(1) as f64).sqrt();
    ResidualStats {
        rms_arcsec: mean(squares, count),
        max_arcsec: max,
        after_30min_arcsec: mean(end_squares, ends),
        reduced_chi2: 0.0,
        squares,
    }
}

/// Residual at each node of a model that was run.
pub fn residual<'a>(measured: &'a MeasuredData, model: &'a Series) -> impl Fn(usize, usize) -> f64 + 'a {
    |gyro, node| measured.counts.accumulated[gyro][node] - model[gyro][node]
}

/// A value told at the middles of blocks, at a node between or beyond them: straight lines.
pub fn at_node(blocks: &[f64], node: usize) -> f64 {
    if blocks.len() < 2 {
        return blocks.first().copied().unwrap_or(0.0);
    }
    // The middle of a block lies half a node after its fifth.
    let place = (node as f64 - 0.5 - 0.5 * BLOCK as f64) / BLOCK as f64;
    let before = (place.max(0.0) as usize).min(blocks.len() - 2);
    blocks[before] + (blocks[before + 1] - blocks[before]) * (place - before as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_straight_over_blocks_is_straight_over_nodes() {
        // Averages of the node numbers 1…10, 11…20, 21…30.
        let blocks = [5.5, 15.5, 25.5];
        for node in [1, 5, 6, 17, 30] {
            assert!((at_node(&blocks, node) - node as f64).abs() < 1e-9, "{node}");
        }
    }

    #[test]
    fn numbers_of_a_gap_are_those_worked_out_by_hand() {
        let mut gyro = vec![f64::NAN; WINDOW + 1];
        (gyro[1], gyro[2], gyro[WINDOW]) = (0.0, 3.0, -4.0);
        let gap = of(&[gyro, vec![], vec![], vec![]]);
        assert_eq!((gap.squares, gap.max_arcsec, gap.after_30min_arcsec), (25.0, 4.0, 4.0));
        assert!((gap.rms_arcsec - (25.0f64 / 3.0).sqrt()).abs() < 1e-12);
    }
}
