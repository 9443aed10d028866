//! Many blind trials: power against size, naming given detection, false names, abstention on what stands in no catalogue.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Instant;

use serde_json::{Value, json};

use super::draw::TrialGenerator;
use super::hidden::InjectedEffect;
use super::score::{IsolationResult, ReportedDiagnosis, Score, score};
use super::survey::TrialMotion;
use crate::gyros::names;
use crate::measured::MeasuredError;
use crate::outcome::Verdict;

/// Of so many runs one is made with a term outside the catalogue.
const RUNS_OF_UNKNOWN: usize = 4;
/// Strength of those, sigmas.
const UNKNOWN_STRENGTH: f64 = 12.0;
/// Deviations of a normal variable between which 95 % lie.
const NORMAL_95: f64 = 1.959_964;
/// What an unknown effect may be called is at least as like it as this.
const LIKE: f64 = 0.95;

/// What is tried.
#[derive(Debug, Clone, PartialEq)]
pub struct CampaignPlan {
    /// Seed of all of it.
    pub seed: u64,
    /// Runs of each strength, and with nothing hidden.
    pub runs: usize,
    /// Strengths, sigmas of the Cramér–Rao bound.
    pub strengths: Vec<f64>,
    /// Diagnoses at a time, each on one core; the result does not depend on it.
    pub threads: usize,
}

impl CampaignPlan {
    /// What is hidden in each run, in order.
    fn hidings(&self) -> Vec<TrialKind> {
        let of_strength = |&strength: &f64| std::iter::repeat_n(TrialKind::Amplitude(strength), self.runs);
        let unknown = std::iter::repeat_n(TrialKind::Unknown(UNKNOWN_STRENGTH), self.runs.div_ceil(RUNS_OF_UNKNOWN));
        let nothing = std::iter::repeat_n(TrialKind::Nothing, self.runs);
        self.strengths.iter().flat_map(of_strength).chain(nothing).chain(unknown).collect()
    }

    /// Diagnoses in all.
    pub fn count(&self) -> usize {
        self.hidings().len()
    }
}

/// What is hidden in the runs of a group.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TrialKind {
    /// An amplitude of the catalogue, of this strength.
    Amplitude(f64),
    /// Nothing.
    Nothing,
    /// A term outside the catalogue, of this strength.
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
    /// What was hidden.
    pub hidden: Vec<InjectedEffect>,
    /// What was said.
    pub told: ReportedDiagnosis,
    /// The two compared.
    pub score: Score,
    /// For each false name the cosine of its signature with what was hidden.
    pub likeness: Vec<f64>,
    /// Time of the diagnosis on one core.
    pub seconds: f64,
}

/// Runs of one kind.
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    /// What was hidden.
    pub hiding: TrialKind,
    /// The runs.
    pub runs: Vec<TrialRun>,
}

/// All groups.
#[derive(Debug, Clone, PartialEq)]
pub struct BlindCampaign {
    /// By strength, then with nothing hidden, then outside the catalogue.
    pub groups: Vec<Group>,
}

/// Hides, flies, diagnoses and scores. `done` is called after each diagnosis.
///
/// # Errors
/// As [`TrialMotion::diagnose`].
pub fn campaign(
    survey: &TrialMotion,
    plan: &CampaignPlan,
    done: &(dyn Fn() + Sync),
) -> Result<BlindCampaign, MeasuredError> {
    let hidings = plan.hidings();
    let trial = |index: usize| -> Result<TrialRun, MeasuredError> {
        let mut draw = TrialGenerator::new(survey, plan.seed, index as u64);
        let hidden: Vec<InjectedEffect> = match hidings[index] {
            TrialKind::Amplitude(strength) => draw.amplitude(strength).into_iter().collect(),
            TrialKind::Nothing => Vec::new(),
            TrialKind::Unknown(strength) => draw.unknown(strength).into_iter().collect(),
        };
        let flight = draw.fly(&hidden);
        let start = Instant::now();
        let diagnosis = survey.diagnose(&flight)?;
        let seconds = start.elapsed().as_secs_f64();
        let told = ReportedDiagnosis::from(&diagnosis);
        let score =
            score(&hidden, &told, &|hidden, found| survey.signature_cosine(hidden, found, told.temperature_late_s));
        let like = |index: &usize| {
            let found = &told.missing[*index];
            hidden
                .iter()
                .map(|hidden| survey.signature_cosine(hidden, found, told.temperature_late_s))
                .fold(0.0, f64::max)
        };
        let likeness = score.false_names.iter().map(like).collect();
        done();
        Ok(TrialRun { hidden, told, score, likeness, seconds })
    };
    // Thresholds first, on all cores.
    survey.diagnose(&TrialGenerator::new(survey, plan.seed, hidings.len() as u64).fly(&[]))?;
    let mut runs = on_threads(plan.threads, hidings.len(), &trial).into_iter();
    let mut groups: Vec<Group> = Vec::new();
    for hiding in hidings {
        let Some(run) = runs.next() else { break };
        match groups.last_mut() {
            Some(group) if group.hiding == hiding => group.runs.push(run?),
            _ => groups.push(Group { hiding, runs: vec![run?] }),
        }
    }
    Ok(BlindCampaign { groups })
}

