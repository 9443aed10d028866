//! The discriminating manoeuvre of indistinguishable hypotheses: the model simulates manoeuvres that could follow the recording, and
//! the one after which the two signatures differ most is reported.
//!
//! A manoeuvre begins sun-pointing and at thermal rest, with the drift random walk and time courses as the recording left them.
//! Amplitudes and nuisance parameters are free over recording and manoeuvre together; the alternative's shape parameters keep the
//! values of the recording.

use std::sync::{Arc, OnceLock};

use geu_model::attitude::{AttitudeProfile, Manoeuvre, RecordedAttitude, Scenario};
use geu_model::parameter_spec::DefaultValue;
use geu_model::simulation::ReferenceSource;
use geu_model::units::{ORBIT_S, SAMPLE_INTERVAL_S};
use geu_model::{Configuration, Truth};
use rayon::prelude::*;

use crate::alternatives::{AMBIGUITY_CHI2, Alternative};
use crate::hypothesis::Hypothesis;
use crate::measured::{BLOCK, Block, CHANNELS, MeasuredData, PlannedMotion, Series};
use crate::model_state::{DiagnosisCase, FittedHypothesis, ModelState};
use crate::normal_equations::{NormalEquations, Nuisance};
use crate::rounding::Rounding;
use crate::signature::Signature;
use crate::whitening::Whitening;

/// θ before and after a manoeuvre.
const THETA_DEG: f64 = 90.0;
/// Length of a rest.
const REST_S: f64 = 3600.0;
/// Limits of a manoeuvre's length; the longest is little more than an orbit.
const MIN_S: f64 = 120.0;
const MAX_S: f64 = 7200.0;
/// Share of the present cosine below which a manoeuvre lowers it.
const LOWERED: f64 = 0.9;
/// Separation beyond doubt, five sigma.
const SURE_CHI2: f64 = 25.0;
/// Temperature rise of the electronics.
const WARMER_K: f64 = 5.0;
/// Rest after a manoeuvre, so that the reference covers its end.
const AFTER_S: f64 = 2.0;

/// The sentence without a manoeuvre.
pub const NO_TEST: &str = "no manoeuvre tried would separate the two";

/// A manoeuvre and its name in a sentence.
struct Candidate {
    name: String,
    measured: MeasuredData,
    nuisances: Vec<Nuisance>,
    rounding: Arc<Rounding>,
}

/// A manoeuvre and the separation of each alternative after it.
struct Simulated<'a> {
    name: &'a str,
    duration_s: f64,
    separations: Vec<Separation>,
}

/// Manoeuvres that could follow a recording, simulated on first use.
pub struct DiscriminatingTests<'a> {
    case: &'a DiagnosisCase<'a>,
    manoeuvres: OnceLock<Vec<Candidate>>,
}

/// Separation of two signatures.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Separation {
    /// Cosine without sign, with the nuisance parameters projected out.
    cosine: f64,
    /// Part of the chi2 reduction that the alternative does not explain.
    chi2: f64,
}

impl Separation {
    fn is_lower_than(&self, before: &Separation) -> bool {
        self.cosine < LOWERED * before.cosine
    }
}

/// The signatures in one recording or manoeuvre, not whitened.
struct Signatures {
    blocks: [Vec<Block>; CHANNELS],
    rounding: Rounding,
    nuisances: Vec<Nuisance>,
    own: Nuisance,
    alternatives: Vec<Nuisance>,
}

