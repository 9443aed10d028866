//! The reported effects: hypotheses, noises, lag, calibration parameters and wiring faults, each with its parameters, alternatives and
//! corrections of the configuration.

use geu_model::effect::{
    AngleRandomWalk, BiasInstability, DriftRandomWalk, Effect, GyroEffects, Misalignment, ScaleFactorNoise,
};
use geu_model::fault::{EffectList, ParameterRef};
use geu_model::package::Calibration;
use geu_model::parameter_spec::ParameterSet;

use crate::alternatives::{AMBIGUITY_CHI2, Alternative, Penalties, alternatives};
use crate::diagnosis_case::DiagnosisCase;
use crate::discriminating_test::DiscriminatingTests;
use crate::fitted_hypothesis::FittedHypothesis;
use crate::linear_algebra::increment_products;
use crate::measured::{CHANNELS, TIMING};
use crate::model_selection::SelectedModel;
use crate::model_state::LAG_S;
use crate::next_manoeuvre::DiscriminatingTest;
use crate::noise::{self, Walk};
use crate::null_distribution::Thresholds;
use crate::outcome::{Chi2Fall, Class, Correction, DiagnosedEffect, EstimatedValue, ReportedAlternative};
use crate::search::{search, shape_penalty};
use crate::signature_bank::{ConstantSignature, EXACT_SIGNATURE, HypothesisFamily, SignatureBank};
use crate::significance::{FOUR_SIGMAS, THREE_SIGMAS};
use geu_checks::WiringFault;
use geu_hypothesis::CalibrationParameter;
use geu_hypothesis::Hypothesis;
use geu_hypothesis::amplitude::AmplitudeRef;

/// Lag of the link, up to 5 ms (protocol/ICD.md): mean and 1 sigma.
const LINK_LAG_S: (f64, f64) = (0.0025, 0.0025 / 1.732_050_807_568_877_2);
/// Minimum cosine of the signatures of a calibration parameter and of its effect: the one has the fitted lag, the other none.
const SAME_PARAMETER: f64 = 0.99;
/// Minimum cosine of equal signatures.
const SAME_SIGNATURE: f64 = 0.999;
/// Relative 1 sigma of a flicker by its model: the spectrum of processes one a decade is 0.89 to 1.05 times that of a flicker.
const FLICKER_SIGMA: f64 = 0.05;
/// Minimum number of reported alternatives, and maximum number of discriminating tests.
const ALTERNATIVES: usize = 8;

/// Inputs of the reported effects.
pub struct Entries<'a> {
    /// Recording and configuration.
    pub case: &'a DiagnosisCase<'a>,
    /// Searched signatures.
    pub bank: &'a SignatureBank,
    /// Required χ² reductions.
    pub thresholds: &'a Thresholds,
    /// Wiring faults of the exact checks.
    pub faults: &'a [WiringFault],
    /// True for manoeuvres that separate alternatives.
    pub plans_manoeuvres: bool,
}

/// A hypothesis as a reported effect, with these sigmas of its parameters.
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

/// Places of the alternatives that get a discriminating test, those with an onset last: in a new recording they are constant.
fn tested<'a>(group: impl Iterator<Item = &'a Hypothesis>) -> Vec<usize> {
    let mut places: Vec<(bool, usize)> = group.enumerate().map(|(place, own)| (own.has_onset(), place)).collect();
    places.sort_unstable();
    places.into_iter().take(ALTERNATIVES).map(|(_, place)| place).collect()
}

