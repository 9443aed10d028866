//! The standard survey motion of the nominal unit: signatures of hypotheses on it, and their size relative to noise and nuisance
//! parameters.
//!
//! The nuisance parameters of a Cramér–Rao bound are the calibration parameters, the common lag and the random walks, without the
//! shape parameters of the effect.

use std::sync::{Arc, OnceLock};

use geu_calibration::CountsReader;
use geu_model::Configuration;
use geu_recording::{ReceivedSample, ReferenceAttitude, Sink};

use crate::injected::{InjectedEffect, Origin};
use crate::simulate::{SimulatedRecording, simulate};
use geu_diagnosis::alternatives::{Alternative, similar_hypotheses};
use geu_diagnosis::diagnosis_case::DiagnosisCase;
use geu_diagnosis::fitted_hypothesis::FittedHypothesis;
use geu_diagnosis::measured::TIMING;
use geu_diagnosis::measured::{CHANNELS, MeasuredData, MeasuredError, ModelRun, Shifts};
use geu_diagnosis::noise;
use geu_diagnosis::normal_equations::{NormalEquations, Nuisance};
use geu_diagnosis::null_distribution::Thresholds;
use geu_diagnosis::outcome::{DiagnosedEffect, Diagnosis};
use geu_diagnosis::rounding::{CLOSED_LOOP, Rounding, correlation_with_motion};
use geu_diagnosis::signature::Signature;
use geu_diagnosis::signature_bank::SignatureBank;
use geu_diagnosis::small_motions::{SMALL_COUNTS, unknown_rate_arcsec_per_s};
use geu_diagnosis::whitening::NoiseModel;
use geu_diagnosis::{DiagnosisOptions, diagnose_rows};
use geu_hypothesis::Hypothesis;

/// Length of the standard survey motion: three hours of the default scenario.
pub const SURVEY_S: f64 = 10_800.0;
/// Maximum number of iterations for an amplitude, and the accepted relative error of its strength.
const ITERATIONS: usize = 12;
const TOLERANCE: f64 = 0.005;
/// Relative change of an amplitude for its sigma.
const STEP: f64 = 0.01;
/// Initial amplitude as a share of its limit, and the initial coefficient of a formula.
const INITIAL_SHARE: f64 = 1e-3;
const INITIAL_COEFFICIENT: f64 = 1e-6;

/// The motion with the nominal unit and its noise.
pub struct TrialMotion {
    /// The nominal unit.
    pub nominal: Configuration,
    /// On-board time simulated.
    pub duration_s: f64,
    measured: MeasuredData,
    from: ModelRun,
    noise: [NoiseModel; CHANNELS],
    nuisances: Vec<Nuisance>,
    rounding: Arc<Rounding>,
    normal: NormalEquations,
    bank: OnceLock<SignatureBank>,
    thresholds: OnceLock<Thresholds>,
}

impl TrialMotion {
    /// Simulates the nominal unit.
    ///
    /// # Errors
    /// A duration that is too short for a diagnosis.
    pub fn new(nominal: Configuration, duration_s: f64) -> Result<TrialMotion, MeasuredError> {
        let recording = simulate(&nominal, duration_s);
        let motion = TrialMotion::of_recording(nominal, &recording.rows, &recording.reference)?;
        Ok(TrialMotion { duration_s, ..motion })
    }

    /// The motion of an effect-free recording of the nominal unit.
    ///
    /// # Errors
    /// A recording that is too short for a diagnosis.
    pub fn of_recording(
        nominal: Configuration,
        rows: &[ReceivedSample],
        reference: &ReferenceAttitude,
    ) -> Result<TrialMotion, MeasuredError> {
        let mut reader = CountsReader::default();
        rows.iter().for_each(|row| reader.row(row));
        let counts = reader.finish(reference.start_ns).ok_or(MeasuredError::Empty)?;
        let measured = MeasuredData::new(counts, reference, &nominal)?;
        let duration_s = measured.duration_s();
        let from = measured.run(&nominal, Shifts::default());
        let residual = measured.residual(&from);
        let case = DiagnosisCase::new(&measured, &nominal);
        let noise = noise::configured(&nominal, &measured, &case.rounding, &residual);
        let normal = NormalEquations::new(case.whitenings(&noise), &residual, &case.nuisances, &[]);
        let DiagnosisCase { nuisances, rounding, .. } = case;
        let (bank, thresholds) = Default::default();
        Ok(TrialMotion { nominal, duration_s, measured, from, noise, nuisances, rounding, normal, bank, thresholds })
    }