impl<'a> DiscriminatingTests<'a> {
    /// For a recording.
    pub fn new(case: &'a DiagnosisCase<'a>) -> DiscriminatingTests<'a> {
        DiscriminatingTests { case, manoeuvres: OnceLock::new() }
    }

    /// Selects, for each indistinguishable alternative of the hypothesis at `index`, the manoeuvre that separates the two.
    pub fn select(&self, state: &ModelState, index: usize, alternatives: &[Alternative]) -> Vec<Option<String>> {
        let is_ambiguous = |alternative: &&Alternative| alternative.delta_chi2 < AMBIGUITY_CHI2;
        let ambiguous: Vec<&Alternative> = alternatives.iter().filter(is_ambiguous).collect();
        if ambiguous.is_empty() {
            return vec![None; alternatives.len()];
        }
        let found = &state.held[index].hypothesis;
        let hypotheses: Vec<&Hypothesis> = ambiguous.iter().map(|alternative| &alternative.hypothesis).collect();
        let now = signatures(self.case, state, index, &hypotheses);
        let is_wave = hypotheses.iter().chain([&found]).any(|hypothesis| is_wave(hypothesis));
        let manoeuvres = self.manoeuvres.get_or_init(|| self.simulate());
        let warmings = if is_wave { self.warm() } else { Vec::new() };
        // The state holds signatures of the recording.
        let mut state_after = state.clone();
        state_after.held.iter_mut().for_each(FittedHypothesis::invalidate);
        let simulated =
            manoeuvres.par_iter().chain(&warmings).map(|Candidate { name, measured, nuisances, rounding }| {
                let (nuisances, rounding) = (nuisances.clone(), rounding.clone());
                let case = DiagnosisCase { measured, nominal: self.case.nominal, nuisances, rounding };
                let both = now.followed_by(&signatures(&case, &state_after, index, &hypotheses));
                Simulated { name, duration_s: measured.duration_s(), separations: both.separations(state, found.value) }
            });
        let simulated: Vec<Simulated> = simulated.collect();
        let before = now.separations(state, found.value);
        let mut tests = ambiguous.iter().enumerate().map(|(place, alternative)| {
            sentence(alternative.cosine, &before[place], simulated.iter().map(|own| (own, own.separations[place])))
        });
        alternatives.iter().map(|own| if is_ambiguous(&own) { tests.next() } else { None }).collect()
    }

    fn simulate(&self) -> Vec<Candidate> {
        let candidate = |(name, motion)| {
            let measured = self.case.measured.followed_by(motion);
            let DiagnosisCase { nuisances, rounding, .. } = DiagnosisCase::new(&measured, self.case.nominal);
            Candidate { name, measured, nuisances, rounding }
        };
        manoeuvres(self.case.nominal).into_par_iter().map(candidate).collect()
    }

    /// Repeats the motion at other temperatures, on which the signatures of the calibration parameters hardly depend.
    fn warm(&self) -> Vec<Candidate> {
        let measured = self.case.measured;
        let samples = measured.samples.min((MAX_S / SAMPLE_INTERVAL_S) as usize);
        let known = &measured.counts.electronics_c[..=samples];
        let mean_c = known.iter().sum::<f64>() / known.len() as f64;
        let first =
            |column: &Nuisance| column.each_ref().map(|values| Some(values.as_ref()?[..samples / BLOCK].to_vec()));
        let candidate = |name: String, measured: MeasuredData| Candidate {
            name,
            measured,
            nuisances: self.case.nuisances.iter().map(first).collect(),
            rounding: Arc::new(self.case.rounding.each_ref().map(|channel| channel[..samples / BLOCK].to_vec())),
        };
        let opposite = measured.again(samples, |celsius| 2.0 * mean_c - celsius);
        let warmer = measured.again(samples, |celsius| celsius + WARMER_K);
        let half_orbit = "the same motion half an orbit later, as the electronics temperature swings the other way,";
        vec![
            candidate(half_orbit.to_owned(), opposite),
            candidate(format!("the same motion with the electronics {WARMER_K} K warmer"), warmer),
        ]
    }
}

/// True for a time course that varies with the temperature or an orbit rather than with the motion.
fn is_wave(hypothesis: &Hypothesis) -> bool {
    hypothesis.profile().is_some_and(|profile| profile.spec.follows_temperature || profile.is_periodic())
}

/// Describes the shortest manoeuvre that separates the two beyond doubt, otherwise the most effective one.
fn sentence<'a>(
    cosine: f64,
    before: &Separation,
    simulated: impl Iterator<Item = (&'a Simulated<'a>, Separation)>,
) -> String {
    let is_useful = |(_, after): &(&Simulated, Separation)| after.chi2 > AMBIGUITY_CHI2 || after.is_lower_than(before);
    let useful: Vec<_> = simulated.filter(is_useful).collect();
    let sure = || useful.iter().filter(|(_, after)| after.chi2 > SURE_CHI2);
    let duration = |one: &&(&Simulated, Separation), other: &&(&Simulated, Separation)| {
        one.0.duration_s.total_cmp(&other.0.duration_s)
    };
    let best = sure()
        .filter(|(_, after)| after.is_lower_than(before))
        .min_by(duration)
        .or_else(|| sure().min_by(duration))
        .or_else(|| useful.iter().max_by(|one, other| one.1.chi2.total_cmp(&other.1.chi2)));
    let Some((Simulated { name, .. }, after)) = best else {
        return NO_TEST.to_owned();
    };
    let (to, sigmas) = (after.cosine, after.chi2.sqrt());
    match after.is_lower_than(before) {
        true => {
            format!(
                "{name} would bring the cosine from {cosine:.2} to {to:.2}, and separate the two by {sigmas:.1} sigma"
            )
        }
        false => format!("{name} would leave the cosine at {to:.2}, yet separate the two by {sigmas:.1} sigma"),
    }
}