impl Entries<'_> {
    /// Wiring faults of the exact checks.
    pub fn faults(&self) -> Vec<DiagnosedEffect> {
        let of = |fault: &WiringFault| {
            let mut entry = effect(&fault.hypothesis, &[]);
            let (hypothesis, form) = (&fault.hypothesis, fault.hypothesis.amplitude.number().form);
            entry.parameters[0].written = Some(form.written_of(hypothesis.value, &hypothesis.unit_gyros()));
            entry.gyros = entry.gyros.unit().filter(|gyro| fault.gyros.iter().any(|own| own.index() == gyro));
            entry
        };
        self.faults.iter().map(of).collect()
    }

    /// Hypotheses.
    pub fn effects(&self, selected: &SelectedModel) -> Vec<DiagnosedEffect> {
        let tests = DiscriminatingTests::new(self.case);
        let of = |(index, held): (usize, &FittedHypothesis)| {
            let chi2 = selected.chi2_fall(self.case, index);
            let penalties = Penalties {
                found: chi2.threshold + shape_penalty(&held.hypothesis),
                of: &|family, own| self.thresholds.penalty(family, own) + shape_penalty(own),
            };
            let mut all = alternatives(self.case, self.bank, &selected.state, index, &penalties);
            all.retain(|other| !is_the_same(&held.hypothesis.amplitude, other));
            // The whole ambiguity group, and the next one.
            let in_group = all.iter().take_while(|other| other.delta_chi2 < AMBIGUITY_CHI2).count();
            all.truncate((in_group + 1).max(ALTERNATIVES));
            let group = all[..in_group].iter().filter(|_| self.plans_manoeuvres);
            let tested = tested(group.map(|other| &other.hypothesis));
            let chosen: Vec<Alternative> = tested.iter().map(|&place| all[place].clone()).collect();
            let mut tests_of_all = vec![None; all.len()];
            for (place, test) in tested.into_iter().zip(tests.select(&selected.state, index, &chosen)) {
                tests_of_all[place] = test;
            }
            let reported = |(other, test): (&Alternative, Option<DiscriminatingTest>)| {
                ReportedAlternative::new(&other.hypothesis, other.cosine, other.delta_chi2, test)
            };
            DiagnosedEffect {
                chi2: Some(chi2),
                held_out: Some(held.held_out),
                alternatives: all.iter().zip(tests_of_all).map(reported).collect(),
                ..effect(&held.hypothesis, &held.sigmas)
            }
        };
        selected.state.held.iter().enumerate().map(of).collect()
    }

    /// Walks above their configured growth, joined if they agree on several gyros.
    pub fn noises(&self, selected: &SelectedModel) -> Vec<DiagnosedEffect> {
        // Hypothesis, sigma of the logarithm, χ² reduction.
        let mut all: Vec<(Hypothesis, f64, f64)> = Vec::new();
        for found in &selected.noise {
            let (amplitude, value) = (amplitude_of(found.walk), selected.state.noise[found.channel].walk(found.walk));
            let sigma = found.fitted.log_sigma;
            let same = all.iter_mut().find(|(other, other_sigma, _)| {
                let difference = (other.value / value).ln().abs();
                other.amplitude == amplitude && difference < THREE_SIGMAS * sigma.hypot(*other_sigma)
            });
            match same {
                Some((hypothesis, other, fall)) => {
                    // The weighted mean of the logarithms.
                    let (one, two) = (other.powi(-2), sigma.powi(-2));
                    let mean = (hypothesis.value.ln() * one + value.ln() * two) / (one + two);
                    *other = (one + two).powf(-0.5);
                    hypothesis.value = mean.exp();
                    hypothesis.gyros = hypothesis.gyros.and(hypothesis.gyros.only(found.channel));
                    *fall += found.fitted.fall;
                }
                None => {
                    let hypothesis =
                        Hypothesis::constant(amplitude, value, self.case.measured.gyros().only(found.channel));
                    all.push((hypothesis, sigma, found.fitted.fall));
                }
            }
        }
        let threshold = self.thresholds.required(HypothesisFamily::NOISE);
        let of = |(hypothesis, sigma, fall): &(Hypothesis, f64, f64)| {
            let of_model = if hypothesis.amplitude == amplitude_of(Walk::Flicker) { FLICKER_SIGMA } else { 0.0 };
            DiagnosedEffect {
                chi2: Some(Chi2Fall { fall: *fall, threshold }),
                ..effect(hypothesis, &[hypothesis.value * sigma.hypot(of_model)])
            }
        };
        let mut entries: Vec<DiagnosedEffect> = all.iter().map(of).collect();
        // A further walk is accepted below its threshold; alone it is not stated. Nor is noise of which the configuration states none.
        let is_declared = |entry: &DiagnosedEffect| {
            entry.gyros.gyros().all(|gyro| noise::is_declared(self.case.nominal, gyro.index()))
        };
        entries.retain(|entry| !entry.is_below_threshold() && is_declared(entry));
        if !entries.is_empty() {
            self.noise_alternatives(selected, &mut entries);
        }
        entries
    }

    /// Adds the hypotheses that explain nearly as much as larger noise, with the configured noise.
    fn noise_alternatives(&self, selected: &SelectedModel, entries: &mut [DiagnosedEffect]) {
        let mut state = selected.state.clone();
        for found in &selected.noise {
            state.noise[found.channel] = state.noise[found.channel].with(found.walk, found.before);
        }
        let normal = self.case.normal(&mut state);
        let candidates = search(self.bank, &normal, &state, None);
        for entry in entries {
            let fall = entry.chi2.map_or(0.0, |chi2| chi2.fall);
            let near = candidates.iter().filter(|candidate| {
                !candidate.hypothesis.amplitude.is_of_unit()
                    && candidate.hypothesis.gyros.is_within(&entry.gyros)
                    && fall - candidate.gain.chi2 < AMBIGUITY_CHI2
            });
            // Noise has no signature, thus no cosine.
            let reported = near.map(|candidate| {
                let delta_chi2 = (fall - candidate.gain.chi2).max(0.0);
                ReportedAlternative::new(&candidate.hypothesis, 0.0, delta_chi2, None)
            });
            entry.alternatives = reported.collect();
        }
    }

    /// A common lag above that of a link, as the effect with its signature. A time offset of the reference has the same one.
    pub fn lag(&self, selected: &mut SelectedModel) -> Option<DiagnosedEffect> {
        let state = &mut selected.state;
        let (lag_s, sigma) = (self.case.measured.lag_s + state.shifts.lag_s, state.lag_sigma_s);
        if lag_s.abs() <= LAG_S + THREE_SIGMAS * sigma {
            state.reset_undetermined_lag();
            return None;
        }
        // The bank is that of a clock without error.
        let min_cosine = if self.case.measured.clock_ppm == 0.0 { EXACT_SIGNATURE } else { 0.0 };
        let is_offset = |own: &AmplitudeRef| own.is_of_unit() && (min_cosine > 0.0 || own.number().unit == "s");
        let (amplitude, ratio) = self.constant_effect(self.case.nuisances.last()?, is_offset, min_cosine)?;
        let ratio = if min_cosine > 0.0 { ratio } else { 1.0 };
        // A part of it is that of the link.
        let link_s = if self.case.measured.counts.is_received { LINK_LAG_S } else { (0.0, 0.0) };
        let hypothesis = Hypothesis::constant(amplitude, (lag_s - link_s.0) * ratio, self.case.measured.gyros());
        state.shifts.lag_s = link_s.0 - self.case.measured.lag_s;
        state.held.push(FittedHypothesis::fixed(hypothesis.clone()));
        let late = ReportedAlternative {
            code: if lag_s > 0.0 { "reference-early" } else { "reference-late" }.to_owned(),
            formula: None,
            gyros: self.case.measured.gyros(),
            cosine: 1.0,
            delta_chi2: None,
            discriminating_test: Some("a time stamp of unit and reference by one clock".to_owned()),
            next_manoeuvre: None,
            hypothesis: None,
        };
        Some(DiagnosedEffect {
            chi2: Some(Chi2Fall { fall: (lag_s / sigma).powi(2), threshold: (LAG_S / sigma).powi(2) }),
            alternatives: vec![late],
            ..effect(&hypothesis, &[sigma.hypot(link_s.1) * ratio.abs()])
        })
    }

    /// The constant amplitude, of the candidates, with the signature of a nuisance, and its value per unit of the nuisance. On a short
    /// motion several are similar: the one with the highest cosine.
    fn constant_effect(
        &self,
        nuisance: &[Option<Vec<f64>>; CHANNELS],
        is_candidate: impl Fn(&AmplitudeRef) -> bool,
        min_cosine: f64,
    ) -> Option<(AmplitudeRef, f64)> {
        let of_base = |base: &ConstantSignature| {
            let mut sums = [0.0; 3];
            for (channel, values) in nuisance.iter().enumerate().take(TIMING) {
                let Some(values) = values else { continue };
                let products = increment_products(values, &base.series[channel]);
                sums.iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
            }
            let [both, own, others] = sums;
            let cosine = if others > 0.0 { both.abs() / (own * others).sqrt() } else { 0.0 };
            (cosine, base.amplitude, both / others)
        };
        let constant = self.bank.bases.iter().filter(|base| base.amplitude.formula().is_none());
        let all = constant.filter(|base| is_candidate(&base.amplitude)).map(of_base);
        let (cosine, amplitude, ratio) = all.max_by(|one, other| one.0.total_cmp(&other.0))?;
        (cosine > min_cosine).then_some((amplitude, ratio))
    }

    /// The effect of a changed calibration parameter, and the name and value per unit of each of its numbers. At rest a scale factor has
    /// the signature of a drift: the name of the parameter determines the effect.
    fn changes(&self, parameter: &CalibrationParameter, index: usize) -> Option<(String, Vec<(String, f64)>)> {
        let name = |number: usize| Calibration::NUMBERS[number].name;
        match parameter.numbers()[..] {
            [(number, _)] => {
                let is_own = |amplitude: &AmplitudeRef| {
                    let own = name(number);
                    own == amplitude.size().name || own.starts_with(&amplitude.code().replace('-', "_"))
                };
                let (amplitude, ratio) = self.constant_effect(&self.case.nuisances[index], is_own, SAME_PARAMETER)?;
                Some((amplitude.code(), vec![(amplitude.size().name, ratio)]))
            }
            ref several => {
                let changes = several.iter().map(|&(number, share)| (name(number).to_owned(), share));
                Some((Misalignment::SPEC.code.to_owned(), changes.collect()))
            }
        }
    }

    /// Calibration parameters with a significant correction.
    ///
    /// Beside an effect on its gyro a parameter counts if all others are known: the effect was fitted with it, and without it is another one.
    pub fn recalibrations(&self, selected: &SelectedModel) -> Vec<DiagnosedEffect> {
        let (state, normal) = (&selected.state, &selected.normal);
        let has_effect = |gyro: usize| state.held.iter().any(|held| held.hypothesis.gyros[gyro]);
        let mut entries: Vec<DiagnosedEffect> = Vec::new();
        for (index, parameter) in CalibrationParameter::all(&self.case.nominal.device).into_iter().enumerate() {
            let (moved, sigma, gyro) = (state.calibration[index], state.calibration_sigmas[index], parameter.gyro);
            let (own_sigma, sigmas) = match has_effect(gyro.index()) {
                true => (normal.conditional_sigma(index).min(sigma), 1.0),
                false => (sigma, FOUR_SIGMAS),
            };
            if moved.abs() <= sigmas * own_sigma || sigma.is_nan() {
                continue;
            }
            let Some((code, changes)) = self.changes(&parameter, index) else { continue };
            let fall = (moved / own_sigma).powi(2);
            let gyros = self.case.measured.gyros().only(gyro.index());
            let place = entries.iter().position(|entry| entry.code == code && entry.gyros == gyros);
            let place = place.unwrap_or_else(|| {
                let chi2 = Some(Chi2Fall { fall: 0.0, threshold: sigmas.powi(2) });
                let class = Class::Recalibration;
                entries.push(DiagnosedEffect { chi2, code, gyros, class, ..DiagnosedEffect::default() });
                entries.len() - 1
            });
            let entry = &mut entries[place];
            entry.chi2 = entry.chi2.map(|chi2| Chi2Fall { fall: chi2.fall.max(fall), ..chi2 });
            for ((number, share), (name, ratio)) in parameter.numbers().into_iter().zip(changes) {
                // Digits down to a hundredth of a sigma.
                let decimals = (2.0 - (sigma * share.abs()).log10().floor()).clamp(0.0, 15.0) as usize;
                let own =
                    |own: &Correction| matches!(own, Correction::Calibration { number: other, .. } if *other == number);
                let before = entry
                    .corrections
                    .iter()
                    .position(own)
                    .map(|place| (entry.corrections.remove(place), entry.parameters.remove(place)));
                let configured = self.case.nominal.gyros[gyro.index()].calibration.value(number);
                let (total, value, variance) = match before {
                    Some((Correction::Calibration { value, .. }, before)) => {
                        (value, before.value, before.sigma.unwrap_or(0.0).powi(2))
                    }
                    _ => (configured, 0.0, 0.0),
                };
                let value_sigma = variance.sqrt().hypot(sigma * ratio);
                entry.parameters.push(EstimatedValue::new(name, value + moved * ratio, value_sigma));
                let value = format!("{:.decimals$}", total + moved * share).parse().expect("a formatted number");
                entry.corrections.push(Correction::Calibration { gyro, number, value, decimals });
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
        Walk::Scale => ScaleFactorNoise::SPEC,
        Walk::Flicker => BiasInstability::SPEC,
    };
    let effect = GyroEffects::SPECS.iter().position(|other| *other == spec).expect("an effect of the list");
    AmplitudeRef::new(ParameterRef { list: EffectList::Head, effect, number: 0 }, None)
}

/// True if an alternative is the law of the effect written as a formula.
fn is_the_same(found: &AmplitudeRef, alternative: &Alternative) -> bool {
    let is_law = found.formula().is_none() && alternative.hypothesis.amplitude.formula().is_some();
    is_law && alternative.cosine > SAME_SIGNATURE
}

#[cfg(test)]
mod tests {
    use geu_hypothesis::amplitude::STEP;

    use super::*;

    #[test]
    fn alternatives_with_an_onset_leave_a_test_to_the_others() {
        let with_steps = |amplitude: &AmplitudeRef| amplitude.own_shapes().is_empty() && amplitude.with(STEP).is_some();
        let amplitude = AmplitudeRef::all(&geu_model::device::Device::iras())
            .into_iter()
            .find(with_steps)
            .expect("an effect with steps");
        let constant = Hypothesis::constant(amplitude, 1.0, geu_protocol::Gyros::ALL);
        let stepped = amplitude.with(STEP).expect("a step");
        let step =
            Hypothesis { course_shapes: vec![100.0], ..Hypothesis::constant(stepped, 1.0, geu_protocol::Gyros::ALL) };
        let group = [vec![step; ALTERNATIVES], vec![constant]].concat();
        let places: Vec<usize> = [ALTERNATIVES].into_iter().chain(0..ALTERNATIVES - 1).collect();
        assert_eq!(tested(group.iter()), places);
    }
}
