//! The standard survey motion as the unit is believed to fly it: what a change of the model adds there, and how well it can be told
//! from noise and nuisances.
//!
//! The Cramér–Rao bound of a size has the sixteen, the common lag and the walks beside it, not the shapes of the effect itself.

use std::sync::{Mutex, OnceLock, PoisonError};

use geu_calibration::CountsReader;
use geu_model::Configuration;
use geu_recording::Sink;

use super::fly::{SimulatedRecording, fly};
use super::hidden::{InjectedEffect, Origin};
use crate::bank::SignatureBank;
use crate::diagnosis::{DiagnosisOptions, diagnose_rows};
use crate::hypothesis::Hypothesis;
use crate::measured::{CHANNELS, MeasuredData, MeasuredError, Series, Shifts};
use crate::noise;
use crate::normal::{NormalEquations, Nuisance};
use crate::null::Thresholds;
use crate::outcome::{DiagnosedEffect, Diagnosis};
use crate::rivals::{Alternative, similar_hypotheses};
use crate::signature::Signature;
use crate::state::{DiagnosisCase, FittedHypothesis};
use crate::whitening::NoiseModel;

/// Length of the standard survey motion: three hours of the default scenario.
pub const SURVEY_S: f64 = 10_800.0;
/// Rounds in which a size is sought whose signature is as strong as asked.
const ROUNDS: usize = 12;
/// How near is near enough.
const NEAR: f64 = 0.005;
/// Share of a size by which it is moved for its sigma.
const STEP: f64 = 0.01;
/// Share of the greatest value with which the search for a size begins; a formula's coefficient begins at 10⁻⁶.
const SHARE: f64 = 1e-3;
const COEFFICIENT: f64 = 1e-6;

/// The motion, what is believed of the unit on it, and its noise.
pub struct TrialMotion {
    /// What is believed.
    pub believed: Configuration,
    /// On-board time flown.
    pub duration_s: f64,
    measured: MeasuredData,
    from: Series,
    noise: [NoiseModel; CHANNELS],
    nuisances: Vec<Nuisance>,
    normal: NormalEquations,
    bank: OnceLock<SignatureBank>,
    thresholds: OnceLock<Thresholds>,
}

/// A change of the size asked for.
pub struct ScaledHypothesis {
    /// The change.
    pub hypothesis: Hypothesis,
    /// Cramér–Rao bound of its size.
    pub sigma: f64,
    /// Size of its signature beside the nuisances, in sigmas of the noise.
    pub strength: f64,
}

impl TrialMotion {
    /// Flies the unit as it is believed.
    ///
    /// # Errors
    /// A duration that is too short for a diagnosis.
    pub fn new(believed: Configuration, duration_s: f64) -> Result<TrialMotion, MeasuredError> {
        let flight = fly(&believed, duration_s);
        let mut reader = CountsReader::default();
        flight.rows.iter().for_each(|row| reader.row(row));
        let counts = reader.finish(believed.start_unix_ns).ok_or(MeasuredError::Empty)?;
        let measured = MeasuredData::new(counts, &flight.reference)?;
        let from = measured.run(&believed, Shifts::default());
        let residual = measured.residual(&from);
        let noise = noise::of(&believed, &measured, &residual);
        let case = DiagnosisCase::new(&measured, &believed);
        let normal = NormalEquations::new(case.whitenings(&noise), &residual, &case.nuisances);
        let nuisances = case.nuisances;
        let (bank, thresholds) = Default::default();
        Ok(TrialMotion { believed, duration_s, measured, from, noise, nuisances, normal, bank, thresholds })
    }

    /// What the difference of two configurations adds; the first has more.
    fn signature(&self, moved: &Series, from: &Series) -> Signature {
        Signature::new(&self.normal, &self.measured.difference(moved, from).map(Some))
    }

    fn run(&self, configuration: &Configuration) -> Series {
        self.measured.run(configuration, Shifts::default())
    }

    fn strength(&self, signature: &Signature) -> Option<f64> {
        self.normal.gain(&signature.products).map(|gain| gain.sigma.recip())
    }

    /// The signature of a hypothesis where the temperature is told so much late; none where it cannot be told from the nuisances.
    fn signature_of(&self, hypothesis: &Hypothesis, temperature_s: f64) -> Option<Signature> {
        let mut moved = self.believed.clone();
        hypothesis.apply(&mut moved);
        let shifts = Shifts { temperature_s, ..Shifts::default() };
        let [with, without] = [&moved, &self.believed].map(|configuration| self.measured.run(configuration, shifts));
        let signature = self.signature(&with, &without);
        self.strength(&signature).map(|_| signature)
    }