/// Each kind of manoeuvre by itself, in both directions, from and back to sun-pointing.
fn manoeuvres(nominal: &Configuration) -> Vec<(String, PlannedMotion)> {
    let kinds = Manoeuvre::KINDS.iter().filter_map(|(kind, _)| Manoeuvre::of_kind(kind));
    let (plain, with_target): (Vec<Manoeuvre>, Vec<Manoeuvre>) = kinds.partition(|own| target(own).is_none());
    let there_and_back: Vec<(String, [Manoeuvre; 2])> = with_target.iter().flat_map(both_ends).collect();
    let mut sequences: Vec<(String, Vec<Manoeuvre>)> = Vec::new();
    for mut manoeuvre in plain {
        let mut name = with_article(manoeuvre.kind());
        // A manoeuvre with a length alone is a rest.
        if let [length] = manoeuvre.numbers().specs() {
            *manoeuvre.numbers_mut().value_mut(0) = REST_S;
            name += &format!(" with {} = {REST_S}", length.name);
        }
        if AttitudeProfile::new(&scenario(nominal, vec![manoeuvre.clone()])).is_ok() {
            sequences.extend(backwards(&manoeuvre).map(|(name, backwards)| (name, vec![backwards])));
            sequences.push((name, vec![manoeuvre]));
        } else {
            // It needs another attitude.
            sequences.extend(there_and_back.iter().map(|(both, [there, back])| {
                (format!("{both} with {name} between"), vec![there.clone(), manoeuvre.clone(), back.clone()])
            }));
        }
    }
    sequences.extend(there_and_back.into_iter().map(|(name, both)| (name, both.to_vec())));
    let mut all: Vec<(String, PlannedMotion)> = Vec::new();
    for (name, manoeuvres) in sequences {
        let Some((planned, is_endless)) = planned(nominal, scenario(nominal, manoeuvres)) else { continue };
        // Two kinds may result in the same motion.
        if all.iter().all(|(_, other)| other.motion != planned.motion) {
            let kind = name.split_once(' ').map_or(&name[..], |(_, kind)| kind);
            all.push((if is_endless { format!("an orbit of {kind}") } else { name }, planned));
        }
    }
    all
}

/// Index of a manoeuvre's required number: the angle at which it ends.
fn target(manoeuvre: &Manoeuvre) -> Option<usize> {
    manoeuvre.numbers().specs().iter().position(|number| number.default == DefaultValue::Required)
}

/// A manoeuvre to either limit of its target, and back.
fn both_ends(manoeuvre: &Manoeuvre) -> Vec<(String, [Manoeuvre; 2])> {
    let Some(target) = target(manoeuvre) else { return Vec::new() };
    let to = |value: f64| {
        let mut to = manoeuvre.clone();
        *to.numbers_mut().value_mut(target) = value;
        to
    };
    let number = &manoeuvre.numbers().specs()[target];
    let both = |end| (format!("{} to {end}° and back", with_article(manoeuvre.kind())), [to(end), to(THETA_DEG)]);
    [number.min, number.max].map(both).to_vec()
}

/// A manoeuvre in the other direction, if it has a signed number.
fn backwards(manoeuvre: &Manoeuvre) -> Option<(String, Manoeuvre)> {
    let mut backwards = manoeuvre.clone();
    let numbers = manoeuvre.numbers().specs();
    let sign = numbers.iter().position(|number| number.min == -number.max)?;
    let value = backwards.numbers_mut().value_mut(sign);
    *value = -*value;
    Some((format!("{} with {} = {value}", with_article(manoeuvre.kind()), numbers[sign].name), backwards))
}

fn scenario(nominal: &Configuration, manoeuvres: Vec<Manoeuvre>) -> Scenario {
    Scenario { theta_deg: THETA_DEG, psi_deg: 0.0, limit_cycle: nominal.scenario.limit_cycle, manoeuvres }
}

