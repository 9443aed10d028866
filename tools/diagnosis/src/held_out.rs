//! The gap held out: each third as a fit to the other two foretells it.

use geu_model::package::Calibration;
use geu_protocol::Gyro;

use crate::amplitude::calibration_parameters;
use crate::entries::LAG_S;
use crate::gap::{self, ResidualStats};
use crate::measured::{BLOCK, CHANNELS, Series, TIMING};
use crate::normal::{NormalEquations, THIRDS};
use crate::state::{DiagnosisCase, ModelState};

/// How well calibration numbers hold between checkouts, in the order of [`Calibration::NUMBERS`]: 20 ppm and 6″/h are what a
/// calibration is for (Casteren §1, table 1), 3″ how well pivots let an axis be known (§5.3).
const HOLDS: [f64; Calibration::NUMBERS.len()] = [20e-6, 6.0 / 7200.0, 3.0, 3.0, 3.0];

/// The gap of a model that was run, with χ² by a state's noise.
pub fn fitted(
    case: &DiagnosisCase,
    windowed: &[Vec<f64>; TIMING],
    model: &Series,
    state: &ModelState,
) -> ResidualStats {
    let residual = case.measured.residual(model);
    let white = NormalEquations::new(case.whitenings(&state.noise), &residual, &[]);
    let squares: f64 = white.residual()[..TIMING].iter().flatten().map(|value| value * value).sum();
    let count: usize = white.residual()[..TIMING].iter().flatten().filter(|value| **value != 0.0).count();
    ResidualStats { reduced_chi2: squares / count.max(1) as f64, ..gap::of(windowed) }
}

/// The gap of each third, with everything that is fitted taken from the other two.
pub fn held_out(case: &DiagnosisCase, state: &ModelState) -> ResidualStats {
    let (measured, state) = (case.measured, &mut state.clone());
    let model = measured.run(&state.configuration(case.believed), state.shifts);
    let (residual, columns) = case.linearised(state);
    let normal = NormalEquations::departed(case.whitenings(&state.noise), &residual, &columns, &state.sixteen);
    let blocks = measured.block_count();
    let mut corrections: Series = std::array::from_fn(|_| vec![0.0; blocks]);
    let mut squares = 0.0;
    for (third, size) in normal.without_thirds(&known(state, case.nuisances.len())).into_iter().enumerate() {
        let range = blocks * third / THIRDS..blocks * (third + 1) / THIRDS;
        let mut own: Series = std::array::from_fn(|channel| residual[channel].clone());
        for (column, size) in columns.iter().zip(&size) {
            for channel in 0..CHANNELS {
                let Some(values) = &column[channel] else { continue };
                for block in 0..blocks {
                    own[channel][block] -= size * values[block];
                }
                for block in range.clone() {
                    corrections[channel][block] += size * values[block];
                }
            }
        }
        let white = NormalEquations::new(case.whitenings(&state.noise), &own, &[]);
        squares +=
            white.residual()[..TIMING].iter().flat_map(|values| &values[range.clone()]).map(|v| v * v).sum::<f64>();
    }
    let count = normal.residual()[..TIMING].iter().flatten().filter(|value| **value != 0.0).count();
    // Where one third ends and the next begins another fit holds: each window starts anew there.
    let thirds: Vec<usize> = (0..=THIRDS).map(|third| blocks * third / THIRDS).collect();
    let plain = gap::residual(measured, &model);
    let of = |gyro: usize, node: usize| {
        let block = ((node - 1) / BLOCK).min(blocks - 1);
        let third = thirds.iter().rposition(|&start| start <= block).unwrap_or(0).min(THIRDS - 1);
        let own = &corrections[gyro][thirds[third]..thirds[third + 1]];
        plain(gyro, node) - gap::at_node(own, node - thirds[third] * BLOCK)
    };
    let mut windowed = gap::windowed(measured, &of);
    for gyro in &mut windowed {
        for &start in &thirds[1..THIRDS] {
            let first = 1 + start * BLOCK;
            let end = (first - 1).next_multiple_of(gap::WINDOW).min(gyro.len() - 1);
            let at_first = gyro.get(first).copied().unwrap_or(f64::NAN);
            if !at_first.is_nan() && !(first - 1).is_multiple_of(gap::WINDOW) {
                gyro[first..=end].iter_mut().for_each(|value| *value -= at_first);
            }
        }
    }
    ResidualStats { reduced_chi2: squares / count.max(1) as f64, ..gap::of(&windowed) }
}

/// What is known of the sixteen, and of the lag where it is fitted, before a recording, as departures from a state: a calibration holds
/// for as long as [`HOLDS`] says, and where it has plainly not held, as much as it was off.
fn known(state: &ModelState, nuisances: usize) -> Vec<(f64, f64)> {
    let of_number = |((_, number), moved): ((Gyro, usize), &f64)| (-moved, HOLDS[number].max(moved.abs()));
    let sixteen = calibration_parameters().into_iter().zip(&state.sixteen).map(of_number);
    let lag = (-state.shifts.lag_s, LAG_S.max(state.shifts.lag_s.abs()));
    sixteen.chain(std::iter::once(lag)).take(nuisances).collect()
}
