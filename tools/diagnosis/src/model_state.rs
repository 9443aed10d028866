//! Parameters and hypotheses of the model at one point of a diagnosis, and their common fit to the recording: calibration parameters, lag
//! and hypotheses, by Gauss–Newton steps. Each step runs the model from the start.

use std::sync::Arc;

use geu_model::Configuration;
use geu_model::parameter_spec::{ParameterSet, Role};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

pub use crate::fitted_hypothesis::FittedHypothesis;
use crate::linear_signatures::LinearSignatures;
use crate::measured::{CHANNELS, MeasuredData, Series, Shifts, TIMING};
use crate::normal_equations::{NormalEquations, Nuisance};
use crate::rounding::{Rounding, rounding};
use crate::whitening::{NoiseModel, Whitening};
use geu_hypothesis::HypothesisParameter;
use geu_hypothesis::amplitude::calibration_parameters;

/// Shift for the signature of a common lag.
const LAG_S: f64 = 1e-3;
/// Maximum number of Gauss–Newton steps; each runs the model once for every free parameter.
const STEPS: usize = 6;
/// A fit has converged if a step reduces χ² by less.
const CONVERGED: f64 = 0.01;
/// Maximum relative difference between actual and predicted χ² reduction of a linear model.
const LINEAR: f64 = 0.02;
/// Maximum number of halvings of a step.
const HALVINGS: usize = 5;
/// Share of a calibration parameter's range by which it is changed for its signature.
const SHARE: f64 = 1e-4;

/// Values of all parameters.
#[derive(Debug, Clone)]
pub struct ModelState {
    /// Corrections of the calibration parameters, in their order.
    pub calibration: Vec<f64>,
    /// 1 sigma of each.
    pub calibration_sigmas: Vec<f64>,
    /// Time shifts between recording, reference and temperatures.
    pub shifts: Shifts,
    /// 1 sigma of the lag.
    pub lag_sigma_s: f64,
    /// Hypotheses.
    pub held: Vec<FittedHypothesis>,
    /// Noise of each channel.
    pub noise: [NoiseModel; CHANNELS],
}

/// Constant inputs of a diagnosis.
pub struct DiagnosisCase<'a> {
    /// The recording.
    pub measured: &'a MeasuredData,
    /// The input configuration.
    pub nominal: &'a Configuration,
    /// Signatures of the calibration parameters and of the lag.
    pub nuisances: Vec<Nuisance>,
    /// Rounding along the model's path.
    pub rounding: Arc<Rounding>,
    /// Signatures that a fit computes without runs.
    pub linear: LinearSignatures,
}

