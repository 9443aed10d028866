//! Signatures of the calibration parameters and of a common lag, and the grid of these on which the model runs.

use geu_model::Configuration;
use geu_model::package::Calibration;
use geu_model::parameter_spec::ParameterSet;
use rayon::prelude::*;

use crate::measured::{MeasuredData, Series, Shifts, TIMING};
use crate::normal_equations::Nuisance;
use geu_hypothesis::amplitude::calibration_parameters;

/// Shift for the signature of a common lag.
const LAG_S: f64 = 1e-3;
/// Share of a calibration parameter's range by which it is changed for its signature.
const SHARE: f64 = 1e-4;
/// The model runs at calibration parameters on a grid of these steps, in their units, and at lags on a grid of [`LAG_GRID_S`]; between,
/// it is linear. Half a step of a scale factor is 15 ppm: its square is 0.0003″ of a turn. Drift and misalignment are linear but for
/// their products with it. Runs then repeat, and a change on one gyro counts that gyro alone.
const GRID: [f64; Calibration::NUMBERS.len()] = [3e-5, 2e-3, 30.0, 30.0, 30.0];
/// Half of it, squared, times half an acceleration of 36″/s² is 0.0005″.
const LAG_GRID_S: f64 = 0.01;

/// Signatures of the calibration parameters and of a common lag at a configuration.
pub fn nuisances(measured: &MeasuredData, configuration: &Configuration, shifts: Shifts) -> Vec<Nuisance> {
    let from = measured.run(configuration, shifts);
    let numbers = Calibration::NUMBERS;
    let moved = |number: usize| {
        let size = SHARE * (numbers[number].max - numbers[number].min);
        let mut moved = configuration.clone();
        for gyro in &mut moved.gyros {
            *gyro.calibration.value_mut(number) += size;
        }
        let mut series = measured.difference(&measured.run(&moved, shifts), &from);
        series.iter_mut().flatten().for_each(|value| *value /= size);
        series
    };
    let series: Vec<Series> = (0..numbers.len()).into_par_iter().map(moved).collect();
    let of_gyro = |(gyro, number): (geu_protocol::Gyro, usize)| -> Nuisance {
        std::array::from_fn(|channel| (channel == gyro.index()).then(|| series[number][channel].clone()))
    };
    let mut nuisances: Vec<Nuisance> = calibration_parameters().into_iter().map(of_gyro).collect();
    let late = Shifts { lag_s: shifts.lag_s + LAG_S, ..shifts };
    let mut lag = measured.difference(&measured.run(configuration, late), &from);
    lag.iter_mut().flatten().for_each(|value| *value /= LAG_S);
    nuisances.push(std::array::from_fn(|channel| (channel != TIMING).then(|| std::mem::take(&mut lag[channel]))));
    nuisances
}

/// The next point of the grid through `origin`: calibration parameters in their order, then the lag.
pub fn on_grid(values: &[f64], origin: &[f64]) -> Vec<f64> {
    let steps = calibration_parameters().into_iter().map(|(_, number)| GRID[number]).chain([LAG_GRID_S]);
    let next = |((value, origin), step): ((&f64, &f64), f64)| origin + ((value - origin) / step).round() * step;
    values.iter().zip(origin).zip(steps).map(next).collect()
}