    /// The unit with a hypothesis.
    fn with(&self, hypothesis: &Hypothesis) -> Configuration {
        let mut configuration = self.nominal.clone();
        hypothesis.apply(&mut configuration);
        configuration
    }

    /// The difference between two model runs.
    fn signature(&self, with: &ModelRun, without: &ModelRun) -> Signature {
        Signature::new(&self.normal, &self.measured.difference(with, without).map(Some))
    }

    fn strength(&self, signature: &Signature) -> Option<f64> {
        self.normal.gain(&signature.products).map(|gain| gain.sigma.recip())
    }

    /// The signature of a hypothesis with a lagged temperature; `None` if the nuisance parameters can replace it.
    fn signature_of(&self, hypothesis: &Hypothesis, temperature_s: f64) -> Option<Signature> {
        let shifts = Shifts { temperature_s, ..Shifts::default() };
        let run = |configuration: &Configuration| self.measured.run(configuration, shifts);
        let signature = self.signature(&run(&self.with(hypothesis)), &run(&self.nominal));
        self.strength(&signature).map(|_| signature)
    }

    /// Cosine of the whitened signatures of an injected and a reported effect, without sign, with the nuisance parameters projected
    /// out; 0 if either has no signature. The reported effect has the estimated shape parameters or those with which it is most
    /// similar, because noise moves a shape without changing the effect. Its temperature lags by `temperature_late_s`.
    pub fn signature_cosine(&self, injected: &InjectedEffect, found: &DiagnosedEffect, temperature_late_s: f64) -> f64 {
        let Some(hypothesis) = found.hypothesis().filter(|own| own.amplitude.has_signature()) else { return 0.0 };
        if !matches!(injected.origin, Origin::Catalogue | Origin::Unknown) {
            return 0.0;
        }
        let signatures =
            (self.signature_of(&injected.hypothesis, 0.0), self.signature_of(&hypothesis, temperature_late_s));
        let (Some(one), Some(other)) = signatures else { return 0.0 };
        let as_found = one.cosine(&self.normal, &other);
        let similar = self.similar(&injected.hypothesis, temperature_late_s);
        let is_found = |other: &&Alternative| {
            other.hypothesis.amplitude.code() == found.code && other.hypothesis.gyros == found.gyros
        };
        similar.iter().find(is_found).map_or(as_found, |other| other.cosine.max(as_found))
    }

    /// Absolute cosine of the whitened signatures of two effects, with the nuisance parameters projected out; 0 if either has none.
    pub(super) fn cosine(&self, one: &Hypothesis, other: &Hypothesis) -> f64 {
        let signatures = self.signature_of(one, 0.0).zip(self.signature_of(other, 0.0));
        signatures.map_or(0.0, |(one, other)| one.cosine(&self.normal, &other))
    }

    /// An injected effect without a signature.
    pub(super) fn injected(&self, hypothesis: Hypothesis, origin: Origin) -> InjectedEffect {
        let assignments = hypothesis.assignments(&self.with(&hypothesis));
        InjectedEffect { hypothesis, origin, sigma: None, strength: None, nearest: None, assignments }
    }

    /// False for a dead zone that a diagnosis does not search on this motion.
    pub(super) fn searches(&self, hypothesis: &Hypothesis) -> bool {
        if !hypothesis.amplitude.filters_motion() {
            return true;
        }
        let answers_counts = correlation_with_motion(&self.measured, &self.from) > CLOSED_LOOP;
        self.bank().searches(
            hypothesis,
            unknown_rate_arcsec_per_s(&self.measured, &self.nominal, answers_counts, &[SMALL_COUNTS; TIMING]),
        )
    }

    fn bank(&self) -> &SignatureBank {
        self.bank.get_or_init(|| SignatureBank::new(&self.measured, &self.nominal))
    }

