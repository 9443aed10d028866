//! Runs of a campaign in JSON, and the merge of shards.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use crate::campaign::{BlindCampaign, CampaignPlan, Shard, TrialRun};
use crate::injected::InjectedEffect;
use crate::score::{EffectScore, IsolationResult, SizeError};
use geu_diagnosis::outcome::Verdict;

/// Record of one run of a campaign.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrialRecord {
    #[serde(rename = "hidden")]
    pub injected: Vec<InjectedRecord>,
    pub verdict: Verdict,
    /// Effects reported as missing in the model.
    pub said: Vec<String>,
    /// Places in `said` of effects that were not injected.
    pub false_names: Vec<usize>,
    /// See [`TrialRun::is_wrong`].
    pub is_misnamed: bool,
    /// See [`TrialRun::facts`]; not in the JSON.
    #[serde(skip)]
    pub facts: Vec<(String, String)>,
    /// Time of the diagnosis on one core; not in the JSON, which is the same for the same seed.
    #[serde(skip)]
    pub seconds: f64,
}

/// An injected effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InjectedRecord {
    pub naming: IsolationResult,
    pub size: Option<SizeError>,
    /// Code, parameters and strength.
    #[serde(flatten)]
    pub effect: Map<String, Value>,
}

impl From<&TrialRun> for TrialRecord {
    fn from(run: &TrialRun) -> TrialRecord {
        let effect = |(own, outcome): (&InjectedEffect, &EffectScore)| {
            let parameters = own.hypothesis.parameters().into_iter();
            let fields = [
                ("code", json!(own.code())),
                ("formula", json!(own.formula())),
                ("gyros", json!(own.gyros().names())),
                ("strength", json!(own.strength)),
                ("parameters", parameters.map(|number| (number.name.to_owned(), json!(number.value))).collect()),
                ("assignments", json!(own.assignments)),
            ];
            let effect = fields.map(|(key, value)| (key.to_owned(), value)).into_iter().collect();
            InjectedRecord { naming: outcome.isolation, size: outcome.size, effect }
        };
        TrialRecord {
            injected: run.injected.iter().zip(&run.score.outcomes).map(effect).collect(),
            verdict: run.result.verdict,
            said: run.result.missing.iter().map(ToString::to_string).collect(),
            false_names: run.score.false_alarms.clone(),
            is_misnamed: run.is_wrong(),
            facts: run.facts(),
            seconds: run.seconds,
        }
    }
}

impl TrialRecord {
    /// Isolation of the injected effect.
    pub fn isolation(&self) -> IsolationResult {
        self.injected.first().map_or(IsolationResult::Missed, |effect| effect.naming)
    }

    pub fn is_good(&self) -> bool {
        let is_isolated = self.injected.is_empty() || self.isolation() >= IsolationResult::Group;
        is_isolated && self.false_names.is_empty()
    }
}

/// A shard of a campaign as a file: its runs, and what must agree with the other shards.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShardFile {
    version: String,
    /// Number of the shard from 1 on, and of all shards.
    shard: [usize; 2],
    seed: u64,
    runs: u16,
    sizes: Vec<f64>,
    duration_s: f64,
    /// The configuration as TOML.
    configuration: String,
    trials: Vec<TrialRecord>,
}

/// Shards that are not the parts of one campaign.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MergeError {
    #[error(
        "expected a part of the same campaign, got another {field} than in the first file; write all parts with the same options"
    )]
    Differs { file: usize, field: &'static str },
    #[error("expected part 1 to {count} with {trials} runs, got part {index} with {got}; write it again")]
    Damaged { file: usize, index: usize, count: usize, trials: usize, got: usize },
    #[error(
        "expected each of {count} parts once, got part {index} {times} times; `geu blind campaign --shard {index}/{count}` writes it"
    )]
    Times { index: usize, count: usize, times: usize },
}

impl ShardFile {
    /// The file of a shard of this plan on a motion.
    pub fn new(plan: &CampaignPlan, configuration: String, duration_s: f64, campaign: BlindCampaign) -> ShardFile {
        ShardFile {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            shard: [plan.shard.index + 1, plan.shard.count],
            seed: plan.seed,
            runs: plan.runs,
            sizes: plan.strengths.clone(),
            duration_s,
            configuration,
            trials: campaign.groups.into_iter().flat_map(|group| group.runs).collect(),
        }
    }

    fn plan(&self) -> CampaignPlan {
        let shard = Shard { index: self.shard[0].wrapping_sub(1), count: self.shard[1] };
        CampaignPlan { seed: self.seed, runs: self.runs, strengths: self.sizes.clone(), threads: 1, shard }
    }