/// Does jobs on so many threads, each of which has what is parallel within a job to itself: a diagnosis waits for no other, and its
/// time is its own. Results in order.
fn on_threads<T: Send>(threads: usize, count: usize, job: &(dyn Fn(usize) -> T + Sync)) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let work = || {
        let all = || {
            let mut own = Vec::new();
            loop {
                let index = next.fetch_add(1, Ordering::Relaxed);
                if index >= count {
                    return own;
                }
                own.push((index, job(index)));
            }
        };
        match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
            Ok(pool) => pool.install(all),
            Err(_) => all(),
        }
    };
    let mut results: Vec<(usize, T)> = thread::scope(|scope| {
        let workers: Vec<_> = (0..threads.max(1)).map(|_| scope.spawn(work)).collect();
        let joined = workers.into_iter().map(|worker| worker.join());
        joined.flat_map(|own| own.unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
    });
    results.sort_by_key(|(index, _)| *index);
    results.into_iter().map(|(_, result)| result).collect()
}

impl TrialRun {
    fn naming(&self) -> IsolationResult {
        self.score.outcomes.first().map_or(IsolationResult::Missed, |outcome| outcome.naming)
    }

    /// Whether a name of the catalogue was given for something else, and is not nearly the same.
    fn is_misnamed(&self) -> bool {
        let is_wrong =
            |(index, likeness): (&usize, &f64)| self.told.missing[*index].formula.is_none() && *likeness <= LIKE;
        self.score.false_names.iter().zip(&self.likeness).any(is_wrong)
    }

    /// Whether there is anything to tell of it.
    fn is_good(&self) -> bool {
        let is_named = self.hidden.is_empty() || self.naming() >= IsolationResult::Group;
        is_named && self.score.false_names.is_empty()
    }

    /// What was injected, what was reported, and how alike they are: label and value of each fact.
    fn facts(&self) -> Vec<(String, String)> {
        let fact = |label: &str, value: String| (label.to_owned(), value);
        let mut facts: Vec<_> = self.hidden.iter().flat_map(InjectedEffect::facts).collect();
        if facts.is_empty() {
            facts.push(fact("injected", "nothing".to_owned()));
        }
        let outcome = if self.hidden.is_empty() { "false alarm" } else { self.naming().name() };
        facts.push(fact("outcome", outcome.to_owned()));
        facts.push(fact("verdict", self.told.verdict.name().to_owned()));
        for found in &self.told.missing {
            facts.push(fact("reported", found.to_string()));
            for rival in found.rivals.iter().take(2) {
                let name = rival.formula.as_ref().unwrap_or(&rival.code);
                let behind = rival.behind_chi2.map_or(String::new(), |behind| format!(", behind by chi2 {behind:.1}"));
                facts.push(fact("alternative", format!("{name}, cosine {:.3}{behind}", rival.cosine)));
            }
        }
        let likeness = self.likeness.iter();
        facts.extend(likeness.map(|cosine| fact("cosine to injected", format!("{cosine:.3}"))));
        facts
    }

    fn json(&self) -> Value {
        let hidden = self.hidden.iter().zip(&self.score.outcomes).map(|(own, outcome)| {
            let size =
                outcome.size.map(|size| json!({ "error": size.error, "sigma": size.sigma, "bound": size.bound }));
            json!({
                "code": own.code(), "formula": own.formula(), "gyros": names(&own.gyros), "strength": own.strength,
                "parameters": own.hypothesis.parameters().into_iter().map(|number| (number.name, json!(number.value)))
                    .collect::<serde_json::Map<_, _>>(),
                "naming": outcome.naming.name(), "size": size,
                "assignments": own.assignments,
            })
        });
        json!({
            "hidden": hidden.collect::<Vec<_>>(),
            "verdict": self.told.verdict,
            "said": self.told.missing.iter().map(ToString::to_string).collect::<Vec<_>>(),
            "false_names": self.score.false_names,
            "is_misnamed": self.is_misnamed(),
        })
    }
}

/// A share in percent with the interval of 95 % (Wilson), as a table has it.
fn share(part: usize, whole: usize) -> String {
    if whole == 0 {
        return "–".to_owned();
    }
    let (count, share, square) = (whole as f64, part as f64 / whole as f64, NORMAL_95 * NORMAL_95);
    let middle = (share + square / (2.0 * count)) / (1.0 + square / count);
    let half =
        NORMAL_95 / (1.0 + square / count) * (share * (1.0 - share) / count + square / (4.0 * count * count)).sqrt();
    let [least, greatest] = [middle - half, middle + half].map(|bound| 100.0 * bound.clamp(0.0, 1.0));
    format!("{part}/{whole}, {:.1} % ({least:.1}–{greatest:.1})", 100.0 * share)
}