    /// The hypothesis with the amplitude at which its signature has this strength. `None` if no amplitude within the limits has, or the
    /// nuisance parameters can replace the effect. Counts are rounded up to whole numbers.
    pub fn scaled(
        &self,
        mut hypothesis: Hypothesis,
        origin: Origin,
        sign: f64,
        strength: f64,
    ) -> Option<InjectedEffect> {
        let limits = hypothesis.amplitude.size();
        let is_formula = hypothesis.amplitude.formula().is_some();
        hypothesis.value = sign * if is_formula { INITIAL_COEFFICIENT } else { INITIAL_SHARE * limits.max };
        let run =
            |own: &Hypothesis| own.is_within_limits().then(|| self.measured.run(&self.with(own), Shifts::default()));
        let strength_of = |own: &Hypothesis| self.strength(&self.signature(&run(own)?, &self.from));
        let mut now = strength_of(&hypothesis)?;
        for _ in 0..ITERATIONS {
            if (now / strength - 1.0).abs() < TOLERANCE {
                break;
            }
            hypothesis.value *= strength / now;
            now = strength_of(&hypothesis)?;
        }
        if hypothesis.amplitude.is_count() {
            hypothesis.value = sign * hypothesis.value.abs().ceil();
            now = strength_of(&hypothesis)?;
        } else if (now / strength - 1.0).abs() >= TOLERANCE {
            return None;
        }
        let smaller = Hypothesis { value: hypothesis.value * (1.0 - STEP), ..hypothesis.clone() };
        let slope = self.strength(&self.signature(&run(&hypothesis)?, &run(&smaller)?))?;
        let sigma = Some(STEP * hypothesis.value.abs() / slope);
        Some(InjectedEffect { sigma, strength: Some(now), ..self.injected(hypothesis, origin) })
    }

    /// The most similar amplitude of the catalogue, and the cosine.
    pub(super) fn nearest(&self, hypothesis: &Hypothesis) -> Option<(String, f64)> {
        let nearest = self.similar(hypothesis, 0.0).into_iter().next()?;
        Some((nearest.hypothesis.amplitude.code(), nearest.cosine))
    }

    /// Similar amplitudes of the catalogue with a lagged temperature, the most similar first.
    fn similar(&self, hypothesis: &Hypothesis, temperature_late_s: f64) -> Vec<Alternative> {
        let bank = self.bank();
        let (nuisances, rounding) = (self.nuisances.clone(), self.rounding.clone());
        let case = DiagnosisCase::with_signatures(&self.measured, &self.nominal, nuisances, rounding);
        let mut state = case.start(self.noise);
        state.held.push(FittedHypothesis::new(hypothesis.clone()));
        similar_hypotheses(&case, &bank.late(temperature_late_s), &state, 0)
    }

    /// Diagnoses a recording of this motion. The thresholds of one effect-free recording serve all: they hardly depend on single
    /// blocks and on the white noise of a recording.
    ///
    /// # Errors
    /// See [`diagnose_rows`].
    pub fn diagnose(&self, recording: &SimulatedRecording) -> Result<Diagnosis, MeasuredError> {
        self.diagnose_with_plans(recording, false)
    }

    /// Diagnoses a recording of this motion; with `plans_manoeuvres` manoeuvres that separate alternatives are proposed.
    pub fn diagnose_with_plans(
        &self,
        recording: &SimulatedRecording,
        plans_manoeuvres: bool,
    ) -> Result<Diagnosis, MeasuredError> {
        if self.thresholds.get().is_none() {
            let seed = self.nominal.seed.wrapping_add(1) & i64::MAX as u64;
            let effect_free = simulate(&Configuration { seed, ..self.nominal.clone() }, self.duration_s);
            // Another thread may have stored the same thresholds.
            let _ = self.thresholds.set(self.diagnose_with(&effect_free, None, false)?.thresholds);
        }
        self.diagnose_with(recording, self.thresholds.get(), plans_manoeuvres)
    }

    fn diagnose_with(
        &self,
        recording: &SimulatedRecording,
        thresholds: Option<&Thresholds>,
        plans_manoeuvres: bool,
    ) -> Result<Diagnosis, MeasuredError> {
        let options = DiagnosisOptions {
            known: &|_| thresholds.cloned(),
            plans_manoeuvres,
            ..DiagnosisOptions::new(recording.reference.start_ns)
        };
        diagnose_rows(&recording.rows, &[], &self.nominal, &recording.reference, &options)
    }
}
