//! The gap between model and measurement as reported: the residual of the accumulated angle in consecutive windows of half an
//! hour, relative to each window's first value, pooled over the gyros.

use std::ops::Range;

use serde::Serialize;

use crate::measured::{BLOCK, Block, MeasuredData, ModelRun, Series, TIMING};

/// Nodes of a window, of the default unit 30 min.
pub const WINDOW: usize = 3600;

/// Statistics of a residual.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct ResidualStats {
    /// Root mean square.
    pub rms_arcsec: f64,
    /// Largest absolute value.
    pub max_arcsec: f64,
    /// Root mean square at the windows' ends.
    pub after_30min_arcsec: f64,
    /// χ² of the whitened residual over its degrees of freedom.
    pub reduced_chi2: f64,
}

impl ResidualStats {
    /// Statistics of a windowed residual; `reduced_chi2` is 0.
    pub fn from_windowed(windowed: &[Vec<f64>; TIMING]) -> ResidualStats {
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
        let rms = |squares: f64, count: usize| (squares / count.max(1) as f64).sqrt();
        ResidualStats {
            rms_arcsec: rms(squares, count),
            max_arcsec: max,
            after_30min_arcsec: rms(end_squares, ends),
            reduced_chi2: 0.0,
        }
    }
}

/// Squared gap of each gyro: of the windowed residual, or about the mean of each window against the rows of a smoothed reference. The
/// smoothed motion itself contains what the gyros sense wrong within a minute.
pub fn squares(measured: &MeasuredData, model: &ModelRun) -> [f64; TIMING] {
    if measured.smoothed.is_none() {
        return windowed(measured, residual(measured, model)).each_ref().map(|gyro| squares_of(gyro));
    }
    let averages = measured.residual(model);
    std::array::from_fn(|gyro| squares_about(mean, &averages[gyro], &measured.blocks[gyro]))
}

/// The squared gap of all gyros from block averages of the residual.
pub fn squares_of_blocks(measured: &MeasuredData, averages: &Series) -> f64 {
    let origin = if measured.smoothed.is_some() { mean } else { first };
    (0..TIMING).map(|gyro| squares_about(origin, &averages[gyro], &measured.blocks[gyro])).sum()
}

/// Sum of the squares, in samples, of block averages about the origin of each window; a break starts another window.
fn squares_about(origin: fn(&[f64]) -> f64, averages: &[f64], blocks: &[Block]) -> f64 {
    let is_start = |block: usize| block.is_multiple_of(WINDOW / BLOCK) || blocks[block].restarts;
    let of_window = |range: Range<usize>| {
        let compared: Vec<f64> =
            range.filter(|&block| blocks[block].is_compared).map(|block| averages[block]).collect();
        let origin = origin(&compared);
        compared.iter().map(|value| BLOCK as f64 * (value - origin).powi(2)).sum::<f64>()
    };
    let starts: Vec<usize> = (0..blocks.len()).filter(|&block| is_start(block)).chain([blocks.len()]).collect();
    starts.windows(2).map(|pair| of_window(pair[0]..pair[1])).sum()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn first(values: &[f64]) -> f64 {
    values.first().copied().unwrap_or(0.0)
}

/// Sum of the squares of usable values.
fn squares_of(values: &[f64]) -> f64 {
    values.iter().filter(|value| !value.is_nan()).map(|value| value * value).sum()
}

/// Residual of a model at a gyro and node.
pub fn residual<'a>(measured: &'a MeasuredData, model: &'a ModelRun) -> impl Fn(usize, usize) -> f64 + 'a {
    |gyro, node| measured.counts.accumulated[gyro][node] - model[gyro][node]
}

/// The residual of each gyro at each node, relative to its window's first value.
pub fn windowed(measured: &MeasuredData, residual: impl Fn(usize, usize) -> f64) -> [Vec<f64>; TIMING] {
    let is_start = |node: usize| (node - 1).is_multiple_of(WINDOW);
    let heads = measured.gyros().heads();
    let nodes = |gyro: usize| 0..if gyro < heads { measured.samples + 1 } else { 0 };
    std::array::from_fn(|gyro| relative(measured, gyro, nodes(gyro), |node| residual(gyro, node), is_start))
}

/// The residual of a gyro at each of these nodes, relative to the last start: the first node, the first after a break, and each that
/// `is_start` selects. NaN where the counts are not usable.
pub fn relative(
    measured: &MeasuredData,
    gyro: usize,
    nodes: Range<usize>,
    residual: impl Fn(usize) -> f64,
    is_start: impl Fn(usize) -> bool,
) -> Vec<f64> {
    let mut start = f64::NAN;
    let value = |node: usize| {
        let block = node.checked_sub(1).and_then(|index| measured.blocks[gyro].get(index / BLOCK));
        let Some(block) = block.filter(|block| block.is_good) else {
            start = f64::NAN;
            return f64::NAN;
        };
        let value = residual(node);
        if start.is_nan() || is_start(node) || block.restarts && (node - 1).is_multiple_of(BLOCK) {
            start = value;
        }
        value - start
    };
    nodes.map(value).collect()
}

/// Linear interpolation at a node of values at the middles of blocks, extrapolated at the ends.
pub fn at_node(blocks: &[f64], node: usize) -> f64 {
    if blocks.len() < 2 {
        return blocks.first().copied().unwrap_or(0.0);
    }
    // The middle of a block lies half a node after its fifth.
    let position = (node as f64 - 0.5 - 0.5 * BLOCK as f64) / BLOCK as f64;
    let before = (position.max(0.0) as usize).min(blocks.len() - 2);
    blocks[before] + (blocks[before + 1] - blocks[before]) * (position - before as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn block_averages_of_a_line_interpolate_to_that_line() {
        // Averages of the node numbers 1…10, 11…20, 21…30.
        let blocks = [5.5, 15.5, 25.5];
        for node in [1, 5, 6, 17, 30] {
            assert!((at_node(&blocks, node) - node as f64).abs() < 1e-9, "{node}");
        }
    }

    #[test]
    fn a_jump_at_a_break_and_blocks_without_rows_are_no_gap() {
        let row = Block::COMPARED;
        let no_row = Block { is_compared: false, ..row };
        let broken = Block::BROKEN;
        let blocks = [row, no_row, row, broken, row, row];
        // About 2: 1 and 1; about 100: 2 and 2.
        let averages = [1.0, 50.0, 3.0, 0.0, 98.0, 102.0];
        assert_eq!(squares_about(mean, &averages, &blocks), 10.0 * (1.0 + 1.0 + 4.0 + 4.0));
        assert_eq!(squares_about(first, &averages, &blocks), 10.0 * (0.0 + 4.0 + 0.0 + 16.0));
    }

    #[test]
    fn statistics_equal_values_computed_by_hand() {
        let mut gyro = vec![f64::NAN; WINDOW + 1];
        (gyro[1], gyro[2], gyro[WINDOW]) = (0.0, 3.0, -4.0);
        let gap =
            ResidualStats::from_windowed(&std::array::from_fn(|own| if own == 0 { gyro.clone() } else { Vec::new() }));
        assert_eq!((gap.max_arcsec, gap.after_30min_arcsec), (4.0, 4.0));
        assert!((gap.rms_arcsec - (25.0f64 / 3.0).sqrt()).abs() < 1e-12);
    }
}
