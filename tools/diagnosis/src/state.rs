//! What is held of the unit at some point of a diagnosis, and its fit to the recording: the sixteen, the common lag, and every
//! change found so far, together, by Gauss and Newton, each step run by the model from the start.

use std::sync::Arc;

use geu_model::Configuration;
use geu_model::course::TimeFunction;
use geu_model::number::{ParameterSet, Role};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::amplitude::calibration_parameters;
use crate::hypothesis::{Hypothesis, HypothesisParameter};
use crate::measured::{CHANNELS, MeasuredData, Series, Shifts, TIMING};
use crate::normal::{NormalEquations, Nuisance, THIRDS};
use crate::whitening::{NoiseModel, Whitening};

/// Shift with which the signature of a common lag is run.
const LAG_S: f64 = 1e-3;
/// Rounds of a fit; each is a run for every free parameter.
const ROUNDS: usize = 6;
/// A fit ends where a round lowers χ² by less.
const SETTLED: f64 = 0.01;
/// A fall of χ² that differs from what was foretold by less than this share is that of a linear model.
const LINEAR: f64 = 0.02;
/// Times a step is halved.
const HALVINGS: usize = 5;
/// Share of a calibration number's range by which it is moved for its signature.
const SHARE: f64 = 1e-4;

/// A hypothesis that is held, and which of its parameters are fitted.
#[derive(Debug, Clone, PartialEq)]
pub struct FittedHypothesis {
    /// The hypothesis.
    pub hypothesis: Hypothesis,
    /// For each of its parameters, whether it is fitted; the others stay at their defaults.
    pub is_free: Vec<bool>,
    /// One sigma of each, from the last fit; NaN where it is not fitted.
    pub sigmas: Vec<f64>,
    /// Fall of χ² that was required of it.
    pub penalty: f64,
    /// By how much better each third is predicted by the other two with it ([`NormalEquations::held_out`]).
    pub held_out: [Option<f64>; THIRDS],
    /// Signatures of the free ones, where they were run: nearly the same as long as the parameters are.
    columns: Option<Arc<Vec<Nuisance>>>,
}

impl FittedHypothesis {
    /// Whether its course is that of the temperature.
    pub fn follows_temperature(&self) -> bool {
        self.hypothesis.law() == Some(TimeFunction::Temperature)
    }

    /// Forgets its signatures.
    pub fn invalidate(&mut self) {
        self.columns = None;
    }

    /// With nothing to be fitted.
    pub fn fixed(hypothesis: Hypothesis) -> FittedHypothesis {
        FittedHypothesis::with_free(hypothesis, |_| false)
    }

    fn with_free(hypothesis: Hypothesis, is_free: impl Fn(usize) -> bool) -> FittedHypothesis {
        let is_free: Vec<bool> = (0..hypothesis.parameters().len()).map(is_free).collect();
        let sigmas = vec![f64::NAN; is_free.len()];
        FittedHypothesis { hypothesis, is_free, sigmas, penalty: 0.0, held_out: [None; THIRDS], columns: None }
    }

    /// Fits this parameter too.
    pub fn free(&mut self, index: usize) {
        self.is_free[index] = true;
        self.columns = None;
    }

    /// With its size and the shapes that have no default free.
    pub fn new(hypothesis: Hypothesis) -> FittedHypothesis {
        let (own, shapes) = (hypothesis.own_shapes.len(), hypothesis.amplitude.own_shapes());
        FittedHypothesis::with_free(hypothesis, |index| {
            index == 0 || index > own || shapes[index - 1].role == Role::Onset
        })
    }

    /// The same, with what was required of it and how it predicts each third.
    #[must_use]
    pub fn accepted(self, penalty: f64, held_out: [Option<f64>; THIRDS]) -> FittedHypothesis {
        FittedHypothesis { penalty, held_out, ..self }
    }
}

/// All that is held.
#[derive(Debug, Clone)]
pub struct ModelState {
    /// Added to the calibration, in the order of the calibration parameters.
    pub sixteen: Vec<f64>,
    /// One sigma of each.
    pub sixteen_sigmas: Vec<f64>,
    /// How recording, reference and temperatures lie in time.
    pub shifts: Shifts,
    /// One sigma of the lag.
    pub lag_sigma_s: f64,
    /// Changes found.
    pub held: Vec<FittedHypothesis>,
    /// Noise of each channel.
    pub noise: [NoiseModel; CHANNELS],
}

/// The recording with what is believed of the unit, and what never changes in a diagnosis.
pub struct DiagnosisCase<'a> {
    /// The recording.
    pub measured: &'a MeasuredData,
    /// The configuration as given.
    pub believed: &'a Configuration,
    /// Signatures of the sixteen and of the lag.
    pub nuisances: Vec<Nuisance>,
}