impl BlindCampaign {
    /// The results as tables in Markdown.
    pub fn tables(&self) -> String {
        let mut text = String::new();
        let mut line = |content: &str| {
            text += content;
            text.push('\n');
        };
        line(
            "| hidden | detected | right | right or in the right group, of those detected | false names beside | error over Cramér–Rao bound, rms | within one sigma |",
        );
        line("|---|---|---|---|---|---|---|");
        for group in self.groups.iter().filter(|group| matches!(group.hiding, TrialKind::Amplitude(_))) {
            let (runs, whole) = (&group.runs, group.runs.len());
            let count = |least: IsolationResult| runs.iter().filter(|run| run.naming() >= least).count();
            let detected = count(IsolationResult::Unnamed);
            let beside = runs
                .iter()
                .filter(|run| run.naming() >= IsolationResult::Group && !run.score.false_names.is_empty())
                .count();
            let sizes: Vec<_> =
                runs.iter().flat_map(|run| run.score.outcomes.iter().filter_map(|outcome| outcome.size)).collect();
            let squares: f64 = sizes.iter().map(|size| (size.error / size.bound).powi(2)).sum();
            let rms = match sizes.len() {
                0 => "–".to_owned(),
                count => format!("{:.2}", (squares / count as f64).sqrt()),
            };
            let within = sizes.iter().filter(|size| size.error.abs() < size.sigma).count();
            line(&format!(
                "| {} | {} | {} | {} | {} | {rms} | {} |",
                group.hiding.name(),
                share(detected, whole),
                share(count(IsolationResult::Right), detected),
                share(count(IsolationResult::Group), detected),
                share(beside, whole),
                share(within, sizes.len()),
            ));
        }
        line("\n| hidden | a name given | left unexplained |");
        line("|---|---|---|");
        for group in self.groups.iter().filter(|group| group.hiding == TrialKind::Nothing) {
            let named = group.runs.iter().filter(|run| !run.told.missing.is_empty()).count();
            let unexplained = group.runs.iter().filter(|run| run.told.verdict == Verdict::Unexplained).count();
            let whole = group.runs.len();
            line(&format!("| nothing | {} | {} |", share(named, whole), share(unexplained, whole)));
        }
        line(
            "\n| hidden | detected | its formula, or one like it | another formula | no name | a name of the catalogue, cosine to it 0.95 or less |",
        );
        line("|---|---|---|---|---|---|");
        for group in self.groups.iter().filter(|group| matches!(group.hiding, TrialKind::Unknown(_))) {
            let (runs, whole) = (&group.runs, group.runs.len());
            let count = |is: &dyn Fn(&&TrialRun) -> bool| share(runs.iter().filter(is).count(), whole);
            line(&format!(
                "| {} | {} | {} | {} | {} | {} |",
                group.hiding.name(),
                count(&|run| run.naming() >= IsolationResult::Unnamed),
                count(&|run| run.naming() >= IsolationResult::Group && !run.is_misnamed()),
                count(&|run| run.naming() == IsolationResult::Wrong && !run.is_misnamed()),
                count(&|run| run.naming() == IsolationResult::Unnamed),
                count(&|run| run.is_misnamed()),
            ));
        }
        text
    }

    /// Every run in which something was missed or wrongly named, with its facts.
    pub fn misses(&self) -> Vec<(String, Vec<(String, String)>)> {
        let of_group = |group: &Group| {
            let bad = group.runs.iter().enumerate().filter(|(_, run)| !run.is_good());
            bad.map(|(index, run)| (format!("{}, run {index}", group.hiding.name()), run.facts())).collect::<Vec<_>>()
        };
        self.groups.iter().flat_map(of_group).collect()
    }

    /// Median time of a diagnosis on one core, s.
    pub fn median_s(&self) -> f64 {
        let mut seconds: Vec<f64> = self.groups.iter().flat_map(|group| &group.runs).map(|run| run.seconds).collect();
        seconds.sort_by(f64::total_cmp);
        seconds.get(seconds.len() / 2).copied().unwrap_or(0.0)
    }

    /// Every run. No times: the same seed gives the same JSON.
    pub fn json(&self) -> Value {
        let group = |group: &Group| json!({ "hidden": group.hiding.name(), "runs": group.runs.iter().map(TrialRun::json).collect::<Vec<_>>() });
        json!({ "groups": self.groups.iter().map(group).collect::<Vec<_>>() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_have_the_intervals_of_wilson() {
        // E. B. Wilson, 1927, as scipy.stats.binomtest(8, 10).proportion_ci(method="wilson") gives it.
        assert_eq!(share(8, 10), "8/10, 80.0 % (49.0–94.3)");
        assert_eq!(share(0, 200), "0/200, 0.0 % (0.0–1.9)");
        assert_eq!(share(0, 0), "–");
    }
}
