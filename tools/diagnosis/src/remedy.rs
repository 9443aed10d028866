//! What would tell apart two things that look alike: flights that could follow the recording are flown with the model, and the one
//! after which the two signatures differ most is told.
//!
//! A flight begins sun-pointing and at thermal rest, where the recording's drift walk and courses in time have come to. Sizes and
//! the nuisances are free over recording and flight together; the rival's shapes stay as the recording has them.

use std::sync::OnceLock;

use geu_model::Configuration;
use geu_model::attitude::{AttitudeProfile, AttitudeRow, Manoeuvre, Motion, RecordedAttitude, Scenario};
use geu_model::course::TimeFunction;
use geu_model::number::DefaultValue;
use geu_model::units::{ORBIT_S, SAMPLE_INTERVAL_S};
use rayon::prelude::*;

use crate::bank::Column;
use crate::hypothesis::Hypothesis;
use crate::measured::{BLOCK, Block, CHANNELS, MeasuredData, PlannedMotion, Series};
use crate::normal::{NormalEquations, Nuisance, Products, ProjectedSignature};
use crate::rivals::{APART_CHI2, Alternative};
use crate::state::{DiagnosisCase, FittedHypothesis, ModelState};
use crate::whitening::Whitening;

/// θ at which a flight begins and ends.
const THETA_DEG: f64 = 90.0;
/// Length of what lasts as long as one likes.
const REST_S: f64 = 3600.0;
/// Longer flights are not proposed: little more than an orbit.
const LONGEST_S: f64 = 7200.0;
/// Shorter ones tell nothing.
const SHORTEST_S: f64 = 120.0;
/// A flight that leaves the cosine above this share of what it was is no remedy, unless the two are three sigma apart after it.
const LOWERED: f64 = 0.9;
/// Two things are told apart beyond doubt by this, five sigma.
const SURE_CHI2: f64 = 25.0;
/// By how much the electronics are warmed.
const WARMER_K: f64 = 5.0;
/// Rest after a flight, so that the motion is known to its end.
const AFTER_S: f64 = 2.0;

/// A flight and what it would be in a sentence.
struct Candidate {
    name: String,
    measured: MeasuredData,
    nuisances: Vec<Nuisance>,
}

/// A flight and how far it brings each rival from what was found.
struct Tried<'a> {
    name: &'a str,
    duration_s: f64,
    apart: Vec<Apart>,
}

/// The flights that could follow a recording, flown when they are first asked for.
pub struct DiscriminatingTests<'a> {
    case: &'a DiagnosisCase<'a>,
    flights: OnceLock<Vec<Candidate>>,
    warmings: OnceLock<Vec<Candidate>>,
}

/// How far apart two signatures are.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Apart {
    /// Cosine of the two beside the nuisances, without sign.
    cosine: f64,
    /// What the rival would leave of χ² that the one found explains.
    chi2: f64,
}

/// The signatures in one recording or flight, not whitened yet.
struct Signatures {
    blocks: [Vec<Block>; CHANNELS],
    nuisances: Vec<Nuisance>,
    own: Nuisance,
    rivals: Vec<Nuisance>,
}

