//! Draws the injected effects from the model's own lists; no effect is named here.

use std::f64::consts::TAU;

use geu_model::effect::discovered::{Formula, Regressor};
use geu_model::effect::{Effects, GyroEffects, WiringEffects};
use geu_model::fault::{EffectList, ParameterRef};
use geu_model::package::{Axes, Calibration};
use geu_model::parameter_spec::{DefaultValue, ParameterSet, ParameterSpec, Role, ValueFormat};
use geu_model::time_profile::COURSES;
use geu_protocol::{Gyro, Gyros};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::injected::{AnswerKey, InjectedEffect, Origin};
use crate::simulate::{SimulatedRecording, simulate};
use crate::survey::TrialMotion;
use geu_hypothesis::Hypothesis;
use geu_hypothesis::amplitude::{AmplitudeRef, STEP, is_real};

/// Strengths of [`generate_trial`], sigmas.
const STRENGTHS: [f64; 6] = [3.0, 4.5, 6.0, 9.0, 12.0, 24.0];
/// Part of the recording that contains the onsets.
const WITHIN: [f64; 2] = [0.15, 0.85];
/// Shortest period, s; the longest is the recording.
const SHORTEST_PERIOD_S: f64 = 1200.0;
/// Largest factor between a time constant and its default.
const TIME_FACTOR: f64 = 3.0;
/// Factor of a noise above the configured one.
const NOISE_FACTOR: [f64; 2] = [3.0, 10.0];
/// Number of effects of a gyro for each that is on all four gyros.
const ON_ALL: u32 = 8;
/// Maximum number of draws for one effect.
const TRIES: usize = 200;
/// Cosine of the signatures of two effects above which each has less than half its strength beside the other.
const COMPENSATING_COSINE: f64 = 0.866;
/// Sigmas of the calibration errors: scale factor, drift in arcsec per sample interval, misalignment in arcsec.
const SCALE_ERROR: f64 = 6e-6;
const DRIFT_ERROR: f64 = 1.2 / 7200.0;
const MISALIGNMENT_ERROR: f64 = 1.5;

/// Draws up to three effects and simulates the unit with them: no effect in a seventh of the trials, a term outside the catalogue in
/// another seventh, otherwise amplitudes, with a noise or a wiring fault now and then.
pub fn generate_trial(motion: &TrialMotion, seed: u64) -> (AnswerKey, SimulatedRecording) {
    let mut draw = TrialGenerator::new(motion, seed, 0);
    let mut injected: Vec<InjectedEffect> = Vec::new();
    let count = match draw.random.random_range(0..7) {
        0 => 0,
        1 => {
            let strength = draw.strength();
            injected.extend(draw.unknown(strength));
            1
        }
        _ => draw.random.random_range(1..=3),
    };
    for _ in 0..TRIES {
        if injected.len() >= count {
            break;
        }
        let strength = draw.strength();
        let next = match draw.random.random_range(0..10) {
            0 => draw.noise(),
            1 => draw.wiring(),
            _ => draw.amplitude(strength),
        };
        injected.extend(next.filter(|next| is_independent(next, &injected)));
    }
    let recording = draw.simulate(&injected);
    (AnswerKey { seed, duration_s: motion.duration_s, injected }, recording)
}

/// True if an effect can be injected beside others: time courses of one effect share its shape parameters, and an exchange of gyros moves
/// the effect of another wiring fault.
fn is_independent(next: &InjectedEffect, others: &[InjectedEffect]) -> bool {
    !others.iter().any(|own| {
        own.code().starts_with(&next.code())
            || next.code().starts_with(&own.code())
            || own.origin == Origin::Wiring && next.origin == Origin::Wiring
    })
}

/// False if a wave would drive an amplitude below its limit of zero, such as a clearance.
fn stays_possible(amplitude: &AmplitudeRef) -> bool {
    let profile = amplitude.kind.map(|kind| COURSES[kind].with(&[]));
    let is_wave = profile.is_some_and(|profile| profile.spec.follows_temperature || profile.is_periodic());
    amplitude.number().min < 0.0 || !is_wave
}

/// Random numbers of one recording.
pub struct TrialGenerator<'a> {
    motion: &'a TrialMotion,
    random: ChaCha8Rng,
}

impl<'a> TrialGenerator<'a> {
    /// Seed and stream determine all draws.
    pub fn new(motion: &'a TrialMotion, seed: u64, stream: u64) -> TrialGenerator<'a> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(stream);
        TrialGenerator { motion, random }
    }

