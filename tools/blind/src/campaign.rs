//! A campaign of blind trials: detection and isolation rates by strength, false alarms, terms outside the catalogue.

use std::collections::BTreeMap;
use std::iter::StepBy;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Instant;

use rayon::ThreadPoolBuilder;
use serde_json::{Value, json};

use crate::injected::InjectedEffect;
use crate::record::TrialRecord;
use crate::score::{IsolationResult, ReportedDiagnosis, Score, score};
use crate::survey::TrialMotion;
use crate::trial::TrialGenerator;
use geu_diagnosis::measured::MeasuredError;
use geu_diagnosis::outcome::{DiagnosedEffect, Diagnosis};

/// Number of runs for each run with a term outside the catalogue.
const RUNS_OF_UNKNOWN: usize = 4;
/// Strength of those, sigmas.
const UNKNOWN_STRENGTH: f64 = 12.0;
/// Cosine up to which an effect of the catalogue is a wrong isolation.
const SIMILAR: f64 = 0.95;
/// Alternatives listed in the facts of a run.
const LISTED: usize = 2;

/// Size of a campaign.
#[derive(Debug, Clone, PartialEq)]
pub struct CampaignPlan {
    /// Seed.
    pub seed: u64,
    /// Runs of each strength, and without an effect.
    pub runs: u16,
    /// Strengths, in sigmas of the Cramér–Rao bound.
    pub strengths: Vec<f64>,
    /// Parallel diagnoses, each on one core; the result does not depend on it.
    pub threads: usize,
    /// The part that is run.
    pub shard: Shard,
}

/// A part of a campaign, which may run on other machines: the runs that leave `index` when their number is divided by `count`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    pub index: usize,
    pub count: usize,
}

impl Shard {
    pub const WHOLE: Shard = Shard { index: 0, count: 1 };
}

impl CampaignPlan {
    /// The kind of each run of all shards, in order.
    pub(crate) fn kinds(&self) -> Vec<TrialKind> {
        let with_amplitude = self.strengths.iter().map(|&strength| (TrialKind::Amplitude(strength), self.runs.into()));
        let without = (TrialKind::Nothing, self.runs.into());
        let unknown = (TrialKind::Unknown(UNKNOWN_STRENGTH), usize::from(self.runs).div_ceil(RUNS_OF_UNKNOWN));
        let all = with_amplitude.chain([without, unknown]);
        all.flat_map(|(kind, runs)| std::iter::repeat_n(kind, runs)).collect()
    }

    /// Numbers of the runs of this shard.
    fn numbers(&self) -> StepBy<Range<usize>> {
        let runs = usize::from(self.runs);
        let all = (self.strengths.len() + 1) * runs + runs.div_ceil(RUNS_OF_UNKNOWN);
        (self.shard.index..all).step_by(self.shard.count)
    }

    /// Number of diagnoses.
    pub fn count(&self) -> usize {
        self.numbers().len()
    }
}

/// Kind of the injected effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TrialKind {
    /// An amplitude of the catalogue with this strength.
    Amplitude(f64),
    /// No effect.
    Nothing,
    /// A term outside the catalogue with this strength.
    Unknown(f64),
}

impl TrialKind {
    /// In words.
    pub fn name(self) -> String {
        match self {
            TrialKind::Amplitude(strength) => format!("effect, {strength}×"),
            TrialKind::Nothing => "nothing".to_owned(),
            TrialKind::Unknown(strength) => format!("outside the catalogue, {strength}×"),
        }
    }
}

/// One blind trial.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialRun {
    /// Injected effects.
    pub injected: Vec<InjectedEffect>,
    /// The diagnosis.
    pub result: ReportedDiagnosis,
    /// Comparison of the two.
    pub score: Score,
    /// For each false alarm, the cosine of its signature with the injected effect.
    pub cosines: Vec<f64>,
    /// Time of the diagnosis on one core.
    pub seconds: f64,
}

/// Runs of one kind.
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    /// The kind.
    pub kind: TrialKind,
    /// The runs.
    pub runs: Vec<TrialRecord>,
}

/// All groups.
#[derive(Debug, Clone, PartialEq)]
pub struct BlindCampaign {
    /// By strength, then without an effect, then outside the catalogue.
    pub groups: Vec<Group>,
}

/// Runs the trials and scores them. `done` is called after each diagnosis.
///
/// # Errors
/// See [`TrialMotion::diagnose`].
pub fn campaign(
    motion: &TrialMotion,
    plan: &CampaignPlan,
    done: &(dyn Fn() + Sync),
) -> Result<BlindCampaign, MeasuredError> {
    let (kinds, numbers) = (plan.kinds(), plan.numbers().collect::<Vec<usize>>());
    let trial = |place: usize| -> Result<TrialRecord, MeasuredError> {
        let index = numbers[place];
        let mut generator = TrialGenerator::new(motion, plan.seed, index as u64);
        let injected: Vec<InjectedEffect> = match kinds[index] {
            TrialKind::Amplitude(strength) => generator.amplitude(strength).into_iter().collect(),
            TrialKind::Nothing => Vec::new(),
            TrialKind::Unknown(strength) => generator.unknown(strength).into_iter().collect(),
        };
        let recording = generator.simulate(&injected);
        let start = Instant::now();
        let diagnosis = motion.diagnose(&recording)?;
        let run = TrialRun::new(motion, injected, &diagnosis, start.elapsed().as_secs_f64());
        done();
        Ok(TrialRecord::from(&run))
    };
    // Thresholds first, on all cores.
    motion.diagnose(&TrialGenerator::new(motion, plan.seed, kinds.len() as u64).simulate(&[]))?;
    let runs = on_threads(plan.threads, numbers.len(), &trial).into_iter().collect::<Result<Vec<_>, _>>()?;
    Ok(BlindCampaign::from_runs(numbers.iter().map(|&number| kinds[number]).zip(runs)))
}