impl<'a> DiagnosisCase<'a> {
    /// Runs the model for the signatures of the calibration parameters and of a common lag.
    pub fn new(measured: &'a MeasuredData, nominal: &'a Configuration) -> DiagnosisCase<'a> {
        let from = measured.run(nominal, Shifts::default());
        let numbers = geu_model::package::Calibration::NUMBERS;
        let moved = |number: usize| {
            let size = SHARE * (numbers[number].max - numbers[number].min);
            let mut moved = nominal.clone();
            for gyro in &mut moved.gyros {
                *gyro.calibration.value_mut(number) += size;
            }
            let mut series = measured.difference(&measured.run(&moved, Shifts::default()), &from);
            series.iter_mut().flatten().for_each(|value| *value /= size);
            series
        };
        let series: Vec<Series> = (0..numbers.len()).into_par_iter().map(moved).collect();
        let of_gyro = |(gyro, number): (geu_protocol::Gyro, usize)| -> Nuisance {
            std::array::from_fn(|channel| (channel == gyro as usize).then(|| series[number][channel].clone()))
        };
        let mut nuisances: Vec<Nuisance> = calibration_parameters().into_iter().map(of_gyro).collect();
        let mut lag = measured.difference(&measured.run(nominal, Shifts { lag_s: LAG_S, ..Shifts::default() }), &from);
        lag.iter_mut().flatten().for_each(|value| *value /= LAG_S);
        nuisances.push(std::array::from_fn(|channel| (channel != TIMING).then(|| std::mem::take(&mut lag[channel]))));
        let rounding = Arc::new(rounding(measured, &from));
        DiagnosisCase { measured, nominal, nuisances, rounding, linear: LinearSignatures::default() }
    }

    /// The configuration with another recording of the same motion, and only the calibration parameters as nuisances.
    pub fn of_calibration<'b>(&self, measured: &'b MeasuredData) -> DiagnosisCase<'b>
    where
        'a: 'b,
    {
        let (mut nuisances, rounding) = match std::ptr::eq(measured, self.measured) {
            true => (self.nuisances.clone(), self.rounding.clone()),
            false => {
                let other = DiagnosisCase::new(measured, self.nominal);
                (other.nuisances, other.rounding)
            }
        };
        nuisances.truncate(calibration_parameters().len());
        DiagnosisCase { measured, nominal: self.nominal, nuisances, rounding, linear: LinearSignatures::default() }
    }

    /// The initial state.
    pub fn start(&self, noise: [NoiseModel; CHANNELS]) -> ModelState {
        let count = self.nuisances.len() - 1;
        ModelState {
            calibration: vec![0.0; count],
            calibration_sigmas: vec![f64::NAN; count],
            shifts: Shifts::default(),
            lag_sigma_s: f64::NAN,
            held: Vec::new(),
            noise,
        }
    }

    /// Runs the model of a state.
    pub fn run(&self, state: &ModelState) -> Series {
        self.measured.run(&state.configuration(self.nominal), state.shifts)
    }

    /// Block averages of the residual of a state.
    pub fn residual(&self, state: &ModelState) -> Series {
        self.measured.residual(&self.run(state))
    }

    /// Whitening filters of a noise.
    pub fn whitenings(&self, noise: &[NoiseModel; CHANNELS]) -> [Whitening; CHANNELS] {
        std::array::from_fn(|channel| {
            Whitening::new(&noise[channel], &self.measured.blocks[channel], &self.rounding[channel])
        })
    }

    /// The residual, and the signatures of all fitted parameters: nuisances, then the free parameters. Missing signatures are run and
    /// kept in the state.
    pub fn linearised(&self, state: &mut ModelState) -> (Series, Vec<Nuisance>) {
        let from = self.run(state);
        let missing = |held: usize| {
            let own = &state.held[held];
            let free = (0..own.is_free.len()).into_par_iter().filter(|&index| own.is_free[index]);
            let run = || Arc::new(free.map(|index| self.column(state, &from, held, index)).collect());
            own.columns.clone().unwrap_or_else(run)
        };
        let columns: Vec<Arc<Vec<Nuisance>>> = (0..state.held.len()).into_par_iter().map(missing).collect();
        for (held, columns) in state.held.iter_mut().zip(columns) {
            held.columns = Some(columns);
        }
        let of_held = state.held.iter().filter_map(|held| held.columns.as_deref()).flatten();
        (self.measured.residual(&from), self.nuisances.iter().chain(of_held).cloned().collect())
    }

    /// Signature of one parameter of a hypothesis.
    fn column(&self, state: &ModelState, from: &Series, held: usize, index: usize) -> Nuisance {
        let hypothesis = &state.held[held].hypothesis;
        let computed = self.linear.column(self.measured, self.nominal, hypothesis, index, state.shifts.temperature_s);
        if let Some(column) = computed {
            return column;
        }
        let parameter = &hypothesis.parameters()[index];
        let mut step = parameter.step();
        if parameter.value + step > parameter.max {
            step = -step;
        }
        let mut moved = state.clone();
        moved.held[held].hypothesis.set(index, parameter.value + step);
        let run = self.run(&moved);
        self.measured.difference(&run, from).map(|values| {
            let any = values.iter().any(|&value| value != 0.0);
            any.then(|| values.into_iter().map(|value| value / step).collect())
        })
    }

    /// Signature of the amplitude of a hypothesis, per unit, at its current parameters.
    pub fn signature(&self, state: &ModelState, held: usize) -> Nuisance {
        let from = self.run(state);
        self.column(state, &from, held, 0)
    }

    /// Normal equations at a state.
    pub fn normal(&self, state: &mut ModelState) -> NormalEquations {
        let (residual, columns) = self.linearised(state);
        NormalEquations::new(self.whitenings(&state.noise), &residual, &columns, &state.calibration)
    }

    /// Normal equations at a state without one hypothesis, at the same lag.
    pub fn normal_without(&self, state: &ModelState, index: usize) -> NormalEquations {
        let mut others = state.clone();
        others.held.remove(index);
        self.normal(&mut others)
    }

    /// Fits all free parameters; returns the normal equations at the end.
    pub fn fit(&self, state: &mut ModelState) -> NormalEquations {
        let mut normal = self.normal(state);
        for _ in 0..STEPS {
            let (solution, _) = normal.solution();
            let predicted = normal.squares() - normal.chi2();
            if predicted < CONVERGED {
                break;
            }
            let halved = |halving: usize| {
                let mut tried = state.moved(&(&solution * 0.5f64.powi(halving as i32)));
                let tried_normal = self.normal(&mut tried);
                (tried_normal.squares() <= normal.squares()).then_some((tried, tried_normal))
            };
            let Some((tried, tried_normal)) = (0..HALVINGS).find_map(halved) else {
                if self.fit_without_onsets(state, &normal) {
                    normal = self.normal(state);
                }
                break;
            };
            let fall = normal.squares() - tried_normal.squares();
            (*state, normal) = (tried, tried_normal);
            let error = (fall - predicted).abs();
            if error < CONVERGED.max(LINEAR * predicted) && normal.squares() - normal.chi2() < CONVERGED {
                break;
            }
            if error > LINEAR * predicted {
                state.held.iter_mut().for_each(FittedHypothesis::invalidate);
                normal = self.normal(state);
            }
        }
        state.set_sigmas(&normal.solution().1);
        normal
    }

    /// Fits the parameters without onsets and durations: between two motions these have no signature, and their arbitrary step spoils that
    /// of the others. Returns true if χ² has fallen.
    fn fit_without_onsets(&self, state: &mut ModelState, normal: &NormalEquations) -> bool {
        let mut tried = state.clone();
        for held in &mut tried.held {
            for (index, parameter) in held.hypothesis.parameters().iter().enumerate() {
                if held.is_free[index] && matches!(parameter.role, Role::Onset | Role::Duration) {
                    held.fix(index, parameter.value);
                }
            }
        }
        if tried.free() == state.free() || self.fit(&mut tried).squares() >= normal.squares() {
            return false;
        }
        for (held, before) in tried.held.iter_mut().zip(&state.held) {
            held.is_free.clone_from(&before.is_free);
            held.invalidate();
        }
        *state = tried;
        true
    }
}

