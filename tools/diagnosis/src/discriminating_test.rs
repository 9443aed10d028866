//! The discriminating manoeuvre of indistinguishable hypotheses: the model simulates sequences of manoeuvres. The shortest sequence that
//! separates the two in a recording by itself, whichever is true, is proposed.
//!
//! A sequence begins sun-pointing and at thermal rest, with the drift random walk and time courses as the recording left them. Its
//! recording is diagnosed by itself: all parameters of the false hypothesis are fitted to it, with the calibration parameters.

mod separation;
mod sequences;

use std::sync::{Arc, OnceLock};

use geu_model::Configuration;
use geu_model::units::ORBIT_S;
use rayon::prelude::*;

use crate::alternatives::{AMBIGUITY_CHI2, Alternative};
use crate::diagnosis_case::DiagnosisCase;
use crate::fitted_hypothesis::FittedHypothesis;
use crate::linear_signatures::LinearSignatures;
use crate::measured::{BLOCK, MeasuredData};
use crate::model_state::ModelState;
use crate::next_manoeuvre::{DiscriminatingTest, NO_TEST, NextManoeuvre, SURE_SIGMA};
use crate::normal_equations::Nuisance;
use crate::rounding::Rounding;
use crate::significance::THREE_SIGMA_CHI2;
use geu_hypothesis::Hypothesis;
use separation::{Separation, Signatures, fitted_chi2, in_place};
use sequences::{Sequence, planned};

/// Number of sequences that are compared at once by signatures, also of fits for one pair, and factor between their durations.
const AT_ONCE: usize = 8;
const LONGER: f64 = 1.3;
/// Temperature rise of the electronics.
const WARMER_K: f64 = 5.0;

/// A motion that could follow the recording.
struct Candidate {
    measured: MeasuredData,
    nuisances: Vec<Nuisance>,
    rounding: Arc<Rounding>,
    linear: LinearSignatures,
}

/// Motions that could follow a recording, simulated on first use.
pub struct DiscriminatingTests<'a> {
    case: &'a DiagnosisCase<'a>,
    sequences: Vec<Sequence>,
    parts: OnceLock<Vec<Candidate>>,
    /// Whole sequences.
    candidates: Vec<OnceLock<Option<Candidate>>>,
}

/// The hypotheses of one group.
struct Group<'p> {
    state: &'p ModelState,
    index: usize,
    /// The one found, then its alternatives.
    hypotheses: Vec<FittedHypothesis>,
    sizes: Vec<f64>,
}

/// Search for the manoeuvre of one alternative.
#[derive(Debug, Clone, Default)]
struct Progress {
    /// The sequence with the largest separation by signatures, and this χ².
    best: Option<(usize, f64)>,
    /// The sequence with the largest separation by a fit, and this χ².
    fitted: Option<(usize, f64)>,
    fits: usize,
    /// Duration of the last sequence fitted.
    last_s: f64,
}

impl Progress {
    fn is_sure(&self) -> bool {
        self.fitted.is_some_and(|(_, chi2)| chi2 >= SURE_SIGMA.powi(2))
    }

    fn is_open(&self) -> bool {
        !self.is_sure() && self.fits < AT_ONCE
    }
}

impl Candidate {
    fn new(case: &DiagnosisCase, measured: MeasuredData) -> Candidate {
        let DiagnosisCase { nuisances, rounding, .. } = DiagnosisCase::new(&measured, case.nominal);
        Candidate { measured, nuisances, rounding, linear: case.linear.on_another_motion() }
    }

    fn case<'c>(&'c self, nominal: &'c Configuration) -> DiagnosisCase<'c> {
        let (nuisances, rounding) = (self.nuisances.clone(), self.rounding.clone());
        let case = DiagnosisCase::with_signatures(&self.measured, nominal, nuisances, rounding);
        DiagnosisCase { linear: self.linear.clone(), ..case }
    }
}