    /// Cosine of the signatures of what was hidden and what was found, whitened and beside the nuisances, without sign; 0 where one
    /// of them has none. What was found stands there with the numbers found, or with those with which it is most like what was
    /// hidden: noise moves a shape, and that makes it no other name. It is meant with a temperature that is told so much late.
    pub fn signature_cosine(&self, hidden: &InjectedEffect, found: &DiagnosedEffect, temperature_late_s: f64) -> f64 {
        let Some(hypothesis) = found.hypothesis().filter(|own| own.amplitude.has_signature()) else { return 0.0 };
        if !matches!(hidden.origin, Origin::Catalogue | Origin::Unknown) {
            return 0.0;
        }
        let (one, other) =
            (self.signature_of(&hidden.hypothesis, 0.0), self.signature_of(&hypothesis, temperature_late_s));
        let (Some(one), Some(other)) = (one, other) else { return 0.0 };
        let as_found = one.cosine(&self.normal, &other);
        let rivals = self.rivals(&hidden.hypothesis, temperature_late_s);
        let is_found = |rival: &&Alternative| {
            rival.hypothesis.amplitude.code() == found.code && rival.hypothesis.gyros == found.gyros
        };
        rivals.iter().find(is_found).map_or(as_found, |rival| rival.cosine.max(as_found))
    }

    /// The change with a size whose signature is of that strength; nothing where none is within limits, or it cannot be told from the
    /// nuisances. Counts are whole ones, and so as strong or stronger.
    pub fn sized(&self, mut change: Hypothesis, sign: f64, strength: f64) -> Option<ScaledHypothesis> {
        let limits = change.amplitude.size();
        let is_formula = change.amplitude.formula().is_some();
        change.value = sign * if is_formula { COEFFICIENT } else { SHARE * limits.greatest };
        let run = |change: &Hypothesis| {
            let mut moved = self.believed.clone();
            change.apply(&mut moved);
            change.is_within_limits().then(|| self.run(&moved))
        };
        let of = |change: &Hypothesis| self.strength(&self.signature(&run(change)?, &self.from));
        let mut now = of(&change)?;
        for _ in 0..ROUNDS {
            if (now / strength - 1.0).abs() < NEAR {
                break;
            }
            change.value *= strength / now;
            now = of(&change)?;
        }
        if change.amplitude.is_count() {
            change.value = sign * change.value.abs().ceil();
            now = of(&change)?;
        } else if (now / strength - 1.0).abs() >= NEAR {
            return None;
        }
        let aside = Hypothesis { value: change.value * (1.0 - STEP), ..change.clone() };
        let slope = self.strength(&self.signature(&run(&change)?, &run(&aside)?))?;
        Some(ScaledHypothesis { sigma: STEP * change.value.abs() / slope, strength: now, hypothesis: change })
    }

    /// The amplitude of the catalogue that looks most like a change, and the cosine of the two.
    pub fn nearest(&self, change: &Hypothesis) -> Option<(String, f64)> {
        let nearest = self.rivals(change, 0.0).into_iter().next()?;
        Some((nearest.hypothesis.amplitude.code(), nearest.cosine))
    }

    /// The amplitudes of the catalogue that look like a change where the temperature is told so much late, the most alike first.
    fn rivals(&self, change: &Hypothesis, temperature_late_s: f64) -> Vec<Alternative> {
        let bank = self.bank.get_or_init(|| SignatureBank::new(&self.measured, &self.believed));
        let nuisances = self.nuisances.clone();
        let case = DiagnosisCase { measured: &self.measured, believed: &self.believed, nuisances };
        let mut state = case.start(self.noise);
        state.held.push(FittedHypothesis::new(change.clone()));
        similar_hypotheses(&case, &bank.late(temperature_late_s), &state, 0)
    }

    /// Diagnoses a flight. The thresholds are those of a flight with nothing hidden, for all flights of this motion: a key of
    /// the key of a recording would differ with the goodness of single blocks and the white noise told by the data, and
    /// thresholds hardly do.
    ///
    /// # Errors
    /// As [`diagnose_rows`].
    pub fn diagnose(&self, flight: &SimulatedRecording) -> Result<Diagnosis, MeasuredError> {
        if self.thresholds.get().is_none() {
            let mut believed = self.believed.clone();
            believed.seed = believed.seed.wrapping_add(1) & i64::MAX as u64;
            let first = Mutex::new(None);
            self.diagnose_with(&fly(&believed, self.duration_s), &|_| None, &|_, thresholds| {
                *first.lock().unwrap_or_else(PoisonError::into_inner) = Some(thresholds.clone());
            })?;
            if let Some(thresholds) = first.into_inner().unwrap_or_else(PoisonError::into_inner) {
                // Another thread may have been faster, with the same.
                let _ = self.thresholds.set(thresholds);
            }
        }
        self.diagnose_with(flight, &|_| self.thresholds.get().cloned(), &|_, _| {})
    }

    fn diagnose_with(
        &self,
        flight: &SimulatedRecording,
        known: &(dyn Fn(u64) -> Option<Thresholds> + Sync),
        keep: &(dyn Fn(u64, &Thresholds) + Sync),
    ) -> Result<Diagnosis, MeasuredError> {
        let clock_start_ns = flight.reference.start_ns;
        let settings = DiagnosisOptions { seed: 1, clock_start_ns, known, keep, manoeuvres: None, progress: &|_| {} };
        diagnose_rows(&flight.rows, &[], &self.believed, &flight.reference, &settings)
    }
}
