//! Residual statistics held out: each third as predicted by a fit to the other two.

use crate::diagnosis_case::DiagnosisCase;
use crate::measured::{BLOCK, CHANNELS, ModelRun, Series, TIMING};
use crate::model_state::{LAG_S, ModelState};
use crate::normal_equations::{NormalEquations, THIRDS};
use crate::residual_stats::{self, ResidualStats, WINDOW};

/// A priori sigmas of scale factor, drift and projection of the default unit between checkouts, as shares of those after launch: a
/// calibration corrects errors of 20 ppm and 6″/h (Casteren §1, table 1); pivots limit the knowledge of an axis to 3″ (§5.3).
const BETWEEN_CHECKOUTS: f64 = 0.01;

/// Sum of the squares of whitened values.
fn squares<'a>(white: impl Iterator<Item = &'a f64>) -> f64 {
    white.map(|value| value * value).sum()
}

/// Number of whitened values with information: others are exactly 0.
fn count(white: &NormalEquations) -> f64 {
    white.residual[..TIMING].iter().flatten().filter(|value| **value != 0.0).count().max(1) as f64
}

/// Statistics of a model's windowed residual, with χ² by the noise of `state`.
pub fn fitted(
    case: &DiagnosisCase,
    windowed: &[Vec<f64>; TIMING],
    model: &ModelRun,
    state: &ModelState,
) -> ResidualStats {
    let reduced_chi2 = reduced_chi2(case, model, state);
    ResidualStats { reduced_chi2, ..ResidualStats::from_windowed(windowed) }
}

/// χ² of a model's whitened residual over its degrees of freedom, by the noise of `state`.
pub fn reduced_chi2(case: &DiagnosisCase, model: &ModelRun, state: &ModelState) -> f64 {
    let white = NormalEquations::new(case.whitenings(&state.noise), &case.measured.residual(model), &[], &[]);
    squares(white.residual[..TIMING].iter().flatten()) / count(&white)
}

/// Statistics of each third's residual with all fitted parameters from the other two.
pub fn held_out(case: &DiagnosisCase, state: &ModelState) -> ResidualStats {
    let (measured, state) = (case.measured, &mut state.clone());
    let model = case.run(state);
    let (residual, columns) = case.linearised(state);
    let normal =
        NormalEquations::new(case.whitenings(&state.noise), &residual, &columns, &case.a_priori(&state.calibration));
    let blocks = measured.block_count();
    let bounds: Vec<usize> = (0..=THIRDS).map(|third| blocks * third / THIRDS).collect();
    let mut corrections: Series = std::array::from_fn(|_| vec![0.0; blocks]);
    let mut chi2 = 0.0;
    let a_priori = a_priori(case, state);
    for third in 0..THIRDS {
        let range = bounds[third]..bounds[third + 1];
        let mut own: Series = residual.clone();
        for (column, size) in columns.iter().zip(&normal.fit_without_third(third, &a_priori)) {
            for channel in 0..CHANNELS {
                let Some(values) = &column[channel] else { continue };
                own[channel].iter_mut().zip(values).for_each(|(own, value)| *own -= size * value);
                let correction = &mut corrections[channel][range.clone()];
                correction.iter_mut().zip(&values[range.clone()]).for_each(|(own, value)| *own += size * value);
            }
        }
        let white = NormalEquations::new(case.whitenings(&state.noise), &own, &[], &[]);
        chi2 +=
            squares(white.residual[..TIMING].iter().flat_map(|values| values.get(range.clone()).unwrap_or_default()));
    }
    // Each third has its own fit, so that a window starts at its first node.
    let plain = residual_stats::residual(measured, &model);
    let of_node = |gyro: usize, node: usize| {
        let block = ((node - 1) / BLOCK).min(blocks - 1);
        let third = bounds.iter().rposition(|&start| start <= block).unwrap_or(0).min(THIRDS - 1);
        let own = &corrections[gyro][bounds[third]..bounds[third + 1]];
        plain(gyro, node) - residual_stats::at_node(own, node - bounds[third] * BLOCK)
    };
    let mut windowed = residual_stats::windowed(measured, of_node);
    for gyro in windowed.iter_mut().filter(|gyro| !gyro.is_empty()) {
        for &start in &bounds[1..THIRDS] {
            let first = 1 + start * BLOCK;
            let end = (first - 1).next_multiple_of(WINDOW).min(gyro.len() - 1);
            let at_first = gyro.get(first).copied().unwrap_or(f64::NAN);
            if !at_first.is_nan() && !(first - 1).is_multiple_of(WINDOW) {
                gyro[first..=end].iter_mut().for_each(|value| *value -= at_first);
            }
        }
    }
    ResidualStats { reduced_chi2: chi2 / count(&normal), ..ResidualStats::from_windowed(&windowed) }
}

/// Value and sigma of the calibration parameters before a recording, and of the lag if it is fitted, relative to the state. The sigma
/// is that between checkouts, or the estimated departure if that is larger.
fn a_priori(case: &DiagnosisCase, state: &ModelState) -> Vec<(f64, f64)> {
    let share = if case.nominal.device.is_iras() { BETWEEN_CHECKOUTS } else { 1.0 };
    let calibration = case.a_priori(&state.calibration);
    let calibration = calibration.into_iter().map(|(moved, sigma)| (-moved, (share * sigma).max(moved.abs())));
    let lag = (-state.shifts.lag_s, LAG_S.max(state.shifts.lag_s.abs()));
    calibration.chain(std::iter::once(lag)).take(case.nuisances.len()).collect()
}
