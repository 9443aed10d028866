//! Parameters and hypotheses of the model at one point of a diagnosis.

use std::hash::{DefaultHasher, Hash, Hasher};

use geu_model::Configuration;
use geu_model::parameter_spec::Role;
use nalgebra::{DMatrix, DVector};

use crate::fitted_hypothesis::FittedHypothesis;
use crate::measured::{CHANNELS, Shifts};
use crate::whitening::NoiseModel;
use geu_hypothesis::amplitude::AmplitudeRef;
use geu_hypothesis::{CalibrationParameter, HypothesisParameter};

/// A larger constant lag is not that of the link (protocol/ICD.md).
pub const LAG_S: f64 = 0.010;

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

impl ModelState {
    /// Values of the calibration parameters and of the lag, in the order of their signatures.
    pub(crate) fn nuisances(&self) -> Vec<f64> {
        self.calibration.iter().copied().chain([self.shifts.lag_s]).collect()
    }

    /// Resets a lag that the motion does not determine: at rest it would only shift the limit cycle.
    pub fn reset_undetermined_lag(&mut self) {
        if self.lag_sigma_s > LAG_S {
            self.shifts.lag_s = 0.0;
        }
    }

    /// The configuration with all corrections and hypotheses.
    pub fn configuration(&self, nominal: &Configuration) -> Configuration {
        let mut configuration = nominal.clone();
        for (parameter, added) in CalibrationParameter::all(&nominal.device).iter().zip(&self.calibration) {
            parameter.add(&mut configuration.gyros[parameter.gyro.index()].calibration, *added);
        }
        for held in &self.held {
            held.hypothesis.apply(&mut configuration);
        }
        configuration
    }

    /// Hash of all that a fit depends on or hands on. The order of threads does not matter: equal states have equal fits.
    pub fn key(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        let mut push = |values: &[f64]| values.iter().for_each(|value| value.to_bits().hash(&mut hasher));
        push(&self.calibration);
        push(&self.calibration_sigmas);
        push(&[self.shifts.lag_s, self.shifts.temperature_s, self.lag_sigma_s]);
        for noise in &self.noise {
            push(&[noise.white, noise.angle_walk, noise.rate_walk, noise.scale_walk, noise.flicker]);
        }
        for FittedHypothesis { hypothesis, is_free, sigmas, penalty, held_out, columns } in &self.held {
            push(&hypothesis.parameters().iter().map(|parameter| parameter.value).collect::<Vec<_>>());
            push(sigmas);
            push(&[*penalty]);
            push(&held_out.map(|third| third.unwrap_or(f64::INFINITY)));
            push(&is_free.iter().map(|free| f64::from(u8::from(*free))).collect::<Vec<_>>());
            push(&[hypothesis.gyros.mask() as f64]);
            columns.iter().flat_map(|columns| columns.iter()).flatten().flatten().for_each(|values| push(values));
            push(&[f64::from(u8::from(columns.is_some()))]);
        }
        self.held.iter().for_each(|held| format!("{:?}", held.hypothesis.amplitude).hash(&mut hasher));
        hasher.finish()
    }

    /// Value of a constant amplitude among the hypotheses on a gyro.
    pub fn constant(&self, amplitude: &AmplitudeRef, gyro: usize) -> f64 {
        let own = self.held.iter().map(|held| &held.hypothesis);
        own.filter(|own| own.amplitude == *amplitude && own.gyros[gyro]).map(|own| own.value).sum()
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

    pub(crate) fn moved(&self, by: &DVector<f64>, block_s: f64) -> ModelState {
        let mut moved = self.clone();
        let count = self.calibration.len();
        for (index, value) in moved.calibration.iter_mut().enumerate() {
            *value += by[index];
        }
        moved.shifts.lag_s += by[count];
        for (place, (held, index)) in self.free().into_iter().enumerate() {
            let hypothesis = &mut moved.held[held].hypothesis;
            let parameter = &hypothesis.parameters()[index];
            let max = max_change(parameter, block_s);
            let value = parameter.value + by[count + 1 + place].clamp(-max, max);
            hypothesis.set(index, value.clamp(parameter.min, parameter.max));
        }
        moved
    }

    pub(crate) fn set_sigmas(&mut self, covariance: &DMatrix<f64>) {
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
fn max_change(parameter: &HypothesisParameter, block_s: f64) -> f64 {
    match parameter.role {
        Role::Onset | Role::Duration => 60.0 * block_s,
        Role::Phase => 0.5,
        Role::Period => 0.1 * parameter.value.abs(),
        Role::TimeConstant | Role::Width => 0.5 * parameter.value.abs(),
        _ => f64::INFINITY,
    }
}
