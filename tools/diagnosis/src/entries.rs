//! The effects found, as they are reported: hypotheses, noises, lag, calibration parameters and wiring faults, each with its numbers,
//! its alternatives and what puts it into a configuration.

use geu_model::effect::{AngleRandomWalk, DriftRandomWalk, Effect, GyroEffects};
use geu_model::fault::{EffectList, ParameterRef};
use geu_model::number::ParameterSet;

use crate::amplitude::{AmplitudeRef, calibration_parameters};
use crate::bank::{ConstantSignature, HypothesisFamily, SignatureBank};
use crate::checks::WiringFault;
use crate::explain::Explained;
use crate::gyros::{ALL_GYROS, is_within, only};
use crate::hypothesis::Hypothesis;
use crate::measured::{CHANNELS, TIMING};
use crate::noise::Walk;
use crate::normal::dot;
use crate::null::Thresholds;
use crate::outcome::{Chi2Fall, Class, Correction, DiagnosedEffect, EstimatedValue, ReportedAlternative};
use crate::remedy::DiscriminatingTests;
use crate::rivals::{APART_CHI2, Alternative, Penalties, rivals};
use crate::search::search;
use crate::state::{DiagnosisCase, FittedHypothesis, ModelState};

/// A calibration number is told as moved from so many sigmas on: once in 1000 recordings of sixteen.
const RECALIBRATED_SIGMAS: f64 = 4.0;
/// A constant lag beyond this is not the link's (icd.md).
pub const LAG_S: f64 = 0.010;
/// What the link's own lag may be, up to 5 ms (icd.md): its mean, and one sigma.
const LINK_LAG_S: (f64, f64) = (0.0025, 0.0025 / 1.732_050_807_568_877_2);
/// Sigmas within which two gyros have the same size of an effect.
pub const SAME_SIGMAS: f64 = 3.0;
/// Cosine above which a calibration number and an effect are one thing.
const SAME: f64 = 0.9999;
/// Cosine above which two signatures are one.
const SAME_SIGNATURE: f64 = 0.999;
/// Rivals told at least, and at most with what would tell them apart.
const TOLD: usize = 8;

/// What effects are reported from.
pub struct Entries<'a> {
    /// Recording and configuration.
    pub case: &'a DiagnosisCase<'a>,
    /// Signatures searched.
    pub bank: &'a SignatureBank,
    /// Required falls of χ².
    pub thresholds: &'a Thresholds,
    /// Wiring faults of the exact checks.
    pub faults: &'a [WiringFault],
}

/// What a hypothesis is, with its numbers and these sigmas.
fn effect(hypothesis: &Hypothesis, sigmas: &[f64]) -> DiagnosedEffect {
    let formula = hypothesis.amplitude.formula();
    let numbers = hypothesis.parameters().into_iter().zip(sigmas.iter().copied().chain(std::iter::repeat(f64::NAN)));
    DiagnosedEffect {
        code: hypothesis.amplitude.code(),
        gyros: hypothesis.gyros,
        formula: formula.map(|formula| formula.to_string()),
        coefficient_unit: formula.map(|formula| formula.unit()),
        parameters: numbers.map(|(number, sigma)| EstimatedValue::new(number.name, number.value, sigma)).collect(),
        corrections: vec![Correction::Hypothesis(hypothesis.clone())],
        ..DiagnosedEffect::default()
    }
}

