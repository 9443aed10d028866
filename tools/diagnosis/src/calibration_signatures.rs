//! Signatures of the calibration parameters and of a common lag, and the grid of these on which the model runs.

use geu_model::Configuration;
use rayon::prelude::*;

use crate::measured::{MeasuredData, Series, Shifts};
use crate::normal_equations::Nuisance;
use geu_hypothesis::CalibrationParameter;

/// Shift for the signature of a common lag.
const LAG_S: f64 = 1e-3;
/// Changes of scale factor, drift and projection for their signatures: a ten-thousandth of their ranges.
const CHANGES: [f64; 3] = [1.5e-4, 2e-3, 0.72];
/// The model runs at calibration parameters on a grid of these steps, in the same order, and at lags on a grid of [`LAG_GRID`]; between,
/// it is linear. Half a step of a scale factor is 15 ppm: its square is 0.0003″ of a turn. Drift and misalignment are linear but for
/// their products with it. Runs then repeat, and a change on one gyro counts that gyro alone.
const GRID: [f64; 3] = [3e-5, 2e-3, 30.0];
/// Share of a block, of the default unit 0.01 s: half of it, squared, times half an acceleration of 36″/s² is 0.0005″.
const LAG_GRID: f64 = 0.002;

/// Signatures of the calibration parameters and of a common lag at a configuration.
pub fn nuisances(measured: &MeasuredData, configuration: &Configuration, shifts: Shifts) -> Vec<Nuisance> {
    let from = measured.run(configuration, shifts);
    let parameters = CalibrationParameter::all(&configuration.device);
    let heads = measured.gyros().heads();
    // One parameter of each gyro at a time.
    let moved = |number: usize| {
        let mut moved = configuration.clone();
        let own = || parameters.iter().skip(number).step_by(parameters.len() / heads);
        for (parameter, gyro) in own().zip(&mut moved.gyros) {
            parameter.add(&mut gyro.calibration, parameter.of_kind(CHANGES));
        }
        let mut series = measured.difference(&measured.run(&moved, shifts), &from);
        for (parameter, series) in own().zip(&mut series) {
            series.iter_mut().for_each(|value| *value /= parameter.of_kind(CHANGES));
        }
        series
    };
    let series: Vec<Series> = (0..parameters.len() / heads).into_par_iter().map(moved).collect();
    let of_parameter = |(place, parameter): (usize, &CalibrationParameter)| -> Nuisance {
        let own = &series[place % series.len()];
        std::array::from_fn(|channel| (channel == parameter.gyro.index()).then(|| own[channel].clone()))
    };
    let mut nuisances: Vec<Nuisance> = parameters.iter().enumerate().map(of_parameter).collect();
    let late = Shifts { lag_s: shifts.lag_s + LAG_S, ..shifts };
    let mut lag = measured.difference(&measured.run(configuration, late), &from);
    lag.iter_mut().flatten().for_each(|value| *value /= LAG_S);
    nuisances.push(std::array::from_fn(|channel| (channel < heads).then(|| std::mem::take(&mut lag[channel]))));
    nuisances
}

/// The next point of the grid through `origin`: calibration parameters in their order, then the lag.
pub fn on_grid(values: &[f64], origin: &[f64], parameters: &[CalibrationParameter], block_s: f64) -> Vec<f64> {
    let steps = parameters.iter().map(|parameter| parameter.of_kind(GRID)).chain([LAG_GRID * block_s]);
    let next = |((value, origin), step): ((&f64, &f64), f64)| origin + ((value - origin) / step).round() * step;
    values.iter().zip(origin).zip(steps).map(next).collect()
}