impl<'a> DiscriminatingTests<'a> {
    /// Of a recording.
    pub fn new(case: &'a DiagnosisCase<'a>) -> DiscriminatingTests<'a> {
        DiscriminatingTests { case, flights: OnceLock::new(), warmings: OnceLock::new() }
    }

    /// For each rival of the change at `index` of a state that cannot be told from it, what would tell it.
    pub fn of(&self, state: &ModelState, index: usize, rivals: &[Alternative]) -> Vec<Option<String>> {
        let alike: Vec<&Alternative> = rivals.iter().filter(|rival| rival.behind_chi2 < APART_CHI2).collect();
        if alike.is_empty() {
            return vec![None; rivals.len()];
        }
        let found = &state.held[index].hypothesis;
        let changes: Vec<&Hypothesis> = alike.iter().map(|rival| &rival.hypothesis).collect();
        let now = signatures(self.case, state, index, &changes);
        let swings = changes.iter().chain([&found]).any(|change| swings(change));
        let flights = self.flights.get_or_init(|| self.fly());
        let warmings = if swings { &self.warmings.get_or_init(|| self.warm())[..] } else { &[] };
        // What the state has at hand is of the recording.
        let mut anew = state.clone();
        anew.held.iter_mut().for_each(FittedHypothesis::invalidate);
        let flown = |measured: &MeasuredData, nuisances: &[Nuisance]| {
            let case = DiagnosisCase { measured, believed: self.case.believed, nuisances: nuisances.to_vec() };
            now.followed_by(&signatures(&case, &anew, index, &changes)).apart(state, found.value)
        };
        let tried = flights.par_iter().chain(warmings).map(|Candidate { name, measured, nuisances }| Tried {
            name,
            duration_s: measured.duration_s(),
            apart: flown(measured, nuisances),
        });
        let tried: Vec<Tried> = tried.collect();
        let before = now.apart(state, found.value);
        let mut told = (0..alike.len()).map(|rival| {
            sentence(alike[rival].cosine, before[rival], tried.iter().map(|tried| (tried, tried.apart[rival])))
        });
        rivals.iter().map(|rival| if rival.behind_chi2 < APART_CHI2 { told.next() } else { None }).collect()
    }

    fn fly(&self) -> Vec<Candidate> {
        let fly = |(name, flight)| {
            let measured = self.case.measured.followed_by(flight);
            let nuisances = DiagnosisCase::new(&measured, self.case.believed).nuisances;
            Candidate { name, measured, nuisances }
        };
        flights(self.case.believed).into_par_iter().map(fly).collect()
    }

    /// The same motion at other temperatures, which the signatures of the sixteen hardly know.
    fn warm(&self) -> Vec<Candidate> {
        let measured = self.case.measured;
        let samples = measured.samples.min((LONGEST_S / SAMPLE_INTERVAL_S) as usize);
        let known = &measured.counts.electronics_c[..=samples];
        let mean_c = known.iter().sum::<f64>() / known.len() as f64;
        let first = |column: &Nuisance| -> Nuisance {
            std::array::from_fn(|channel| column[channel].as_ref().map(|values| values[..samples / BLOCK].to_vec()))
        };
        let candidate = |name: &str, measured: MeasuredData| Candidate {
            name: name.to_owned(),
            measured,
            nuisances: self.case.nuisances.iter().map(first).collect(),
        };
        let later = measured.again(samples, |celsius| 2.0 * mean_c - celsius);
        let warmer = measured.again(samples, |celsius| celsius + WARMER_K);
        vec![
            candidate(
                "the same motion half an orbit later, as the electronics temperature swings the other way,",
                later,
            ),
            candidate(&format!("the same motion with the electronics {WARMER_K} K warmer"), warmer),
        ]
    }
}

/// Whether a change comes and goes with something that is no motion.
fn swings(change: &Hypothesis) -> bool {
    matches!(change.law(), Some(TimeFunction::Temperature | TimeFunction::Periodic { .. }))
}

/// Of the flights that tell them apart beyond doubt the shortest, else the one that tells them apart best.
fn sentence<'a>(cosine: f64, before: Apart, tried: impl Iterator<Item = (&'a Tried<'a>, Apart)>) -> String {
    let is_lowered = |apart: &Apart| apart.cosine < LOWERED * before.cosine;
    let useful: Vec<_> = tried.filter(|(_, apart)| apart.chi2 > APART_CHI2 || is_lowered(apart)).collect();
    let is_sure = |apart: &Apart| apart.chi2 > SURE_CHI2;
    let shortest = |is_fit: &dyn Fn(&Apart) -> bool| {
        let fit = useful.iter().filter(|(_, apart)| is_fit(apart));
        fit.min_by(|one, other| one.0.duration_s.total_cmp(&other.0.duration_s))
    };
    let best = shortest(&|apart| is_sure(apart) && is_lowered(apart))
        .or_else(|| shortest(&is_sure))
        .or_else(|| useful.iter().max_by(|one, other| one.1.chi2.total_cmp(&other.1.chi2)));
    let Some((Tried { name, .. }, apart)) = best else {
        return "none of the manoeuvres tried would tell them apart".to_owned();
    };
    let (after, sigmas) = (apart.cosine, apart.chi2.sqrt());
    match is_lowered(apart) {
        true => {
            format!("{name} would bring the cosine from {cosine:.2} to {after:.2}, and the two {sigmas:.1} sigma apart")
        }
        false => format!("{name} would leave the cosine at {after:.2}, yet bring the two {sigmas:.1} sigma apart"),
    }
}

