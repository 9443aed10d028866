//! `geu-bench next-manoeuvre`: ambiguous pairs, the manoeuvres that their diagnoses propose, and recordings of these with either effect.
//!
//! A recording of a poor motion with an effect of twelve sigma is diagnosed. If the effect found and an alternative are not
//! distinguishable, they are a pair. The proposed scenario is simulated with other noise, once with the effect found and once with the
//! alternative, and diagnosed by itself. A pair is separated if in both comparisons the model with the false one, fitted, has a χ² of 25 more.

use std::collections::BTreeSet;

use clap::{Args, value_parser};
use geu_blind::{SimulatedRecording, TrialGenerator, TrialMotion, simulate};
use geu_calibration::CountsReader;
use geu_diagnosis::fitted_hypothesis::FittedHypothesis;
use geu_diagnosis::measured::Shifts;
use geu_diagnosis::next_manoeuvre::NextManoeuvre;
use geu_diagnosis::outcome::{Class, DiagnosedEffect, Diagnosis};
use geu_diagnosis::report::heading;
use geu_diagnosis::{DiagnosisCase, MeasuredData, noise};
use geu_hypothesis::Hypothesis;
use geu_model::Configuration;
use geu_protocol::Gyros;
use geu_recording::Sink;

use crate::Result;