impl Entries<'_> {
    /// Wiring faults of the exact checks.
    pub fn faults(&self) -> Vec<DiagnosedEffect> {
        let of = |fault: &WiringFault| {
            let mut entry = effect(&fault.hypothesis, &[]);
            entry.parameters[0].written = Some(fault.hypothesis.amplitude.number().written(fault.hypothesis.value));
            entry.gyros = Default::default();
            fault.gyros.iter().for_each(|gyro| entry.gyros[*gyro as usize] = true);
            entry
        };
        self.faults.iter().map(of).collect()
    }

    /// The hypotheses held.
    pub fn effects(&self, explained: &Explained) -> Vec<DiagnosedEffect> {
        let remedies = DiscriminatingTests::new(self.case);
        let of = |(index, held): (usize, &FittedHypothesis)| {
            let (fall, threshold) = explained.worth(self.case, index);
            let prices = Penalties { found: threshold, of: &|family, change| self.thresholds.price(family, change) };
            let rivals = rivals(self.case, self.bank, &explained.state, index, &prices).into_iter();
            let mut rivals: Vec<Alternative> =
                rivals.filter(|rival| !is_the_same(&held.hypothesis.amplitude, rival)).collect();
            // The whole group, and what comes next.
            let in_group = rivals.iter().take_while(|rival| rival.behind_chi2 < APART_CHI2).count();
            rivals.truncate((in_group + 1).max(TOLD));
            let mut told = remedies.of(&explained.state, index, &rivals[..in_group.min(TOLD)]);
            told.resize(rivals.len(), None);
            let shown = |(rival, remedy): (&Alternative, Option<String>)| {
                ReportedAlternative::new(&rival.hypothesis, rival.cosine, rival.behind_chi2, remedy)
            };
            DiagnosedEffect {
                chi2: Some(Chi2Fall { fall, threshold }),
                held_out: Some(held.held_out),
                rivals: rivals.iter().zip(told).map(shown).collect(),
                ..effect(&held.hypothesis, &held.sigmas)
            }
        };
        explained.state.held.iter().enumerate().map(of).collect()
    }

    /// Walks that are larger than configured; gyros of one walk whose values agree are one entry.
    pub fn noises(&self, explained: &Explained) -> Vec<DiagnosedEffect> {
        struct Merged {
            walk: Walk,
            hypothesis: Hypothesis,
            sigma: f64,
            fall: f64,
        }
        let mut all: Vec<Merged> = Vec::new();
        for found in &explained.noise {
            let value = explained.state.noise[found.channel].walk(found.walk);
            let sigma = found.fitted.log_sigma;
            let same = all.iter_mut().find(|other| {
                let apart = (other.hypothesis.value / value).ln().abs();
                other.walk == found.walk && apart < SAME_SIGMAS * sigma.hypot(other.sigma)
            });
            match same {
                Some(Merged { hypothesis, sigma: other, fall, .. }) => {
                    // The weighted mean of the logarithms.
                    let (one, two) = (other.powi(-2), sigma.powi(-2));
                    let mean = (hypothesis.value.ln() * one + value.ln() * two) / (one + two);
                    *other = (one + two).powf(-0.5);
                    hypothesis.value = mean.exp();
                    hypothesis.gyros[found.channel] = true;
                    *fall += found.fitted.fall;
                }
                None => all.push(Merged {
                    walk: found.walk,
                    hypothesis: Hypothesis::constant(amplitude_of(found.walk), value, only(found.channel)),
                    sigma,
                    fall: found.fitted.fall,
                }),
            }
        }
        let threshold = self.thresholds.of(HypothesisFamily::NOISE);
        let of = |Merged { hypothesis, sigma, fall, .. }: &Merged| DiagnosedEffect {
            chi2: Some(Chi2Fall { fall: *fall, threshold }),
            ..effect(hypothesis, &[hypothesis.value * sigma])
        };
        let mut entries: Vec<DiagnosedEffect> = all.iter().map(of).collect();
        self.rival_noises(explained, &mut entries);
        entries
    }

    /// Hypotheses that explain nearly as much as larger noise does, were that as configured.
    fn rival_noises(&self, explained: &Explained, entries: &mut [DiagnosedEffect]) {
        if entries.is_empty() {
            return;
        }
        let mut state = explained.state.clone();
        for found in &explained.noise {
            let configured = found.configured(self.case.believed);
            state.noise[found.channel] = state.noise[found.channel].with(found.walk, configured);
        }
        let normal = self.case.normal(&mut state);
        let candidates = search(self.bank, &normal, &state, &|_| 0.0);
        for entry in entries {
            let fall = entry.chi2.map_or(0.0, |chi2| chi2.fall);
            let near = candidates.iter().filter(|candidate| {
                !candidate.hypothesis.amplitude.is_of_unit()
                    && is_within(&candidate.hypothesis.gyros, &entry.gyros)
                    && fall - candidate.gain.chi2 < APART_CHI2
            });
            // Noise has no signature, and so no cosine.
            let shown = near.map(|candidate| {
                let behind_chi2 = (fall - candidate.gain.chi2).max(0.0);
                ReportedAlternative::new(&candidate.hypothesis, 0.0, behind_chi2, None)
            });
            entry.rivals = shown.collect();
        }
    }

    /// A common lag that is more than a link's, as the effect that has its signature: a reference that is early looks the same.
    pub fn lag(&self, explained: &mut Explained) -> Option<DiagnosedEffect> {
        let state = &mut explained.state;
        let (lag_s, sigma) = (state.shifts.lag_s, state.lag_sigma_s);
        if lag_s.abs() <= LAG_S + SAME_SIGMAS * sigma {
            // At rest nothing shows a lag, and one that is not shown would only move the limit cycle.
            if sigma > LAG_S {
                state.shifts.lag_s = 0.0;
            }
            return None;
        }
        let (amplitude, ratio) = self.alike(self.case.nuisances.last()?, true)?;
        // Some of it is the link's.
        let link_s = if self.case.measured.counts.is_received { LINK_LAG_S } else { (0.0, 0.0) };
        let hypothesis = Hypothesis::constant(amplitude, (lag_s - link_s.0) * ratio, ALL_GYROS);
        state.shifts.lag_s = link_s.0;
        state.held.push(FittedHypothesis::fixed(hypothesis.clone()));
        let late = ReportedAlternative {
            code: if lag_s > 0.0 { "reference-early" } else { "reference-late" }.to_owned(),
            formula: None,
            gyros: ALL_GYROS,
            cosine: 1.0,
            behind_chi2: None,
            remedy: Some("a time stamp of unit and reference by one clock".to_owned()),
        };
        Some(DiagnosedEffect {
            chi2: Some(Chi2Fall { fall: (lag_s / sigma).powi(2), threshold: (LAG_S / sigma).powi(2) }),
            rivals: vec![late],
            ..effect(&hypothesis, &[sigma.hypot(link_s.1) * ratio.abs()])
        })
    }

    /// The constant amplitude, of the unit or of a gyro, that has the signature of a nuisance, and how much of it one unit of the
    /// nuisance is. On a short motion others look much like it: the most alike is meant.
    fn alike(&self, nuisance: &[Option<Vec<f64>>; CHANNELS], is_of_unit: bool) -> Option<(AmplitudeRef, f64)> {
        let steps = |values: &[f64]| -> Vec<f64> { values.windows(2).map(|pair| pair[1] - pair[0]).collect() };
        let of_base = |base: &ConstantSignature| {
            let (mut both, mut ones, mut others) = (0.0, 0.0, 0.0);
            for (channel, values) in nuisance.iter().enumerate().take(TIMING) {
                let Some(values) = values else { continue };
                let (one, other) = (steps(values), steps(base.values(channel)));
                both += dot(&one, &other);
                ones += dot(&one, &one);
                others += dot(&other, &other);
            }
            let cosine = if others > 0.0 { both.abs() / (ones * others).sqrt() } else { 0.0 };
            (cosine, base.amplitude, both / others)
        };
        let is_meant =
            |base: &&ConstantSignature| base.amplitude.is_of_unit() == is_of_unit && base.amplitude.formula().is_none();
        let all = self.bank.bases.iter().filter(is_meant).map(of_base);
        let (cosine, amplitude, ratio) = all.max_by(|one, other| one.0.total_cmp(&other.0))?;
        (cosine > SAME).then_some((amplitude, ratio))
    }

    /// Calibration parameters that moved.
    pub fn recalibrations(&self, state: &ModelState) -> Vec<DiagnosedEffect> {
        let mut entries: Vec<DiagnosedEffect> = Vec::new();
        for (index, (gyro, number)) in calibration_parameters().into_iter().enumerate() {
            let (moved, sigma) = (state.sixteen[index], state.sixteen_sigmas[index]);
            if moved.abs() <= RECALIBRATED_SIGMAS * sigma || sigma.is_nan() {
                continue;
            }
            let Some((amplitude, ratio)) = self.alike(&self.case.nuisances[index], false) else { continue };
            let found = EstimatedValue::new(amplitude.size().name, moved * ratio, sigma * ratio.abs());
            let total = self.case.believed.gyros[gyro as usize].calibration.value(number) + moved;
            // Digits beyond a hundredth of a sigma say nothing.
            let decimals = (2.0 - sigma.log10().floor()).clamp(0.0, 15.0) as usize;
            let value = format!("{total:.decimals$}").parse().expect("a number as it is written");
            let correction = Correction::Calibration { gyro, number, value, decimals };
            let fall = (moved / sigma).powi(2);
            let (code, gyros) = (amplitude.code(), only(gyro as usize));
            match entries.iter_mut().find(|entry| entry.code == code && entry.gyros == gyros) {
                Some(entry) => {
                    entry.parameters.push(found);
                    entry.corrections.push(correction);
                    entry.chi2 = entry.chi2.map(|chi2| Chi2Fall { fall: chi2.fall.max(fall), ..chi2 });
                }
                None => entries.push(DiagnosedEffect {
                    parameters: vec![found],
                    chi2: Some(Chi2Fall { fall, threshold: RECALIBRATED_SIGMAS.powi(2) }),
                    corrections: vec![correction],
                    code,
                    gyros,
                    class: Class::Recalibration,
                    ..DiagnosedEffect::default()
                }),
            }
        }
        entries
    }
}

/// The amplitude of a random walk.
fn amplitude_of(walk: Walk) -> AmplitudeRef {
    let spec = match walk {
        Walk::Angle => AngleRandomWalk::SPEC,
        Walk::Rate => DriftRandomWalk::SPEC,
    };
    let effect = GyroEffects::SPECS.iter().position(|other| *other == spec).expect("an effect of the list");
    AmplitudeRef::of(ParameterRef { list: EffectList::Head, effect, number: 0 }, None)
}

/// Whether a rival is what was found in other words: a course of it that is constant all through, or its law as a formula.
fn is_the_same(found: &AmplitudeRef, rival: &Alternative) -> bool {
    let other = &rival.hypothesis.amplitude;
    let is_course = found.kind.is_none() && other.kind.is_some() && other.is_of_same_effect(found);
    let is_law = found.formula().is_none() && other.formula().is_some();
    rival.cosine > SAME_SIGNATURE && (is_course || is_law)
}