/// Each kind of manoeuvre by itself, forwards and backwards, from and back to sun-pointing.
fn flights(believed: &Configuration) -> Vec<(String, PlannedMotion)> {
    let mut sequences: Vec<(String, Vec<Manoeuvre>)> = Vec::new();
    let (mut plain, mut there_and_back) = (Vec::new(), Vec::new());
    for mut manoeuvre in Manoeuvre::KINDS.iter().filter_map(|(kind, _)| Manoeuvre::of_kind(kind)) {
        let numbers = manoeuvre.numbers().specs();
        match numbers.iter().position(|number| number.default == DefaultValue::Required) {
            Some(target) => {
                let to = |value: f64| {
                    let mut to = manoeuvre.clone();
                    *to.numbers_mut().value_mut(target) = value;
                    to
                };
                for end in [numbers[target].least, numbers[target].greatest] {
                    let name = format!("{} to {end}° and back", named(manoeuvre.kind()));
                    there_and_back.push((name, to(end), to(THETA_DEG)));
                }
            }
            None => {
                let mut name = named(manoeuvre.kind());
                // What has nothing but a length is a rest.
                if let [length] = numbers {
                    *manoeuvre.numbers_mut().value_mut(0) = REST_S;
                    name += &format!(" with {} = {REST_S}", length.name);
                }
                plain.push((name, manoeuvre));
            }
        }
    }
    for (name, manoeuvre) in plain {
        if AttitudeProfile::new(&scenario(believed, vec![manoeuvre.clone()])).is_ok() {
            sequences.extend(backwards(&manoeuvre).map(|(name, backwards)| (name, vec![backwards])));
            sequences.push((name, vec![manoeuvre]));
            continue;
        }
        // It needs another attitude.
        sequences.extend(there_and_back.iter().map(|(both, there, back)| {
            (format!("{both} with {name} between"), vec![there.clone(), manoeuvre.clone(), back.clone()])
        }));
    }
    sequences.extend(there_and_back.into_iter().map(|(name, there, back)| (name, vec![there, back])));
    let mut flights: Vec<(String, PlannedMotion)> = Vec::new();
    for (name, manoeuvres) in sequences {
        let scenario = scenario(believed, manoeuvres);
        let Some((flight, is_endless)) = flight(&scenario) else { continue };
        // Two kinds may come to the same motion.
        if flights.iter().all(|(_, other)| other.motion != flight.motion) {
            let name = if is_endless { format!("an orbit of {}", bare(&name)) } else { name };
            flights.push((name, flight));
        }
    }
    flights
}

/// A manoeuvre that turns the other way, where it has a number for that.
fn backwards(manoeuvre: &Manoeuvre) -> Option<(String, Manoeuvre)> {
    let mut backwards = manoeuvre.clone();
    let numbers = manoeuvre.numbers().specs();
    let sign = numbers.iter().position(|number| number.least == -number.greatest)?;
    let value = backwards.numbers_mut().value_mut(sign);
    *value = -*value;
    Some((format!("{} with {} = {value}", named(manoeuvre.kind()), numbers[sign].name), backwards))
}

fn scenario(believed: &Configuration, manoeuvres: Vec<Manoeuvre>) -> Scenario {
    Scenario { theta_deg: THETA_DEG, psi_deg: 0.0, limit_cycle: believed.scenario.limit_cycle, manoeuvres }
}

/// The motion of a scenario, and whether it would go on for ever; nothing where it cannot be flown or takes too long.
fn flight(scenario: &Scenario) -> Option<(PlannedMotion, bool)> {
    let plan = AttitudeProfile::new(scenario).ok()?;
    let length_s = AttitudeProfile::length_s(scenario);
    let duration_s = length_s.unwrap_or(ORBIT_S);
    if !(SHORTEST_S..=LONGEST_S).contains(&duration_s) {
        return None;
    }
    let samples = (duration_s / SAMPLE_INTERVAL_S).ceil() as usize;
    let mut motion = Motion::new(plan, scenario.limit_cycle);
    let mut is_dark = false;
    let rows = (0..=samples + (AFTER_S / SAMPLE_INTERVAL_S) as usize).map(|node| {
        let t_s = node as f64 * SAMPLE_INTERVAL_S;
        let step = motion.advance(t_s);
        is_dark |= motion.take_legs().iter().any(|leg| leg.eclipse);
        let theta_psi_rad = Some((step.end.theta_rad, step.end.psi_rad));
        AttitudeRow { t_s, angle_control_arcsec: step.angle_control_arcsec, theta_psi_rad }
    });
    let motion = RecordedAttitude::new(&rows.collect::<Vec<_>>()).ok()?;
    // A shadow cannot be had for the asking.
    (!is_dark).then(|| (PlannedMotion { motion, samples }, length_s.is_none()))
}