impl<'a> DiscriminatingTests<'a> {
    /// For a recording.
    pub fn new(case: &'a DiagnosisCase<'a>) -> DiscriminatingTests<'a> {
        let sequences = sequences::sequences(case.nominal);
        let candidates = sequences.iter().map(|_| OnceLock::new()).collect();
        DiscriminatingTests { case, sequences, parts: OnceLock::new(), candidates }
    }

    /// Selects, for each indistinguishable alternative of the hypothesis at `index`, the test that separates the two.
    pub fn select(
        &self,
        state: &ModelState,
        index: usize,
        alternatives: &[Alternative],
    ) -> Vec<Option<DiscriminatingTest>> {
        // A planned motion has a time of its own, which moves time courses, but no formula.
        let is_of_time = |hypothesis: &Hypothesis| hypothesis.amplitude.is_formula_of_time();
        let is_found_of_time = is_of_time(&state.held[index].hypothesis);
        let is_ambiguous = |alternative: &&Alternative| {
            alternative.delta_chi2 < AMBIGUITY_CHI2 && !is_found_of_time && !is_of_time(&alternative.hypothesis)
        };
        let ambiguous: Vec<&Alternative> = alternatives.iter().filter(is_ambiguous).collect();
        if ambiguous.is_empty() {
            return vec![None; alternatives.len()];
        }
        let others: Vec<&Hypothesis> = ambiguous.iter().map(|alternative| &alternative.hypothesis).collect();
        let hypotheses = in_place(state, index, &others);
        let sizes = hypotheses.iter().map(|own| own.hypothesis.value).collect();
        let group = Group { state, index, hypotheses, sizes };
        let manoeuvres = self.manoeuvres(&group);
        let mut warmings = self.warmings(&group, &manoeuvres).into_iter();
        let mut tests =
            manoeuvres.into_iter().map(|(name, manoeuvre)| test(name, manoeuvre, warmings.next().flatten()));
        alternatives.iter().map(|own| if is_ambiguous(&own) { tests.next() } else { None }).collect()
    }

    /// For each alternative the shortest sequence that is sure, otherwise the most effective one, with its name.
    fn manoeuvres(&self, group: &Group) -> Vec<(String, NextManoeuvre)> {
        let nominal = self.case.nominal;
        let parts = self.parts.get_or_init(|| {
            let planned = |own| planned(nominal, own).expect("a possible excursion");
            let planned = sequences::parts(nominal).into_par_iter().map(planned);
            planned.map(|motion| Candidate::new(self.case, self.case.measured.followed_by(motion, nominal))).collect()
        });
        let signatures =
            |own: &Candidate| Signatures::new(&own.case(nominal), group.state, group.index, &group.hypotheses);
        let parts: Vec<Signatures> = parts.par_iter().map(signatures).collect();
        let separations = |sequence: &Sequence| {
            let parts = sequence.parts().into_iter().map(|part| parts[part].clone());
            let whole = parts.reduce(|whole, part| whole.followed_by(&part)).expect("a rest");
            whole.separations(&group.state.noise, &group.sizes)
        };
        let mut all = vec![Progress::default(); group.hypotheses.len() - 1];
        for (chunk, sequences) in self.sequences.chunks(AT_ONCE).enumerate() {
            if !all.iter().any(Progress::is_open) {
                break;
            }
            let separations: Vec<Vec<Separation>> = sequences.par_iter().map(separations).collect();
            for (within, separations) in separations.iter().enumerate() {
                for (other, progress) in all.iter_mut().enumerate().filter(|(_, progress)| progress.is_open()) {
                    let (sequence, chi2) = (chunk * AT_ONCE + within, separations[other].chi2);
                    if progress.best.is_none_or(|(_, best)| chi2 > best) {
                        progress.best = Some((sequence, chi2));
                    }
                    if chi2 >= SURE_SIGMA.powi(2) && sequences[within].duration_s >= LONGER * progress.last_s {
                        self.fit(group, other, sequence, progress);
                    }
                }
            }
        }
        let of = |(other, mut progress): (usize, Progress)| {
            if let (None, Some((sequence, _))) = (progress.fitted, progress.best) {
                self.fit(group, other, sequence, &mut progress);
            }
            let (sequence, chi2) = progress.fitted.unwrap_or_default();
            let sequence = &self.sequences[sequence];
            let (scenario, duration_s) = (sequence.scenario(nominal), sequence.duration_s);
            (sequence.name(), NextManoeuvre { scenario, duration_s, sigma: chi2.sqrt() })
        };
        all.into_iter().enumerate().map(of).collect()
    }

    /// Fits the model of a sequence for one alternative.
    fn fit(&self, group: &Group, other: usize, sequence: usize, progress: &mut Progress) {
        let nominal = self.case.nominal;
        let candidate = self.candidates[sequence].get_or_init(|| {
            let motion = planned(nominal, self.sequences[sequence].scenario(nominal))?;
            Some(Candidate::new(self.case, self.case.measured.followed_by(motion, nominal)))
        });
        let Some(candidate) = candidate else { return };
        let pair = [&group.hypotheses[0], &group.hypotheses[other + 1]];
        let chi2 = fitted_chi2(&candidate.case(nominal), group.state, group.index, pair);
        progress.fits += 1;
        progress.last_s = self.sequences[sequence].duration_s;
        if progress.fitted.is_none_or(|(_, fitted)| chi2 > fitted) {
            progress.fitted = Some((sequence, chi2));
        }
    }

    /// For each alternative that no manoeuvre separates, if either follows the temperature or an orbit: the recorded motion
    /// repeated at other temperatures, with its name.
    fn warmings(&self, group: &Group, manoeuvres: &[(String, NextManoeuvre)]) -> Vec<Option<(String, Separation)>> {
        let is_wave = group.hypotheses.iter().any(|own| is_wave(&own.hypothesis));
        let is_open = |own: &(String, NextManoeuvre)| own.1.sigma < SURE_SIGMA;
        if !is_wave || !manoeuvres.iter().any(is_open) {
            return vec![None; manoeuvres.len()];
        }
        let of = |case: &DiagnosisCase| Signatures::new(case, group.state, group.index, &group.hypotheses);
        let now = of(self.case);
        let separations = |(name, candidate): (String, Candidate)| {
            let both = now.followed_by(&of(&candidate.case(self.case.nominal)));
            (name, both.separations(&group.state.noise, &group.sizes))
        };
        let all: Vec<(String, Vec<Separation>)> = self.warm().into_par_iter().map(separations).collect();
        let best = |(other, own): (usize, &(String, NextManoeuvre))| {
            let of_other = all.iter().map(|(name, separations)| (name.clone(), separations[other]));
            of_other.max_by(|one, two| one.1.chi2.total_cmp(&two.1.chi2)).filter(|_| is_open(own))
        };
        manoeuvres.iter().enumerate().map(best).collect()
    }

    /// Repeats the motion at other temperatures, on which the signatures of the calibration parameters hardly depend.
    fn warm(&self) -> Vec<(String, Candidate)> {
        let measured = self.case.measured;
        let samples = measured.samples.min((ORBIT_S / measured.interval_s()) as usize);
        let known = &measured.counts.electronics_c[..=samples];
        let mean_c = known.iter().sum::<f64>() / known.len() as f64;
        let first =
            |column: &Nuisance| column.each_ref().map(|values| Some(values.as_ref()?[..samples / BLOCK].to_vec()));
        let candidate = |measured: MeasuredData| Candidate {
            measured,
            nuisances: self.case.nuisances.iter().map(first).collect(),
            rounding: Arc::new(
                self.case.rounding.each_ref().map(|channel| channel.iter().take(samples / BLOCK).copied().collect()),
            ),
            linear: self.case.linear.on_another_motion(),
        };
        let opposite = measured.again(samples, |celsius| 2.0 * mean_c - celsius);
        let warmer = measured.again(samples, |celsius| celsius + WARMER_K);
        let half_orbit = "the same motion half an orbit later, as the electronics temperature swings the other way,";
        vec![
            (half_orbit.to_owned(), candidate(opposite)),
            (format!("the same motion with the electronics {WARMER_K} K warmer"), candidate(warmer)),
        ]
    }
}

