//! A diagnosis of a recording, and the common fit of calibration parameters, lag and hypotheses to it, by Gauss–Newton steps. Each step
//! runs the model from the start.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use geu_model::Configuration;
use geu_model::device::Device;
use geu_model::parameter_spec::Role;
use geu_model::units::{ARCSEC_PER_RAD, SAMPLE_INTERVAL_S};
use rayon::prelude::*;

use crate::calibration_signatures::{nuisances, on_grid};
use crate::fitted_hypothesis::FittedHypothesis;
use crate::linear_signatures::LinearSignatures;
use crate::measured::{CHANNELS, MeasuredData, ModelRun, Series, Shifts};
use crate::model_state::ModelState;
use crate::noise::FittedNoise;
use crate::normal_equations::{Filters, NormalEquations, Nuisance, THIRDS};
use crate::recent::Recent;
use crate::rounding::{Rounding, rounding};
use crate::signature::Signature;
use crate::whitening::{NoiseModel, Whitening};
use geu_hypothesis::CalibrationParameter;

/// Maximum number of Gauss–Newton steps; each runs the model once for every free parameter.
const STEPS: usize = 6;
/// A fit has converged if a step reduces χ² by less.
const CONVERGED: f64 = 0.01;
/// Maximum relative difference between actual and predicted χ² reduction of a linear model.
const LINEAR: f64 = 0.02;
/// Share of the predicted χ² reduction that a step must reach, else it is halved: less means that it went past the minimum.
const SUFFICIENT: f64 = 0.25;
/// Maximum number of halvings of a step.
const HALVINGS: usize = 5;

/// Constant inputs of a diagnosis.
pub struct DiagnosisCase<'a> {
    /// The recording.
    pub measured: &'a MeasuredData,
    /// The input configuration.
    pub nominal: &'a Configuration,
    /// Signatures of the calibration parameters and of the lag.
    pub nuisances: Vec<Nuisance>,
    /// Values of these at which the signatures were run; the grid of runs contains them.
    pub origin: Vec<f64>,
    /// Rounding along the model's path.
    pub rounding: Arc<Rounding>,
    /// Signatures that a fit computes without runs.
    pub linear: LinearSignatures,
    /// Fits that recur.
    pub fits: Recent<ModelState>,
    /// Fits of walks that recur.
    pub walks: Recent<FittedNoise>,
    /// Filters of the last noises of each channel: most fits have the same.
    pub filters: [KeptFilters; CHANNELS],
}

/// Noises of a channel with their filters, the last first.
pub type KeptFilters = Mutex<VecDeque<(NoiseModel, Arc<Whitening>)>>;
/// Filters of a channel that are kept: of fits that take turns.
const KEPT_FILTERS: usize = 4;

/// A priori sigmas of scale factor, drift and projection: at the default unit the change of a scale factor at launch (Casteren table 1),
/// and in proportion to it wider than an arcminute (§3.4) and a drift; else a tenth, a hundredth of the range, and 0.3 rad. They limit
/// parameters that the motion does not determine and hardly affect the others.
fn a_priori_sigmas(device: &Device) -> [f64; 3] {
    match device.is_iras() {
        true => [2000e-6, 600.0 / 7200.0, 300.0],
        false => [0.1, 0.01 * device.range_arcsec_s * SAMPLE_INTERVAL_S, 0.3 * ARCSEC_PER_RAD],
    }
}