impl ModelState {
    /// The configuration with all corrections and hypotheses.
    pub fn configuration(&self, nominal: &Configuration) -> Configuration {
        let mut configuration = nominal.clone();
        for ((gyro, number), added) in calibration_parameters().into_iter().zip(&self.calibration) {
            *configuration.gyros[gyro as usize].calibration.value_mut(number) += added;
        }
        for held in &self.held {
            held.hypothesis.apply(&mut configuration);
        }
        configuration
    }

    /// Removes a hypothesis, and the temperature lag with the last one that follows the temperature.
    pub fn remove(&mut self, index: usize) -> FittedHypothesis {
        let gone = self.held.remove(index);
        if !self.held.iter().any(FittedHypothesis::follows_temperature) {
            self.set_temperature_lag(0.0);
        }
        gone
    }

    /// Sets the delay of the recorded temperature.
    pub fn set_temperature_lag(&mut self, temperature_s: f64) {
        if self.shifts.temperature_s != temperature_s {
            self.shifts.temperature_s = temperature_s;
            // A formula may contain the temperature.
            let moves = |held: &&mut FittedHypothesis| {
                held.follows_temperature() || held.hypothesis.amplitude.formula().is_some()
            };
            self.held.iter_mut().filter(moves).for_each(FittedHypothesis::invalidate);
        }
    }

    /// Free parameters: index of the hypothesis and of the parameter.
    pub fn free(&self) -> Vec<(usize, usize)> {
        let of_held = |(held, own): (usize, &FittedHypothesis)| {
            let free = own.is_free.iter().enumerate().filter(|(_, is_free)| **is_free);
            free.map(|(index, _)| (held, index)).collect::<Vec<_>>()
        };
        self.held.iter().enumerate().flat_map(of_held).collect()
    }

    fn moved(&self, by: &DVector<f64>) -> ModelState {
        let mut moved = self.clone();
        let count = self.calibration.len();
        for (index, value) in moved.calibration.iter_mut().enumerate() {
            *value += by[index];
        }
        moved.shifts.lag_s += by[count];
        for (place, (held, index)) in self.free().into_iter().enumerate() {
            let hypothesis = &mut moved.held[held].hypothesis;
            let parameter = &hypothesis.parameters()[index];
            let max = max_change(parameter);
            let value = parameter.value + by[count + 1 + place].clamp(-max, max);
            hypothesis.set(index, value.clamp(parameter.min, parameter.max));
        }
        moved
    }

    fn set_sigmas(&mut self, covariance: &DMatrix<f64>) {
        let count = self.calibration.len();
        let sigma = |index: usize| covariance[(index, index)].max(0.0).sqrt();
        self.calibration_sigmas = (0..count).map(sigma).collect();
        self.lag_sigma_s = sigma(count);
        for (place, (held, index)) in self.free().into_iter().enumerate() {
            self.held[held].sigmas[index] = sigma(count + 1 + place);
        }
    }
}

/// Maximum change of a parameter in one step.
fn max_change(parameter: &HypothesisParameter) -> f64 {
    match parameter.role {
        Role::Onset | Role::Duration => 300.0,
        Role::Phase => 0.5,
        Role::Period => 0.1 * parameter.value.abs(),
        Role::TimeConstant | Role::Width => 0.5 * parameter.value.abs(),
        _ => f64::INFINITY,
    }
}
