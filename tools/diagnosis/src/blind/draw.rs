//! Draws what is hidden, through the model's own lists: no effect is named here.

use std::f64::consts::TAU;

use geu_model::course::{KINDS, TimeFunction};
use geu_model::effect::discovered::{Formula, Regressor};
use geu_model::effect::{Effects, GyroEffects, WiringEffects};
use geu_model::fault::{EffectList, ParameterRef};
use geu_model::number::{DefaultValue, ParameterSet, ParameterSpec, Role, ValueFormat};
use geu_model::package::{Axes, Calibration};
use geu_protocol::Gyro;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::fly::{SimulatedRecording, fly};
use super::hidden::{AnswerKey, InjectedEffect, Origin};
use super::survey::{ScaledHypothesis, TrialMotion};
use crate::amplitude::{AmplitudeRef, STEP, is_real};
use crate::gyros::{ALL_GYROS, only};
use crate::hypothesis::Hypothesis;

/// Strengths that [`hide`] chooses from, in sigmas.
const STRENGTHS: [f64; 6] = [3.0, 4.5, 6.0, 9.0, 12.0, 24.0];
/// What happens at some time does so within this part of the recording.
const WITHIN: [f64; 2] = [0.15, 0.85];
/// Shortest period, s; the longest is the recording.
const SHORTEST_PERIOD_S: f64 = 1200.0;
/// A time constant is drawn between its default over this and as many times it.
const TIME_FACTOR: f64 = 3.0;
/// How many times larger a noise is than believed.
const LOUDER: [f64; 2] = [3.0, 10.0];
/// Of effects of one gyro, one in so many is on all four alike.
const ON_ALL: u32 = 8;
/// Draws until something fits.
const TRIES: usize = 200;
/// One sigma of the errors of the sixteen: of a scale factor, of a drift in arcsec per sample interval, of a misalignment in arcsec.
const SCALE_OFF: f64 = 6e-6;
const DRIFT_OFF: f64 = 1.2 / 7200.0;
const MISALIGNMENT_OFF: f64 = 1.5;

/// Hides from none to three things, and flies the unit that has them: one time in seven none, one in seven a term outside the
/// catalogue, else amplitudes, and now and then a noise or a wiring fault.
pub fn generate_trial(survey: &TrialMotion, seed: u64) -> (AnswerKey, SimulatedRecording) {
    let mut draw = TrialGenerator::new(survey, seed, 0);
    let mut hidden: Vec<InjectedEffect> = Vec::new();
    let count = match draw.random.random_range(0..7) {
        0 => 0,
        1 => {
            let strength = draw.strength();
            hidden.extend(draw.unknown(strength));
            1
        }
        _ => draw.random.random_range(1..=3),
    };
    for _ in 0..TRIES {
        if hidden.len() >= count {
            break;
        }
        let strength = draw.strength();
        let next = match draw.random.random_range(0..10) {
            0 => draw.noise(),
            1 => draw.wiring(),
            _ => draw.amplitude(strength),
        };
        // Courses of one effect share its shapes, and a swap moves what another fault did.
        let is_other = |next: &InjectedEffect| {
            let alike =
                |own: &InjectedEffect| own.code().starts_with(&next.code()) || next.code().starts_with(&own.code());
            !hidden.iter().any(|own| alike(own) || own.origin == Origin::Wiring && next.origin == Origin::Wiring)
        };
        hidden.extend(next.filter(is_other));
    }
    let flight = draw.fly(&hidden);
    (AnswerKey { seed, duration_s: survey.duration_s, hidden }, flight)
}

/// Whether nothing that cannot be below zero, a clearance, swings through it.
fn stays_possible(amplitude: &AmplitudeRef) -> bool {
    let shapes: Vec<f64> = amplitude.course_shapes().iter().map(|number| number.least.max(1.0)).collect();
    let law = amplitude.kind.map(|kind| KINDS[kind].law(&shapes));
    amplitude.number().least < 0.0 || !matches!(law, Some(TimeFunction::Temperature | TimeFunction::Periodic { .. }))
}

/// Draws for one recording.
pub struct TrialGenerator<'a> {
    survey: &'a TrialMotion,
    random: ChaCha8Rng,
}

impl<'a> TrialGenerator<'a> {
    /// The draws of one recording: a function of seed and stream alone.
    pub fn new(survey: &'a TrialMotion, seed: u64, stream: u64) -> TrialGenerator<'a> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(stream);
        TrialGenerator { survey, random }
    }