    fn strength(&mut self) -> f64 {
        STRENGTHS[self.random.random_range(0..STRENGTHS.len())]
    }

    fn between(&mut self, [min, max]: [f64; 2]) -> f64 {
        min + (max - min) * self.random.random::<f64>()
    }

    fn log_between(&mut self, limits: [f64; 2]) -> f64 {
        self.between(limits.map(f64::ln)).exp()
    }

    fn gyro(&mut self) -> Gyro {
        Gyro::ALL[self.random.random_range(0..Gyro::ALL.len())]
    }

    /// A standard normal number (Box and Muller).
    fn normal(&mut self) -> f64 {
        // The radius is above 0, so that its logarithm is finite.
        let (radius, turn) = (1.0 - self.random.random::<f64>(), self.random.random::<f64>());
        (-2.0 * radius.ln()).sqrt() * (TAU * turn).cos()
    }

    /// Draws onset, duration, period, phase and time constant; other shape parameters keep their default.
    fn shape(&mut self, number: &ParameterSpec) -> f64 {
        let duration_s = self.motion.duration_s;
        let default = number.default.initial();
        match (number.role, number.default) {
            (Role::Onset, _) => self.between(WITHIN.map(|share| share * duration_s)),
            (Role::Duration, _) | (Role::TimeConstant, DefaultValue::Required) => {
                self.log_between([SHORTEST_PERIOD_S.min(0.3 * duration_s), 0.3 * duration_s])
            }
            (Role::Period, _) => self.log_between([SHORTEST_PERIOD_S.min(duration_s), duration_s]),
            (Role::Phase, _) => self.between([0.0, TAU]),
            (Role::TimeConstant | Role::Width, DefaultValue::Value(value)) => {
                let limits = [value / TIME_FACTOR, value * TIME_FACTOR];
                self.log_between(limits).clamp(number.min, number.max)
            }
            _ if default.is_finite() => default,
            _ => number.min.max(0.0),
        }
    }

    fn shapes(&mut self, numbers: &[ParameterSpec]) -> Vec<f64> {
        numbers.iter().map(|number| self.shape(number)).collect()
    }

    /// Draws an amplitude of the catalogue, constant or with a time course, that a diagnosis of the motion searches.
    pub fn amplitude(&mut self, strength: f64) -> Option<InjectedEffect> {
        let constants = AmplitudeRef::all(&self.motion.nominal.device).into_iter().filter(is_real);
        let all: Vec<AmplitudeRef> = constants.flat_map(AmplitudeRef::with_courses).filter(stays_possible).collect();
        (0..TRIES).find_map(|_| {
            let amplitude = *all.get(self.random.random_range(0..all.len()))?;
            let own_shapes = self.shapes(amplitude.own_shapes());
            let course_shapes = self.shapes(amplitude.course_shapes());
            let (gyro, on_all) = (self.gyro(), self.random.random_range(0..ON_ALL) == 0);
            let available = amplitude.gyros(&self.motion.nominal.device);
            let gyros = match amplitude.is_of_unit() || on_all && available.is_all() {
                true => Gyros::ALL,
                false if available[gyro.index()] => Gyros::ALL.only(gyro.index()),
                false => return None,
            };
            let is_negative = amplitude.number().min < 0.0 && self.random.random::<bool>();
            let hypothesis = Hypothesis { amplitude, value: 0.0, own_shapes, course_shapes, gyros };
            let sign = if is_negative { -1.0 } else { 1.0 };
            let found = self.motion.scaled(hypothesis, Origin::Catalogue, sign, strength);
            found.filter(|found| self.motion.searches(&found.hypothesis))
        })
    }

    /// Draws amplitudes of the catalogue that do not share parameters; no two compensate each other.
    pub fn amplitudes(&mut self, count: usize, strength: f64) -> Vec<InjectedEffect> {
        let mut injected: Vec<InjectedEffect> = Vec::new();
        for _ in 0..TRIES {
            if injected.len() < count {
                let compensates = |next: &InjectedEffect, own: &InjectedEffect| {
                    self.motion.cosine(&next.hypothesis, &own.hypothesis) > COMPENSATING_COSINE
                };
                let next = self.amplitude(strength).filter(|next| is_independent(next, &injected));
                injected.extend(next.filter(|next| !injected.iter().any(|own| compensates(next, own))));
            }
        }
        injected
    }