    /// Fields that all shards have in common.
    fn common(&self) -> [(&'static str, String); 7] {
        [
            ("version", self.version.clone()),
            ("number of shards", self.shard[1].to_string()),
            ("seed", self.seed.to_string()),
            ("runs", self.runs.to_string()),
            ("sizes", format!("{:?}", self.sizes)),
            ("duration", format!("{} s", self.duration_s)),
            ("configuration", self.configuration.clone()),
        ]
    }
}

/// The whole campaign of all its shards, in any order, as a single machine makes it.
///
/// # Errors
/// Shards of different campaigns, or not all of one.
pub fn merged(shards: &[ShardFile]) -> Result<BlindCampaign, MergeError> {
    let Some(first) = shards.first() else { return Err(MergeError::Times { index: 1, count: 1, times: 0 }) };
    let count = first.shard[1];
    for (file, own) in shards.iter().enumerate() {
        let [mine, others] = [own, first].map(ShardFile::common);
        let differs = |((field, got), (_, first)): (&(&'static str, String), &(&'static str, String))| {
            (got != first).then_some(MergeError::Differs { file, field })
        };
        if let Some(error) = mine.iter().zip(&others).find_map(differs) {
            return Err(error);
        }
        let (index, got) = (own.shard[0], own.trials.len());
        let is_place = (1..=count).contains(&index);
        let trials = if is_place { own.plan().count() } else { 0 };
        if !is_place || got != trials {
            return Err(MergeError::Damaged { file, index, count, trials, got });
        }
    }
    let of_index = |index: usize| shards.iter().filter(move |own| own.shard[0] == index);
    if let Some((index, times)) = (1..=count).map(|index| (index, of_index(index).count())).find(|own| own.1 != 1) {
        return Err(MergeError::Times { index, count, times });
    }
    let kinds = first.plan().kinds();
    let run = |number: usize| of_index(1 + number % count).next().and_then(|own| own.trials.get(number / count));
    let runs = kinds.iter().enumerate().filter_map(|(number, kind)| Some((*kind, run(number)?.clone())));
    Ok(BlindCampaign::from_runs(runs))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Part `index` of a campaign of one strength: runs 0 and 1 of it, 2 and 3 without an effect, 4 outside the catalogue. Each run says its number.
    fn part(index: usize, count: usize) -> ShardFile {
        let trial = |number: usize| {
            let size = SizeError { error: 0.1, sigma: 0.30000000000000004, bound: 1e-7 };
            let effect = InjectedRecord { naming: IsolationResult::Group, size: Some(size), effect: Map::new() };
            TrialRecord {
                injected: if number < 2 { vec![effect] } else { Vec::new() },
                verdict: Verdict::Consistent,
                said: vec![number.to_string()],
                false_names: Vec::new(),
                is_misnamed: false,
                facts: Vec::new(),
                seconds: 0.0,
            }
        };
        let trials: Vec<TrialRecord> = (index - 1..5).step_by(count).map(trial).collect();
        serde_json::from_value(json!({
            "version": "0.1.0", "shard": [index, count], "seed": 3, "runs": 2, "sizes": [6.0], "duration_s": 900.0,
            "configuration": "seed = 1\n", "trials": trials,
        }))
        .expect("a shard")
    }

    #[test]
    fn parts_in_any_order_make_the_whole() {
        let whole = merged(&[part(1, 1)]).expect("the whole").json();
        let groups = whole["groups"].as_array().expect("groups");
        let said: Vec<&Value> =
            groups.iter().flat_map(|group| group["runs"].as_array()).flatten().map(|run| &run["said"][0]).collect();
        assert_eq!(
            (groups.len(), said),
            (3, ["0", "1", "2", "3", "4"].each_ref().map(|own| json!(own)).iter().collect())
        );
        assert_eq!(groups[0]["runs"][1]["hidden"][0]["size"]["sigma"], 0.30000000000000004);
        for parts in [vec![part(2, 2), part(1, 2)], (1..=5).map(|index| part(index, 5)).collect()] {
            assert_eq!(merged(&parts).map(|campaign| campaign.json().to_string()), Ok(whole.to_string()));
        }
    }

    #[test]
    fn other_parts_are_refused() {
        let times = |index, times| Err(MergeError::Times { index, count: 2, times });
        assert_eq!(merged(&[part(1, 2)]).map(drop), times(2, 0));
        assert_eq!(merged(&[part(1, 2), part(2, 2), part(1, 2)]).map(drop), times(1, 2));
        let other = ShardFile { seed: 4, ..part(2, 2) };
        assert_eq!(merged(&[part(1, 2), other]).map(drop), Err(MergeError::Differs { file: 1, field: "seed" }));
        let short = ShardFile { trials: Vec::new(), ..part(2, 2) };
        assert_eq!(
            merged(&[part(1, 2), short]).map(drop),
            Err(MergeError::Damaged { file: 1, index: 2, count: 2, trials: 2, got: 0 })
        );
        for shard in [[0, 2], [3, 2], [1, 0], [usize::MAX, usize::MAX]] {
            let damaged = ShardFile { shard, ..part(1, 2) };
            assert!(matches!(merged(&[damaged]), Err(MergeError::Damaged { .. })), "{shard:?}");
        }
        let many = ShardFile { runs: u16::MAX, ..part(1, 2) };
        assert!(merged(&[many]).is_err());
    }
}