    fn strength(&mut self) -> f64 {
        STRENGTHS[self.random.random_range(0..STRENGTHS.len())]
    }

    fn between(&mut self, [least, greatest]: [f64; 2]) -> f64 {
        least + (greatest - least) * self.random.random::<f64>()
    }

    fn log_between(&mut self, [least, greatest]: [f64; 2]) -> f64 {
        self.between([least.ln(), greatest.ln()]).exp()
    }

    fn gyro(&mut self) -> Gyro {
        Gyro::ALL[self.random.random_range(0..Gyro::ALL.len())]
    }

    /// A standard normal number.
    fn normal(&mut self) -> f64 {
        // Box and Muller; of 1 less a number below 1, so that the logarithm is finite.
        let (radius, turn) = (1.0 - self.random.random::<f64>(), self.random.random::<f64>());
        (-2.0 * radius.ln()).sqrt() * (TAU * turn).cos()
    }

    /// A value of a shape: a time somewhere in the recording, a period, a phase, a time constant; what else has a default keeps it.
    fn shape(&mut self, number: &ParameterSpec) -> f64 {
        let duration_s = self.survey.duration_s;
        let default = number.default.initial();
        match (number.role, number.default) {
            (Role::Onset, _) => self.between(WITHIN.map(|share| share * duration_s)),
            (Role::Period, _) => self.log_between([SHORTEST_PERIOD_S.min(duration_s), duration_s]),
            (Role::Phase, _) => self.between([0.0, TAU]),
            (Role::TimeConstant, DefaultValue::Value(value)) => {
                let limits = [value / TIME_FACTOR, value * TIME_FACTOR];
                self.log_between(limits).clamp(number.least, number.greatest)
            }
            _ if default.is_finite() => default,
            _ => number.least.max(0.0),
        }
    }

    /// An amplitude of the catalogue, constant or with a course, of that strength.
    pub fn amplitude(&mut self, strength: f64) -> Option<InjectedEffect> {
        let constants = AmplitudeRef::all().into_iter().filter(is_real);
        let all: Vec<AmplitudeRef> = constants.flat_map(AmplitudeRef::with_courses).filter(stays_possible).collect();
        let one = |draw: &mut Self| {
            let amplitude = *all.get(draw.random.random_range(0..all.len()))?;
            let own_shapes = amplitude.own_shapes().iter().map(|number| draw.shape(number)).collect();
            let course_shapes = amplitude.course_shapes().iter().map(|number| draw.shape(number)).collect();
            let (gyro, on_all) = (draw.gyro(), draw.random.random_range(0..ON_ALL) == 0);
            let available = amplitude.gyros();
            let gyros = match amplitude.is_of_unit() || on_all && available == ALL_GYROS {
                true => ALL_GYROS,
                false if available[gyro as usize] => only(gyro as usize),
                false => return None,
            };
            let is_negative = amplitude.number().least < 0.0 && draw.random.random::<bool>();
            let change = Hypothesis { amplitude, value: 0.0, own_shapes, course_shapes, gyros };
            draw.survey.sized(change, if is_negative { -1.0 } else { 1.0 }, strength)
        };
        let found = (0..TRIES).find_map(|_| one(self))?;
        Some(self.hidden(found, Origin::Catalogue))
    }

    /// A term that stands in no catalogue, of that strength: half of them of one or two factors, which a diagnosis tries, and half of
    /// three, which it does not.
    pub fn unknown(&mut self, strength: f64) -> Option<InjectedEffect> {
        let one = |draw: &mut Self| {
            let factors = if draw.random.random::<bool>() { 3 } else { draw.random.random_range(1..=2) };
            let regressors: Vec<Regressor> =
                (0..factors).map(|_| Regressor::ALL[draw.random.random_range(0..Regressor::COUNT)]).collect();
            let amplitude = AmplitudeRef::term(Formula::new(&regressors).ok()?);
            let (gyro, sign) = (draw.gyro(), if draw.random.random::<bool>() { 1.0 } else { -1.0 });
            let change = Hypothesis::constant(amplitude, 0.0, only(gyro as usize));
            draw.survey.sized(change, sign, strength)
        };
        let found = (0..TRIES).find_map(|_| one(self))?;
        let nearest = self.survey.nearest(&found.hypothesis);
        Some(InjectedEffect { nearest, ..self.hidden(found, Origin::Unknown) })
    }