/// A kind of manoeuvre in a sentence: "a Y-scan".
fn named(kind: &str) -> String {
    let is_axis = kind.as_bytes().get(1) == Some(&b'-');
    let (first, rest) = kind.split_at(1);
    let first = if is_axis { first.to_uppercase() } else { first.to_owned() };
    let article = if "aeioX".contains(&first) { "an" } else { "a" };
    format!("{article} {first}{rest}")
}

/// Without its article.
fn bare(name: &str) -> &str {
    name.split_once(' ').map_or(name, |(_, rest)| rest)
}

/// What each change adds to a recording or a flight, beside all else that is held.
fn signatures(case: &DiagnosisCase, state: &ModelState, index: usize, rivals: &[&Hypothesis]) -> Signatures {
    let mut state = state.clone();
    let own = case.signature(&state, index);
    state.held.remove(index);
    let (_, nuisances) = case.linearised(&mut state);
    let from = case.run(&state);
    let of = |change: &&Hypothesis| -> Nuisance {
        let mut with = state.clone();
        with.held.push(FittedHypothesis::fixed((*change).clone()));
        case.measured.difference(&case.run(&with), &from).map(Some)
    };
    let rivals = rivals.par_iter().map(of).collect();
    Signatures { blocks: case.measured.blocks.clone(), nuisances, own, rivals }
}

impl Signatures {
    /// Those of a recording, and of a flight after it.
    fn followed_by(&self, next: &Signatures) -> Signatures {
        let blocks: [Vec<Block>; CHANNELS] =
            std::array::from_fn(|channel| [&self.blocks[channel][..], &next.blocks[channel]].concat());
        let join = |one: &Nuisance, other: &Nuisance| -> Nuisance {
            std::array::from_fn(|channel| {
                if one[channel].is_none() && other[channel].is_none() {
                    return None;
                }
                let part = |column: &Nuisance, blocks: &[Vec<Block>; CHANNELS]| {
                    column[channel].clone().unwrap_or_else(|| vec![0.0; blocks[channel].len()])
                };
                Some([part(one, &self.blocks), part(other, &next.blocks)].concat())
            })
        };
        let joined = |one: &[Nuisance], other: &[Nuisance]| one.iter().zip(other).map(|(a, b)| join(a, b)).collect();
        Signatures {
            nuisances: joined(&self.nuisances, &next.nuisances),
            own: join(&self.own, &next.own),
            rivals: joined(&self.rivals, &next.rivals),
            blocks,
        }
    }

    /// How far each rival is from what was found, at its size.
    fn apart(&self, state: &ModelState, size: f64) -> Vec<Apart> {
        let whitenings = std::array::from_fn(|channel| Whitening::new(&state.noise[channel], &self.blocks[channel]));
        let nothing: Series = std::array::from_fn(|channel| vec![0.0; self.blocks[channel].len()]);
        let normal = NormalEquations::new(whitenings, &nothing, &self.nuisances);
        let (own, own_products) = white(&normal, &self.own);
        let whole =
            ProjectedSignature::gain(&[&normal.beside(&own_products)]).map_or(0.0, |gain| (size / gain.sigma).powi(2));
        let of = |rival: &Nuisance| {
            let (rival, products) = white(&normal, rival);
            let pairs = own.iter().flatten().zip(rival.iter().flatten());
            let both = pairs.map(|(one, other)| one * other).sum();
            let cosine = normal.cosine(&own_products, &products, both).abs().min(1.0);
            Apart { cosine, chi2: whole * (1.0 - cosine * cosine) }
        };
        self.rivals.iter().map(of).collect()
    }
}

/// A signature whitened, channel by channel, and its products.
fn white(normal: &NormalEquations, signature: &Nuisance) -> ([Vec<f64>; CHANNELS], Products) {
    let mut products = Products::none(normal.nuisances());
    let white = std::array::from_fn(|channel| {
        let values = signature[channel].clone().unwrap_or_else(|| vec![0.0; normal.residual()[channel].len()]);
        let whitened = normal.white(channel, &Column { from: 0, values });
        products = products.clone().plus(&normal.products(channel, &whitened));
        whitened.values
    });
    (white, products)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flights_come_of_the_kinds_and_are_named_in_words() {
        let names: Vec<String> = flights(&Configuration::reference()).into_iter().map(|(name, _)| name).collect();
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