impl<'a> DiagnosisCase<'a> {
    /// Runs the model for the signatures of the calibration parameters and of a common lag.
    pub fn new(measured: &'a MeasuredData, nominal: &'a Configuration) -> DiagnosisCase<'a> {
        let shifts = Shifts::default();
        let nuisances = nuisances(measured, nominal, shifts);
        let rounding = Arc::new(rounding(measured, &measured.run(nominal, shifts)));
        DiagnosisCase::with_signatures(measured, nominal, nuisances, rounding)
    }

    /// With signatures and rounding that are known, at the input configuration.
    pub fn with_signatures(
        measured: &'a MeasuredData,
        nominal: &'a Configuration,
        nuisances: Vec<Nuisance>,
        rounding: Arc<Rounding>,
    ) -> DiagnosisCase<'a> {
        let origin = vec![0.0; nuisances.len()];
        let (linear, fits, walks, filters) = Default::default();
        DiagnosisCase { measured, nominal, nuisances, origin, rounding, linear, fits, walks, filters }
    }

    /// Takes signatures and rounding along the path of a state; returns the path.
    pub fn set_origin(&mut self, state: &ModelState) -> ModelRun {
        self.nuisances = nuisances(self.measured, &state.configuration(self.nominal), state.shifts);
        self.origin = state.nuisances();
        let path = self.run(state);
        self.rounding = Arc::new(rounding(self.measured, &path));
        (self.fits, self.walks, self.filters) = Default::default();
        path
    }

    /// The configuration with another recording of the same motion, and only the calibration parameters as nuisances.
    pub fn of_calibration<'b>(&self, measured: &'b MeasuredData) -> DiagnosisCase<'b>
    where
        'a: 'b,
    {
        let mut case = match std::ptr::eq(measured, self.measured) {
            true => self.on(measured),
            false => DiagnosisCase::new(measured, self.nominal),
        };
        case.nuisances.truncate(CalibrationParameter::all(&self.nominal.device).len());
        case
    }

    /// The signatures and rounding of this case on other counts of the same motion.
    pub fn on<'b>(&self, measured: &'b MeasuredData) -> DiagnosisCase<'b>
    where
        'a: 'b,
    {
        let (nuisances, rounding) = (self.nuisances.clone(), self.rounding.clone());
        let other = DiagnosisCase::with_signatures(measured, self.nominal, nuisances, rounding);
        DiagnosisCase { origin: self.origin.clone(), ..other }
    }

    /// Calibration parameters that have moved by this from their a priori values, each with its sigma.
    pub fn a_priori(&self, moved: &[f64]) -> Vec<(f64, f64)> {
        let sigmas = a_priori_sigmas(&self.nominal.device);
        let of = |(place, parameter): (usize, CalibrationParameter)| {
            (moved.get(place).copied().unwrap_or(0.0), parameter.of_kind(sigmas))
        };
        CalibrationParameter::all(&self.nominal.device).into_iter().enumerate().map(of).collect()
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
    pub fn run(&self, state: &ModelState) -> ModelRun {
        self.measured.run(&state.configuration(self.nominal), state.shifts)
    }

    /// Block averages of the residual of a state.
    pub fn residual(&self, state: &ModelState) -> Series {
        self.measured.residual(&self.run(state))
    }

    /// Whitening filters of a noise.
    pub fn whitenings(&self, noise: &[NoiseModel; CHANNELS]) -> Filters {
        std::array::from_fn(|channel| {
            let kept = || self.filters[channel].lock().unwrap_or_else(PoisonError::into_inner);
            if let Some((_, filter)) = kept().iter().find(|(own, _)| *own == noise[channel]) {
                return filter.clone();
            }
            let (blocks, rounding) = (&self.measured.blocks[channel], &self.rounding[channel]);
            let filter = Arc::new(Whitening::new(&noise[channel], blocks, rounding, self.measured.block_s()));
            let mut kept = kept();
            kept.truncate(KEPT_FILTERS - 1);
            kept.push_front((noise[channel], filter.clone()));
            filter
        })
    }

    /// The residual, and the signatures of all fitted parameters: nuisances, then the free parameters. Missing signatures are run and
    /// kept in the state.
    pub fn linearised(&self, state: &mut ModelState) -> (Series, Vec<Nuisance>) {
        let on_grid = self.on_grid(state);
        let from = self.run(&on_grid);
        let is_missing = |held: &usize| state.held[*held].columns.is_none();
        let free = |held: usize| {
            let is_free = on_grid.held[held].is_free.iter().enumerate();
            is_free.filter(|(_, is_free)| **is_free).map(move |(index, _)| (held, index))
        };
        let parameters: Vec<_> = (0..state.held.len()).filter(is_missing).flat_map(free).collect();
        let mut found = vec![Vec::new(); state.held.len()];
        for ((held, _), column) in parameters.iter().zip(self.columns(&on_grid, &from, &parameters)) {
            found[*held].push(column);
        }
        for (held, found) in state.held.iter_mut().zip(found) {
            held.columns.get_or_insert_with(|| Arc::new(found));
        }
        let of_held = state.held.iter().filter_map(|held| held.columns.as_deref()).flatten();
        let mut residual = self.measured.residual(&from);
        self.subtract_rest(&mut residual, state, &on_grid);
        (residual, self.nuisances.iter().chain(of_held).cloned().collect())
    }

    /// The state at the next calibration parameters and lag of the grid; itself if an effect withholds motions, and with them what a
    /// calibration parameter adds.
    fn on_grid(&self, state: &ModelState) -> ModelState {
        if state.held.iter().any(|held| held.hypothesis.amplitude.filters_motion()) {
            return state.clone();
        }
        let parameters = CalibrationParameter::all(&self.nominal.device);
        let mut values = on_grid(&state.nuisances(), &self.origin, &parameters, self.measured.block_s());
        let lag_s = values.pop().unwrap_or_default();
        ModelState { calibration: values, shifts: Shifts { lag_s, ..state.shifts }, ..state.clone() }
    }

    /// Takes from a residual at the grid what the state's own calibration parameters and lag add to the model.
    fn subtract_rest(&self, residual: &mut Series, state: &ModelState, on_grid: &ModelState) {
        let rests = state.nuisances().into_iter().zip(on_grid.nuisances()).map(|(own, on_grid)| own - on_grid);
        for (nuisance, rest) in self.nuisances.iter().zip(rests) {
            for channel in 0..CHANNELS {
                let blocks = self.measured.blocks[channel].iter();
                for ((value, added), block) in
                    residual[channel].iter_mut().zip(nuisance[channel].iter().flatten()).zip(blocks)
                {
                    *value -= if block.is_compared { rest * added } else { 0.0 };
                }
            }
        }
    }

    /// Signatures of parameters: each the place of its hypothesis and its own.
    fn columns(&self, state: &ModelState, from: &ModelRun, parameters: &[(usize, usize)]) -> Vec<Nuisance> {
        let (linear, temperature_s) = (&self.linear, state.shifts.temperature_s);
        let computed = |&(held, index): &(usize, usize)| {
            linear.column(self.measured, self.nominal, &state.held[held].hypothesis, index, temperature_s)
        };
        let mut all: Vec<Option<Nuisance>> = parameters.par_iter().map(computed).collect();
        let missing: Vec<usize> = (0..all.len()).filter(|&place| all[place].is_none()).collect();
        let moved = |&place: &usize| {
            let (held, index) = parameters[place];
            let parameter = &state.held[held].hypothesis.parameters()[index];
            let mut step = parameter.step(self.measured.block_s());
            if parameter.value + step > parameter.max {
                step = -step;
            }
            let mut moved = state.clone();
            moved.held[held].hypothesis.set(index, parameter.value + step);
            (step, moved.configuration(self.nominal))
        };
        let (steps, moved): (Vec<f64>, Vec<Configuration>) = missing.iter().map(moved).unzip();
        let signature = |(run, step): (ModelRun, &f64)| -> Nuisance {
            self.measured.difference(&run, from).map(|values| {
                let any = values.iter().any(|&value| value != 0.0);
                any.then(|| values.into_iter().map(|value| value / step).collect())
            })
        };
        let of_a_thread = moved.len().div_ceil(rayon::current_num_threads()).max(1);
        let signatures =
            moved.par_chunks(of_a_thread).zip(steps.par_chunks(of_a_thread)).flat_map_iter(|(moved, steps)| {
                self.measured.run_all(moved, state.shifts).into_iter().zip(steps).map(signature)
            });
        for (place, signature) in missing.into_iter().zip(signatures.collect::<Vec<_>>()) {
            all[place] = Some(signature);
        }
        all.into_iter().flatten().collect()
    }

    /// Signature of the amplitude of a hypothesis, per unit, at its current parameters.
    pub fn signature(&self, state: &ModelState, held: usize) -> Nuisance {
        let on_grid = self.on_grid(state);
        self.columns(&on_grid, &self.run(&on_grid), &[(held, 0)]).remove(0)
    }

    /// Cross-validation ([`NormalEquations::cross_validate`]) of a hypothesis beside all others. Signatures are those at the state: a
    /// calibration fitted without a large effect would be far away.
    pub fn cross_validate(&self, state: &ModelState, index: usize) -> [Option<f64>; THIRDS] {
        let signature = self.signature(state, index);
        let mut others = state.clone();
        let own = others.held[index].hypothesis.clone();
        let value = own.value;
        others.held[index] = FittedHypothesis::fixed(own);
        let (mut residual, columns) = self.linearised(&mut others);
        for (residual, signature) in residual.iter_mut().zip(&signature) {
            residual.iter_mut().zip(signature.iter().flatten()).for_each(|(own, unit)| *own += value * unit);
        }
        let normal = NormalEquations::new(
            self.whitenings(&state.noise),
            &residual,
            &columns,
            &self.a_priori(&state.calibration),
        );
        Signature::new(&normal, &signature).cross_validate(&normal)
    }

    /// Normal equations at a state.
    pub fn normal(&self, state: &mut ModelState) -> NormalEquations {
        let (residual, columns) = self.linearised(state);
        NormalEquations::new(self.whitenings(&state.noise), &residual, &columns, &self.a_priori(&state.calibration))
    }

    /// Normal equations at a state without one hypothesis, at the same lag.
    pub fn normal_without(&self, state: &ModelState, index: usize) -> NormalEquations {
        let mut others = state.clone();
        others.held.remove(index);
        self.normal(&mut others)
    }

    /// Fits all free parameters; returns the normal equations at the end.
    pub fn fit(&self, state: &mut ModelState) -> NormalEquations {
        let key = state.key();
        if let Some(known) = self.fits.find(key) {
            *state = known;
            return self.normal(state);
        }
        let normal = self.fit_anew(state);
        self.fits.keep(key, state);
        normal
    }

    fn fit_anew(&self, state: &mut ModelState) -> NormalEquations {
        let mut normal = self.normal(state);
        for _ in 0..STEPS {
            let (solution, _) = normal.solution();
            let predicted = normal.squares() - normal.chi2();
            if predicted < CONVERGED {
                break;
            }
            let (mut sufficient, mut lower) = (None, None);
            for halving in 0..HALVINGS {
                let part = 0.5f64.powi(halving as i32);
                let mut tried = state.moved(&(&solution * part), self.measured.block_s());
                let tried_normal = self.normal(&mut tried);
                let reached = (normal.squares() - tried_normal.squares()) / (part * (2.0 - part) * predicted);
                let tried = Some((tried, tried_normal));
                if reached >= SUFFICIENT {
                    sufficient = tried;
                    break;
                }
                lower = lower.or(tried.filter(|_| reached >= 0.0));
            }
            let Some((tried, tried_normal)) = sufficient.or(lower) else {
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