impl<'a> DiagnosisCase<'a> {
    /// Runs the model for the signatures of the sixteen and of a common lag.
    pub fn new(measured: &'a MeasuredData, believed: &'a Configuration) -> DiagnosisCase<'a> {
        let from = measured.run(believed, Shifts::default());
        let numbers = geu_model::package::Calibration::NUMBERS;
        let moved = |number: usize| {
            let size = SHARE * (numbers[number].greatest - numbers[number].least);
            let mut moved = believed.clone();
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
        let mut lag = measured.difference(&measured.run(believed, Shifts { lag_s: LAG_S, ..Shifts::default() }), &from);
        lag.iter_mut().flatten().for_each(|value| *value /= LAG_S);
        nuisances.push(std::array::from_fn(|channel| (channel != TIMING).then(|| std::mem::take(&mut lag[channel]))));
        DiagnosisCase { measured, believed, nuisances }
    }

    /// This configuration beside a recording of the same motion, with the calibration alone to be fitted.
    pub fn of_calibration<'b>(&self, measured: &'b MeasuredData) -> DiagnosisCase<'b>
    where
        'a: 'b,
    {
        let mut nuisances = match std::ptr::eq(measured, self.measured) {
            true => self.nuisances.clone(),
            false => DiagnosisCase::new(measured, self.believed).nuisances,
        };
        nuisances.truncate(calibration_parameters().len());
        DiagnosisCase { measured, believed: self.believed, nuisances }
    }

    /// The state before anything is known.
    pub fn start(&self, noise: [NoiseModel; CHANNELS]) -> ModelState {
        let count = self.nuisances.len() - 1;
        ModelState {
            sixteen: vec![0.0; count],
            sixteen_sigmas: vec![f64::NAN; count],
            shifts: Shifts::default(),
            lag_sigma_s: f64::NAN,
            held: Vec::new(),
            noise,
        }
    }

    /// The model of a state at each node.
    pub fn run(&self, state: &ModelState) -> Series {
        self.measured.run(&state.configuration(self.believed), state.shifts)
    }

    /// Residual of a state, averaged over blocks.
    pub fn residual(&self, state: &ModelState) -> Series {
        self.measured.residual(&self.run(state))
    }

    /// The filters of a state's noise.
    pub fn whitenings(&self, noise: &[NoiseModel; CHANNELS]) -> [Whitening; CHANNELS] {
        std::array::from_fn(|channel| Whitening::new(&noise[channel], &self.measured.blocks[channel]))
    }

    /// The residual, and the signatures of all that is fitted: nuisances, then the free parameters. Those that are not at hand are
    /// run, and kept.
    pub fn linearised(&self, state: &mut ModelState) -> (Series, Vec<Nuisance>) {
        let from = self.run(state);
        let open: Vec<(usize, usize)> =
            state.free().into_iter().filter(|(held, _)| state.held[*held].columns.is_none()).collect();
        let columns: Vec<Nuisance> =
            open.par_iter().map(|&(held, index)| self.column(state, &from, held, index)).collect();
        for held in 0..state.held.len() {
            if state.held[held].columns.is_none() {
                let own = open.iter().zip(&columns).filter(|((other, _), _)| *other == held);
                state.held[held].columns = Some(Arc::new(own.map(|(_, column)| column.clone()).collect()));
            }
        }
        let of_changes = state.held.iter().filter_map(|held| held.columns.as_deref()).flatten();
        (self.measured.residual(&from), self.nuisances.iter().chain(of_changes).cloned().collect())
    }

    /// The signature of one parameter of a change.
    fn column(&self, state: &ModelState, from: &Series, held: usize, index: usize) -> Nuisance {
        let parameter = &state.held[held].hypothesis.parameters()[index];
        let mut step = step(parameter);
        if parameter.value + step > parameter.greatest {
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

    /// The signature of one unit of the size of a change, as it stands.
    pub fn signature(&self, state: &ModelState, held: usize) -> Nuisance {
        let from = self.run(state);
        self.column(state, &from, held, 0)
    }

    /// The equations of a state as it stands.
    pub fn normal(&self, state: &mut ModelState) -> NormalEquations {
        let (residual, columns) = self.linearised(state);
        NormalEquations::departed(self.whitenings(&state.noise), &residual, &columns, &state.sixteen)
    }

    /// The equations of a state as it stands without one change, at the same lag.
    pub fn normal_without(&self, state: &ModelState, index: usize) -> NormalEquations {
        let mut others = state.clone();
        others.held.remove(index);
        self.normal(&mut others)
    }

    /// Fits everything that is free, and tells the equations at the end.
    pub fn fit(&self, state: &mut ModelState) -> NormalEquations {
        let mut normal = self.normal(state);
        for _ in 0..ROUNDS {
            let (solution, _) = normal.solution();
            let foretold = normal.squares() - normal.chi2();
            if foretold < SETTLED {
                break;
            }
            let mut share = 1.0;
            let mut next = None;
            for _ in 0..HALVINGS {
                let mut tried = state.moved(&(&solution * share));
                let tried_normal = self.normal(&mut tried);
                if tried_normal.squares() <= normal.squares() {
                    next = Some((tried, tried_normal));
                    break;
                }
                share *= 0.5;
            }
            let Some((tried, tried_normal)) = next else { break };
            let fall = normal.squares() - tried_normal.squares();
            (*state, normal) = (tried, tried_normal);
            // What falls as foretold is linear, and there.
            if (fall - foretold).abs() < SETTLED.max(LINEAR * foretold) && normal.squares() - normal.chi2() < SETTLED {
                break;
            }
            if (fall - foretold).abs() > LINEAR * foretold {
                state.held.iter_mut().for_each(|held| held.columns = None);
                normal = self.normal(state);
            }
        }
        state.take_sigmas(&normal.solution().1);
        normal
    }
}

impl ModelState {
    /// The configuration with all that is held.
    pub fn configuration(&self, believed: &Configuration) -> Configuration {
        let mut configuration = believed.clone();
        for ((gyro, number), added) in calibration_parameters().into_iter().zip(&self.sixteen) {
            *configuration.gyros[gyro as usize].calibration.value_mut(number) += added;
        }
        for held in &self.held {
            held.hypothesis.apply(&mut configuration);
        }
        configuration
    }

    /// Takes a change back, and the lag of the temperature with the last that follows it.
    pub fn remove(&mut self, index: usize) -> FittedHypothesis {
        let gone = self.held.remove(index);
        if !self.held.iter().any(FittedHypothesis::follows_temperature) {
            self.set_temperature_lag(0.0);
        }
        gone
    }

    /// Takes the temperature as told so much later than it was.
    pub fn set_temperature_lag(&mut self, temperature_s: f64) {
        if self.shifts.temperature_s != temperature_s {
            self.shifts.temperature_s = temperature_s;
            // A formula may have the temperature among its factors.
            let moves = |held: &&mut FittedHypothesis| {
                held.follows_temperature() || held.hypothesis.amplitude.formula().is_some()
            };
            self.held.iter_mut().filter(moves).for_each(FittedHypothesis::invalidate);
        }
    }

    /// Free parameters: index of the change and of the parameter.
    pub fn free(&self) -> Vec<(usize, usize)> {
        let of_change = |(held, own): (usize, &FittedHypothesis)| {
            let free: Vec<(usize, usize)> =
                (0..own.is_free.len()).filter(|&index| own.is_free[index]).map(|index| (held, index)).collect();
            free
        };
        self.held.iter().enumerate().flat_map(of_change).collect()
    }

    fn moved(&self, by: &DVector<f64>) -> ModelState {
        let mut moved = self.clone();
        let count = self.sixteen.len();
        for (index, value) in moved.sixteen.iter_mut().enumerate() {
            *value += by[index];
        }
        moved.shifts.lag_s += by[count];
        for (place, (held, index)) in self.free().into_iter().enumerate() {
            let change = &mut moved.held[held].hypothesis;
            let parameter = &change.parameters()[index];
            let most = reach(parameter);
            let value = parameter.value + by[count + 1 + place].clamp(-most, most);
            change.set(index, value.clamp(parameter.least, parameter.greatest));
        }
        moved
    }

    fn take_sigmas(&mut self, covariance: &DMatrix<f64>) {
        let count = self.sixteen.len();
        let sigma = |index: usize| covariance[(index, index)].max(0.0).sqrt();
        self.sixteen_sigmas = (0..count).map(sigma).collect();
        self.lag_sigma_s = sigma(count);
        for (place, (held, index)) in self.free().into_iter().enumerate() {
            self.held[held].sigmas[index] = sigma(count + 1 + place);
        }
    }
}

/// By how much a parameter is moved for its signature.
fn step(parameter: &HypothesisParameter) -> f64 {
    match parameter.role {
        // Two blocks, so that what happens within one is averaged.
        Role::Onset => 10.0,
        Role::Phase => 0.02,
        _ if parameter.value != 0.0 => 0.02 * parameter.value.abs(),
        _ => 2e-3 * parameter.greatest.min(1e3),
    }
}

/// The farthest that one round may move it.
fn reach(parameter: &HypothesisParameter) -> f64 {
    match parameter.role {
        Role::Onset => 300.0,
        Role::Phase => 0.5,
        Role::Period => 0.1 * parameter.value.abs(),
        Role::TimeConstant => 0.5 * parameter.value.abs(),
        _ => f64::INFINITY,
    }
}