    /// Draws a term outside the catalogue of one to three factors.
    pub fn unknown(&mut self, strength: f64) -> Option<InjectedEffect> {
        let found = (0..TRIES).find_map(|_| {
            let factors = if self.random.random::<bool>() { 3 } else { self.random.random_range(1..=2) };
            let regressors: Vec<Regressor> =
                (0..factors).map(|_| Regressor::ALL[self.random.random_range(0..Regressor::COUNT)]).collect();
            let amplitude = AmplitudeRef::term(Formula::new(&regressors).ok()?);
            let (gyro, sign) = (self.gyro(), if self.random.random::<bool>() { 1.0 } else { -1.0 });
            let hypothesis = Hypothesis::constant(amplitude, 0.0, Gyros::ALL.only(gyro.index()));
            self.motion.scaled(hypothesis, Origin::Unknown, sign, strength)
        })?;
        Some(InjectedEffect { nearest: self.motion.nearest(&found.hypothesis), ..found })
    }

    /// Draws a noise of one gyro above the configured level; `None` if the unit has no such noise.
    fn noise(&mut self) -> Option<InjectedEffect> {
        let (gyro, factor) = (self.gyro(), self.log_between(NOISE_FACTOR));
        let configured = &self.motion.nominal.gyros[gyro.index()].effects.constant;
        let value = |effect: usize| configured.numbers(effect).value(0);
        let is_present = |effect: &usize| configured.is_noise(*effect) && value(*effect) > 0.0;
        let noises: Vec<usize> = (0..GyroEffects::SPECS.len()).filter(is_present).collect();
        let effect = *noises.get(self.random.random_range(0..noises.len().max(1)))?;
        let amplitude = AmplitudeRef::new(ParameterRef { list: EffectList::Head, effect, number: 0 }, None);
        let hypothesis = Hypothesis::constant(amplitude, value(effect) * factor, Gyros::ALL.only(gyro.index()));
        Some(self.without_signature(hypothesis, Origin::Noise))
    }

    /// Draws a wiring fault of one gyro, from the start or from an onset.
    fn wiring(&mut self) -> Option<InjectedEffect> {
        let gyro = self.gyro();
        let effect = self.random.random_range(0..WiringEffects::SPECS.len());
        let constant = AmplitudeRef::new(ParameterRef { list: EffectList::Wiring, effect, number: 0 }, None);
        let other = Gyro::ALL[(gyro.index() + self.random.random_range(1..4)) % 4];
        let value = match constant.number().form {
            ValueFormat::Flag => 1.0,
            ValueFormat::Gyro => other.index() as f64 + 1.0,
            ValueFormat::Whole | ValueFormat::Choice(_) => 0.0,
            ValueFormat::Real => return None,
        };
        let amplitude = constant.with(STEP).filter(|_| self.random.random::<bool>()).unwrap_or(constant);
        let course_shapes = self.shapes(amplitude.course_shapes());
        let hypothesis =
            Hypothesis { course_shapes, ..Hypothesis::constant(amplitude, value, Gyros::ALL.only(gyro.index())) };
        Some(self.without_signature(hypothesis, Origin::Wiring))
    }

    /// The assignments have no blanks.
    fn without_signature(&self, hypothesis: Hypothesis, origin: Origin) -> InjectedEffect {
        let mut injected = self.motion.injected(hypothesis, origin);
        injected.assignments.iter_mut().for_each(|own| *own = own.replace(" = ", "="));
        injected
    }

    /// Simulates the unit with the effects, new noise and small errors of the calibration parameters.
    pub fn simulate(&mut self, injected: &[InjectedEffect]) -> SimulatedRecording {
        let mut unit = self.motion.nominal.clone();
        injected.iter().for_each(|injected| injected.hypothesis.apply(&mut unit));
        for gyro in Gyro::ALL {
            for (index, number) in Calibration::NUMBERS.iter().enumerate() {
                if !Axes::of(gyro).has_number(number.name) {
                    continue;
                }
                let sigma = match number.name {
                    "scale_factor" => SCALE_ERROR,
                    name if name.starts_with("drift") => DRIFT_ERROR,
                    _ => MISALIGNMENT_ERROR,
                };
                *unit.gyros[gyro.index()].calibration.value_mut(index) += sigma * self.normal();
            }
        }
        unit.seed = self.random.random::<u64>() & i64::MAX as u64;
        simulate(&unit, self.motion.duration_s)
    }
}