/// Runs jobs on threads, each with a pool of its own for the parallel parts of a job, so that the time of a diagnosis does not depend
/// on the others. Results in order.
pub fn on_threads<T: Send>(threads: usize, count: usize, job: &(dyn Fn(usize) -> T + Sync)) -> Vec<T> {
    let (next, results) = (AtomicUsize::new(0), Mutex::new(BTreeMap::new()));
    let work = || {
        let pool = ThreadPoolBuilder::new().num_threads(1).build().ok();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= count {
                return;
            }
            let result = pool.as_ref().map_or_else(|| job(index), |pool| pool.install(|| job(index)));
            results.lock().unwrap_or_else(PoisonError::into_inner).insert(index, result);
        }
    };
    thread::scope(|scope| {
        for _ in 0..threads.max(1) {
            scope.spawn(work);
        }
    });
    results.into_inner().unwrap_or_else(PoisonError::into_inner).into_values().collect()
}

impl TrialRun {
    /// Scores a diagnosis that took `seconds`.
    pub fn new(motion: &TrialMotion, injected: Vec<InjectedEffect>, diagnosis: &Diagnosis, seconds: f64) -> TrialRun {
        let result = ReportedDiagnosis::from(diagnosis);
        let cosine = |own: &InjectedEffect, found: &DiagnosedEffect| {
            motion.signature_cosine(own, found, result.temperature_late_s)
        };
        let score = score(&injected, &result, &cosine);
        let max_cosine =
            |index: &usize| injected.iter().map(|own| cosine(own, &result.missing[*index])).fold(0.0, f64::max);
        let cosines = score.false_alarms.iter().map(max_cosine).collect();
        TrialRun { injected, result, score, cosines, seconds }
    }

    /// Isolation of the injected effect.
    fn isolation(&self) -> IsolationResult {
        self.score.outcomes.first().map_or(IsolationResult::Missed, |outcome| outcome.isolation)
    }

    /// True if an effect of the catalogue was reported that is neither the injected one nor similar.
    pub fn is_wrong(&self) -> bool {
        let is_wrong =
            |(index, cosine): (&usize, &f64)| self.result.missing[*index].formula.is_none() && *cosine <= SIMILAR;
        self.score.false_alarms.iter().zip(&self.cosines).any(is_wrong)
    }

    /// Label and value of each fact: injected and reported effects, and their similarity.
    pub fn facts(&self) -> Vec<(String, String)> {
        let fact = |label: &str, value: String| (label.to_owned(), value);
        let mut facts: Vec<_> = self.injected.iter().flat_map(InjectedEffect::facts).collect();
        if facts.is_empty() {
            facts.push(fact("injected", "nothing".to_owned()));
        }
        let outcome = if self.injected.is_empty() { "false alarm" } else { self.isolation().name() };
        facts.push(fact("outcome", outcome.to_owned()));
        facts.push(fact("verdict", self.result.verdict.name().to_owned()));
        for found in &self.result.missing {
            facts.push(fact("reported", found.to_string()));
            for other in found.alternatives.iter().take(LISTED) {
                let name = other.formula.as_ref().unwrap_or(&other.code);
                let behind = other.delta_chi2.map_or(String::new(), |behind| format!(", behind by chi2 {behind:.1}"));
                facts.push(fact("alternative", format!("{name}, cosine {:.3}{behind}", other.cosine)));
            }
        }
        facts.extend(self.cosines.iter().map(|cosine| fact("cosine to injected", format!("{cosine:.3}"))));
        facts
    }
}

impl BlindCampaign {
    /// Runs in order, each with its kind.
    pub(crate) fn from_runs(runs: impl Iterator<Item = (TrialKind, TrialRecord)>) -> BlindCampaign {
        let mut groups: Vec<Group> = Vec::new();
        for (kind, run) in runs {
            match groups.last_mut() {
                Some(group) if group.kind == kind => group.runs.push(run),
                _ => groups.push(Group { kind, runs: vec![run] }),
            }
        }
        BlindCampaign { groups }
    }

    /// Name and facts of every run with a missed or wrong effect or a false alarm.
    pub fn misses(&self) -> Vec<(String, Vec<(String, String)>)> {
        let misses = |group: &Group| {
            let bad = group.runs.iter().enumerate().filter(|(_, run)| !run.is_good());
            bad.map(|(index, run)| (format!("{}, run {index}", group.kind.name()), run.facts.clone()))
                .collect::<Vec<_>>()
        };
        self.groups.iter().flat_map(misses).collect()
    }

    /// Median time of a diagnosis on one core, s.
    pub fn median_s(&self) -> f64 {
        let mut seconds: Vec<f64> = self.groups.iter().flat_map(|group| &group.runs).map(|run| run.seconds).collect();
        seconds.sort_by(f64::total_cmp);
        seconds.get(seconds.len() / 2).copied().unwrap_or(0.0)
    }

    /// Every run. Without times, so that the same seed yields the same JSON.
    pub fn json(&self) -> Value {
        let group = |group: &Group| json!({ "hidden": group.kind.name(), "runs": group.runs });
        json!({ "groups": self.groups.iter().map(group).collect::<Vec<_>>() })
    }
}