    fn hidden(
        &self,
        ScaledHypothesis { hypothesis, sigma, strength }: ScaledHypothesis,
        origin: Origin,
    ) -> InjectedEffect {
        InjectedEffect { sigma: Some(sigma), strength: Some(strength), ..self.without_bound(hypothesis, origin) }
    }

    /// What has no signature.
    fn without_bound(&self, hypothesis: Hypothesis, origin: Origin) -> InjectedEffect {
        let mut configuration = self.survey.believed.clone();
        hypothesis.apply(&mut configuration);
        let (sigma, strength, nearest) = (None, None, None);
        let (assignments, gyros) = (hypothesis.assignments(&configuration), hypothesis.gyros);
        InjectedEffect { hypothesis, origin, gyros, sigma, strength, nearest, assignments }
    }

    /// A noise of one gyro that is larger than configured; none where the unit has none.
    fn noise(&mut self) -> Option<InjectedEffect> {
        let (gyro, louder) = (self.gyro(), self.log_between(LOUDER));
        let configured = &self.survey.believed.gyros[gyro as usize].effects.constant;
        let noises: Vec<usize> = (0..GyroEffects::SPECS.len()).filter(|&index| configured.is_noise(index)).collect();
        let effect = *noises.get(self.random.random_range(0..noises.len().max(1)))?;
        let value = configured.numbers(effect).value(0);
        let amplitude = AmplitudeRef::of(ParameterRef { list: EffectList::Head, effect, number: 0 }, None);
        let hypothesis = Hypothesis::constant(amplitude, value * louder, only(gyro as usize));
        (value > 0.0).then(|| self.compact(hypothesis, Origin::Noise))
    }

    /// A wiring fault of one gyro, from the start or from some time on.
    fn wiring(&mut self) -> Option<InjectedEffect> {
        let gyro = self.gyro();
        let effect = self.random.random_range(0..WiringEffects::SPECS.len());
        let constant = AmplitudeRef::of(ParameterRef { list: EffectList::Wiring, effect, number: 0 }, None);
        let other = Gyro::ALL[(gyro as usize + self.random.random_range(1..4)) % 4];
        let value = match constant.number().form {
            ValueFormat::Flag => 1.0,
            ValueFormat::Gyro => other as usize as f64 + 1.0,
            ValueFormat::Whole | ValueFormat::Choice(_) => 0.0,
            ValueFormat::Real => return None,
        };
        let amplitude = constant.with(STEP).filter(|_| self.random.random::<bool>()).unwrap_or(constant);
        let course_shapes = amplitude.course_shapes().iter().map(|number| self.shape(number)).collect();
        let hypothesis = Hypothesis { course_shapes, ..Hypothesis::constant(amplitude, value, only(gyro as usize)) };
        let mut hidden = self.compact(hypothesis, Origin::Wiring);
        if let Some(other) = amplitude.gyro_named(value) {
            hidden.gyros[other as usize] = true;
        }
        Some(hidden)
    }

    /// Its assignments without blanks.
    fn compact(&self, hypothesis: Hypothesis, origin: Origin) -> InjectedEffect {
        let mut hidden = self.without_bound(hypothesis, origin);
        hidden.assignments.iter_mut().for_each(|own| *own = own.replace(" = ", "="));
        hidden
    }

    /// Flies the unit with what is hidden, its sixteen a little off what is believed, its noise drawn anew.
    pub fn fly(&mut self, hidden: &[InjectedEffect]) -> SimulatedRecording {
        let mut unit = self.survey.believed.clone();
        hidden.iter().for_each(|hidden| hidden.hypothesis.apply(&mut unit));
        for gyro in Gyro::ALL {
            for (index, number) in Calibration::NUMBERS.iter().enumerate() {
                if !Axes::of(gyro).has_number(number.name) {
                    continue;
                }
                let sigma = match number.name {
                    "scale_factor" => SCALE_OFF,
                    name if name.starts_with("drift") => DRIFT_OFF,
                    _ => MISALIGNMENT_OFF,
                };
                *unit.gyros[gyro as usize].calibration.value_mut(index) += sigma * self.normal();
            }
        }
        unit.seed = self.random.random::<u64>() & i64::MAX as u64;
        fly(&unit, self.survey.duration_s)
    }
}