/// The motion of a scenario, and true if it has no end. `None` if it is not possible, too short, too long, or needs an eclipse.
fn planned(nominal: &Configuration, scenario: Scenario) -> Option<(PlannedMotion, bool)> {
    AttitudeProfile::new(&scenario).ok()?;
    let length_s = AttitudeProfile::length_s(&scenario);
    let duration_s = length_s.unwrap_or(ORBIT_S);
    if !(MIN_S..=MAX_S).contains(&duration_s) {
        return None;
    }
    let samples = (duration_s / SAMPLE_INTERVAL_S).ceil() as usize;
    let configuration = Configuration { scenario, ..nominal.clone() };
    let mut reference = ReferenceSource::new(&configuration, &Truth::Scenario);
    let mut rows = vec![reference.start()];
    for node in 1..=samples + (AFTER_S / SAMPLE_INTERVAL_S) as usize {
        let sample = reference.advance(node as f64 * SAMPLE_INTERVAL_S);
        if sample.legs.iter().any(|leg| leg.eclipse) {
            return None;
        }
        rows.push(sample.row());
    }
    Some((PlannedMotion { motion: RecordedAttitude::new(&rows).ok()?, samples }, length_s.is_none()))
}

/// A kind of manoeuvre in a sentence: `a Y-scan`.
fn with_article(kind: &str) -> String {
    let is_axis = kind.as_bytes().get(1) == Some(&b'-');
    let (first, rest) = kind.split_at(1);
    let first = if is_axis { first.to_uppercase() } else { first.to_owned() };
    let article = if "aeioX".contains(&first) { "an" } else { "a" };
    format!("{article} {first}{rest}")
}

/// The signatures of the hypothesis at `index` and of its alternatives in a recording or manoeuvre.
fn signatures(case: &DiagnosisCase, state: &ModelState, index: usize, alternatives: &[&Hypothesis]) -> Signatures {
    let mut state = state.clone();
    let own = case.signature(&state, index);
    state.held.remove(index);
    let (_, nuisances) = case.linearised(&mut state);
    let from = case.run(&state);
    let signature = |hypothesis: &&Hypothesis| -> Nuisance {
        let mut with = state.clone();
        with.held.push(FittedHypothesis::fixed((*hypothesis).clone()));
        case.measured.difference(&case.run(&with), &from).map(Some)
    };
    let alternatives = alternatives.par_iter().map(signature).collect();
    Signatures {
        blocks: case.measured.blocks.clone(),
        rounding: Rounding::clone(&case.rounding),
        nuisances,
        own,
        alternatives,
    }
}

impl Signatures {
    /// The signatures in the recording and a manoeuvre after it.
    fn followed_by(&self, next: &Signatures) -> Signatures {
        let join = |(one, other): (&Nuisance, &Nuisance)| -> Nuisance {
            std::array::from_fn(|channel| {
                let padded = |values: &Option<Vec<f64>>, signatures: &Signatures| {
                    values.clone().unwrap_or_else(|| vec![0.0; signatures.blocks[channel].len()])
                };
                let is_reached = one[channel].is_some() || other[channel].is_some();
                is_reached.then(|| [padded(&one[channel], self), padded(&other[channel], next)].concat())
            })
        };
        Signatures {
            blocks: std::array::from_fn(|channel| [&self.blocks[channel][..], &next.blocks[channel]].concat()),
            rounding: std::array::from_fn(|channel| [&self.rounding[channel][..], &next.rounding[channel]].concat()),
            nuisances: self.nuisances.iter().zip(&next.nuisances).map(join).collect(),
            own: join((&self.own, &next.own)),
            alternatives: self.alternatives.iter().zip(&next.alternatives).map(join).collect(),
        }
    }

    /// Separation of each alternative from the hypothesis with amplitude `size`.
    fn separations(&self, state: &ModelState, size: f64) -> Vec<Separation> {
        let whitenings = std::array::from_fn(|channel| {
            Whitening::new(&state.noise[channel], &self.blocks[channel], &self.rounding[channel])
        });
        let zero: Series = self.blocks.each_ref().map(|blocks| vec![0.0; blocks.len()]);
        let normal = NormalEquations::new(whitenings, &zero, &self.nuisances, &[]);
        let own = Signature::new(&normal, &self.own);
        let whole = normal.gain(&own.products).map_or(0.0, |gain| (size / gain.sigma).powi(2));
        let separation = |alternative: &Nuisance| {
            let cosine = own.cosine(&normal, &Signature::new(&normal, alternative));
            Separation { cosine, chi2: whole * (1.0 - cosine * cosine) }
        };
        self.alternatives.iter().map(separation).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn manoeuvres_cover_the_kinds_and_have_names() {
        let names: Vec<String> = manoeuvres(&Configuration::reference()).into_iter().map(|(name, _)| name).collect();
        for name in [
            "a Z-scan",
            "a Y-scan to 120° and back",
            "a Y-scan to 60° and back with an X-scan between",
            "an orbit of survey",
        ] {
            assert!(names.iter().any(|other| other == name), "{name}: {names:?}");
        }
    }
}