/// Strength of the effects, sigmas.
const STRENGTH: f64 = 12.0;
/// χ² of a separation of five sigma.
const SEPARATED_CHI2: f64 = 25.0;
/// Recordings that are tried for each pair.
const TRIES: usize = 100;
/// Alternatives of an effect that are printed.
const SHOWN: usize = 3;
/// Poor motions: one turn, one tilt, a short survey, hours of rest.
const MOTIONS: [(&str, &str, f64); 4] = [
    (
        "Z-scan",
        r#"manoeuvre=[{kind="pointing",duration_s=1500},{kind="z-scan",angle_deg=200,rate_arcmin_s=12},{kind="pointing",duration_s=1500}]"#,
        4000.0,
    ),
    (
        "Y-scan",
        r#"manoeuvre=[{kind="pointing",duration_s=1500},{kind="y-scan",to_theta_deg=120},{kind="pointing",duration_s=1500}]"#,
        3150.0,
    ),
    ("survey", r#"manoeuvre=[{kind="survey"}]"#, 2400.0),
    ("rest", r#"manoeuvre=[{kind="pointing",duration_s=6000},{kind="y-scan",to_theta_deg=100}]"#, 6060.0),
];

/// Arguments of `geu-bench next-manoeuvre`.
#[derive(Args)]
pub struct Arguments {
    /// Random seed
    #[arg(long, value_name = "N", value_parser = value_parser!(u64).range(..1 << 40))]
    seed: u64,
    /// Number of pairs
    #[arg(long, value_name = "N", default_value_t = 10)]
    pairs: usize,
}

/// A pair of hypotheses that a recording does not separate, and the proposal of its diagnosis.
struct Pair {
    motion: &'static str,
    hypotheses: [Hypothesis; 2],
    nominal: Configuration,
    next: Option<NextManoeuvre>,
    test: String,
}

/// A recording with a hypothesis.
struct Comparison {
    /// χ² of the other one above it.
    chi2: f64,
    is_named: bool,
    found: String,
}

/// Runs the campaign and prints each pair.
///
/// # Errors
/// A recording cannot be diagnosed.
pub fn run(arguments: &Arguments) -> Result {
    let motions = MOTIONS.map(|(_, manoeuvres, duration_s)| {
        let nominal = Configuration::reference_with(&[format!("seed={}", arguments.seed), manoeuvres.to_owned()])?;
        Ok(TrialMotion::new(nominal, duration_s)?)
    });
    let motions = motions.into_iter().collect::<Result<Vec<TrialMotion>>>()?;
    let [mut separated, mut named, mut pairs, mut proposed] = [0; 4];
    let mut known = BTreeSet::new();
    for index in 0..arguments.pairs {
        let motion = index % MOTIONS.len();
        let draws = index * TRIES..(index + 1) * TRIES;
        let found = draws.map(|draw| pair(&motions[motion], MOTIONS[motion].0, arguments.seed, draw, &mut known));
        let Some(pair) = found.filter_map(Result::transpose).next().transpose()? else { continue };
        pairs += 1;
        let [one, other] = pair.hypotheses.each_ref().map(name);
        println!("{pairs}. {}: {one} or {other}: {}", pair.motion, pair.test);
        let Some(next) = &pair.next else { continue };
        proposed += 1;
        let comparisons = compare(&pair, next, (arguments.seed << 20) + ((index as u64) << 10))?;
        for (hypothesis, comparison) in pair.hypotheses.iter().zip(&comparisons) {
            let sigmas = comparison.chi2.max(0.0).sqrt();
            println!("   with {}: {sigmas:.1} sigma, {}", name(hypothesis), comparison.found);
        }
        separated += usize::from(comparisons.iter().all(|comparison| comparison.chi2 >= SEPARATED_CHI2));
        named += usize::from(comparisons.iter().all(|comparison| comparison.is_named));
    }
    println!("manoeuvre proposed: {proposed} of {pairs}");
    println!("separated by 5 sigma whichever is true: {separated} of {pairs}; only the true one named: {named}");
    match proposed {
        0 => Err("expected a manoeuvre for some of the pairs, no diagnosis proposed one".into()),
        _ => Ok(()),
    }
}

fn name(hypothesis: &Hypothesis) -> String {
    let (amplitude, value) = (&hypothesis.amplitude, hypothesis.value);
    let what = amplitude.formula().map_or_else(|| amplitude.code(), |formula| formula.to_string());
    format!("{} {what} {value:.3e}", hypothesis.gyros.names().join("+"))
}

/// True if an entry is a hypothesis.
fn is(code: &str, formula: Option<&String>, gyros: Gyros, hypothesis: &Hypothesis) -> bool {
    let own = hypothesis.amplitude.formula().map(|formula| formula.to_string());
    (code, formula, gyros) == (&hypothesis.amplitude.code()[..], own.as_ref(), hypothesis.gyros)
}

/// True if an entry or an alternative that is not distinguishable from it is a hypothesis.
fn has(entry: &DiagnosedEffect, hypothesis: &Hypothesis) -> bool {
    let mut same = entry.alternatives.iter().filter(|other| other.is_indistinguishable());
    is(&entry.code, entry.formula.as_ref(), entry.gyros, hypothesis)
        || same.any(|other| is(&other.code, other.formula.as_ref(), other.gyros, hypothesis))
}

fn missing(diagnosis: &Diagnosis) -> Vec<&DiagnosedEffect> {
    diagnosis.entries.iter().filter(|entry| entry.class == Class::MissingEffect).collect()
}

/// The pair of a recording with a constant effect; `None` if its diagnosis is not ambiguous, not right, or the pair is known.
fn pair(
    trial: &TrialMotion,
    motion: &'static str,
    seed: u64,
    draw: usize,
    known: &mut BTreeSet<[String; 2]>,
) -> Result<Option<Pair>> {
    let injected = TrialGenerator::new(trial, seed, draw as u64).amplitudes(1, STRENGTH);
    let Some(injected) = injected.first().filter(|own| own.hypothesis.profile().is_none()) else { return Ok(None) };
    let mut unit = Configuration { seed: (seed << 20) + draw as u64, ..trial.nominal.clone() };
    injected.hypothesis.apply(&mut unit);
    let diagnosis = trial.diagnose_with_plans(&simulate(&unit, trial.duration_s), true)?;
    let [entry] = missing(&diagnosis)[..] else { return Ok(None) };
    let Some(found) = entry.hypothesis().filter(|_| has(entry, &injected.hypothesis)) else { return Ok(None) };
    // The pair contains the injected effect.
    let is_found = is(&entry.code, entry.formula.as_ref(), entry.gyros, &injected.hypothesis);
    for other in entry.alternatives.iter().filter(|other| other.is_indistinguishable()) {
        let Some(hypothesis) = other.hypothesis.clone() else { continue };
        let is_injected = is(&other.code, other.formula.as_ref(), other.gyros, &injected.hypothesis);
        let hypotheses = [found.clone(), hypothesis];
        let codes = hypotheses.each_ref().map(|own| own.amplitude.code());
        if !(is_found || is_injected) || hypotheses.iter().any(Hypothesis::has_onset) || !known.insert(codes) {
            continue;
        }
        let test = other.discriminating_test.clone().unwrap_or_default();
        let (nominal, next) = (trial.nominal.clone(), other.next_manoeuvre.clone());
        return Ok(Some(Pair { motion, hypotheses, nominal, next, test }));
    }
    Ok(None)
}

/// Simulates the proposed scenario with each of the two hypotheses, and compares the other one with it.
fn compare(pair: &Pair, next: &NextManoeuvre, seed: u64) -> Result<[Comparison; 2]> {
    let trial = TrialMotion::new(next.configuration(&pair.nominal), next.duration_s)?;
    let comparison = |[injected, other]: [&Hypothesis; 2], seed: u64| -> Result<Comparison> {
        let mut unit = Configuration { seed, ..trial.nominal.clone() };
        injected.apply(&mut unit);
        let recording = simulate(&unit, next.duration_s);
        let [right, wrong] = [injected, other].map(|own| chi2(&recording, &trial.nominal, own));
        let diagnosis = trial.diagnose(&recording)?;
        let missing = missing(&diagnosis);
        let is_named =
            missing.iter().any(|entry| has(entry, injected)) && !missing.iter().any(|entry| has(entry, other));
        let group = |entry: &&DiagnosedEffect| {
            let same = entry.alternatives.iter().filter(|other| other.is_indistinguishable());
            let names: Vec<String> = same.take(SHOWN).map(|other| format!(" or {}", other.code)).collect();
            heading(entry) + &names.concat()
        };
        let found: Vec<String> = missing.iter().map(group).collect();
        Ok(Comparison {
            chi2: wrong? - right?,
            is_named,
            found: format!("{}: {}", diagnosis.verdict.name(), found.join(", ")),
        })
    };
    let [one, other] = &pair.hypotheses;
    Ok([comparison([one, other], seed)?, comparison([other, one], seed + 1)?])
}

/// χ² of a recording with this hypothesis fitted.
fn chi2(recording: &SimulatedRecording, nominal: &Configuration, hypothesis: &Hypothesis) -> Result<f64> {
    let mut reader = CountsReader::default();
    recording.rows.iter().for_each(|row| reader.row(row));
    let counts = reader.finish(recording.reference.start_ns).ok_or("expected samples, got none")?;
    let measured = MeasuredData::new(counts, &recording.reference, nominal)?;
    let case = DiagnosisCase::new(&measured, nominal);
    let residual = measured.residual(&measured.run(nominal, Shifts::default()));
    let mut state = case.start(noise::configured(nominal, &measured, &case.rounding, &residual));
    state.held.push(FittedHypothesis::new(hypothesis.clone()));
    Ok(case.fit(&mut state).squares())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pair_has_a_discriminating_test() {
        let (motion, manoeuvres, duration_s) = MOTIONS[0];
        let nominal = Configuration::reference_with(&["seed=1".to_owned(), manoeuvres.to_owned()]).expect("valid");
        let trial = TrialMotion::new(nominal, duration_s).expect("long enough");
        let mut known = BTreeSet::new();
        let found = (0..TRIES).find_map(|draw| pair(&trial, motion, 1, draw, &mut known).expect("a diagnosis"));
        let found = found.expect("an ambiguous recording");
        assert!(!found.test.is_empty(), "{} or {}", name(&found.hypotheses[0]), name(&found.hypotheses[1]));
    }
}