/// True for a time course that varies with the temperature or an orbit rather than with the motion.
fn is_wave(hypothesis: &Hypothesis) -> bool {
    hypothesis.profile().is_some_and(|profile| profile.spec.follows_temperature || profile.is_periodic())
}

/// Describes the manoeuvre, or the motion at other temperatures if that separates the two better than a manoeuvre that is not sure.
fn test(name: String, manoeuvre: NextManoeuvre, warming: Option<(String, Separation)>) -> DiscriminatingTest {
    let NextManoeuvre { sigma, duration_s, .. } = manoeuvre;
    let minutes = (duration_s / 60.0).ceil();
    let recording = format!("a new recording of {name} ({minutes:.0} min)");
    let warming = warming.filter(|(_, after)| after.chi2 > THREE_SIGMA_CHI2 && after.chi2 > sigma.powi(2));
    let text = match warming {
        _ if sigma >= SURE_SIGMA => format!("{recording} would separate the two by {sigma:.1} sigma"),
        Some((name, Separation { chi2, .. })) => {
            format!("{name} would separate the two by {:.1} sigma; a scenario does not set temperatures", chi2.sqrt())
        }
        None if sigma.powi(2) > THREE_SIGMA_CHI2 => {
            format!("{recording} is the most effective manoeuvre, and reaches only {sigma:.1} sigma")
        }
        None => NO_TEST.to_owned(),
    };
    DiscriminatingTest { text, manoeuvre: (sigma.powi(2) > THREE_SIGMA_CHI2).then_some(manoeuvre) }
}
